"""Group axioms and closed forms, near the identity and near half a turn too."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from maslam.backend import geometry as g

tangents = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)
tiny = st.lists(st.floats(-1e-6, 1e-6), min_size=6, max_size=6).map(np.array)


@given(st.one_of(tangents, tiny))
def test_exp_of_log_is_the_identity(xi):
    T = g.se3_exp(xi)
    np.testing.assert_allclose(g.se3_exp(g.se3_log(T)), T, atol=1e-9)
    np.testing.assert_allclose(T @ g.se3_inverse(T), np.eye(4), atol=1e-9)
    assert g.is_se3(T)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.sampled_from([0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-7, np.pi])
)
def test_so3_agrees_with_scipy(axis, angle):
    axis = np.array(axis)
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0.0, 1.0])
    w = axis / np.linalg.norm(axis) * angle
    reference = Rotation.from_rotvec(w)
    np.testing.assert_allclose(g.so3_exp(w), reference.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(g.so3_exp(g.so3_log(reference.as_matrix())), reference.as_matrix(), atol=1e-7)
    q = g.quat_wxyz_from_rotation(reference.as_matrix())
    xyzw = reference.as_quat()
    assert abs(q @ np.array([xyzw[3], *xyzw[:3]])) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(g.rotation_from_quat_wxyz(q * 3.0), reference.as_matrix(), atol=1e-12)


@given(tangents, tangents, st.floats(0.1, 10.0), st.floats(0.1, 10.0))
def test_sim3_composes_like_its_matrices(a, b, scale_a, scale_b):
    A = g.Sim3(g.so3_exp(a[3:]), a[:3], scale_a)
    B = g.Sim3(g.so3_exp(b[3:]), b[:3], scale_b)
    np.testing.assert_allclose((A @ B).matrix(), A.matrix() @ B.matrix(), atol=1e-9)
    np.testing.assert_allclose((A @ A.inverse()).matrix(), np.eye(4), atol=1e-9)
    p = np.array([[1.0, -2.0, 0.5]])
    np.testing.assert_allclose((A @ B) @ p, A @ (B @ p), atol=1e-9)


@given(tangents, st.floats(0.2, 5.0), st.integers(0, 2**31))
def test_umeyama_finds_the_transform_it_was_given(xi, scale, seed):
    points_b = np.random.default_rng(seed).normal(size=(12, 3))
    truth = g.Sim3(g.so3_exp(xi[3:]), xi[:3], scale)
    np.testing.assert_allclose(
        g.umeyama(truth @ points_b, points_b, with_scale=True).matrix(), truth.matrix(), atol=1e-7
    )
    rigid = g.Sim3(truth.rotation, truth.translation)
    np.testing.assert_allclose(
        g.umeyama(rigid @ points_b, points_b, with_scale=False).matrix(), rigid.matrix(), atol=1e-7
    )


def test_umeyama_survives_degenerate_sets():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    for points in (line, line[:1], np.zeros((4, 3))):
        T = g.umeyama(points + 5.0, points, with_scale=True)
        assert g.is_se3(T.se3())
        np.testing.assert_allclose(T @ points, points + 5.0, atol=1e-9)
    with pytest.raises(ValueError, match="equal length"):
        g.umeyama(line, line[:2], with_scale=False)


def test_projection_gives_the_nearest_rotation():
    rng = np.random.default_rng(0)
    R = g.so3_exp(rng.normal(size=(20, 3)))
    noisy = R + 0.01 * rng.normal(size=R.shape)
    P = g.project_to_so3(noisy)
    assert np.allclose(P @ np.swapaxes(P, -1, -2), np.eye(3)) and (np.linalg.det(P) > 0).all()
    assert (g.rotation_angle_deg(np.swapaxes(R, -1, -2) @ P) < 3.0).all()
