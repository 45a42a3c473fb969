"""The folder of agent sequences: what is written is read, and what does not fit together is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import manifest_of, town

from maslam.frontend.errors import FrontendError
from maslam.frontend.files.point_views import PointViews, write_views
from maslam.frontend.files.trajectory import write_tum
from maslam.frontend.files.vo_files import write_track
from maslam.mas.errors import MasError
from maslam.mas.manifest import MANIFEST, write_manifest
from maslam.mas.sequence import GROUNDTRUTH, PLACES, TRAJECTORY, AgentSequence, load_sequences
from maslam.mas.state.keyframe import keyframes_of


def write(folder: Path, sequences: list[AgentSequence]) -> Path:
    for s in sequences:
        (folder / s.name).mkdir()
        for number, track in enumerate(s.tracks):
            write_track(folder / s.name, number, track)
        s.places.save(folder / s.name / PLACES)
        write_tum(folder / s.name / TRAJECTORY, s.trajectory)
        if s.groundtruth is not None:
            write_tum(folder / s.name / GROUNDTRUTH, s.groundtruth)
    write_manifest(folder, manifest_of(sequences))
    return folder


def test_round_trip(tmp_path: Path) -> None:
    manifest, sequences = town(2, 5, cuts=(6,))
    found, back = load_sequences(write(tmp_path, sequences))
    assert found == manifest
    for a, b in zip(sequences, back, strict=True):
        assert (a.name, a.metric, a.start_ns, a.source, len(a.tracks)) == (
            b.name,
            b.metric,
            b.start_ns,
            b.source,
            len(b.tracks),
        )
        np.testing.assert_array_equal(a.keyframe_stamps_ns, b.keyframe_stamps_ns)
        np.testing.assert_allclose(a.trajectory.poses, b.trajectory.poses, atol=1e-8)
        for x, y in zip(keyframes_of(a), keyframes_of(b), strict=True):
            np.testing.assert_allclose(x.points_C, y.points_C, atol=1e-3)
            np.testing.assert_array_equal(x.vector, y.vector)
            assert (x.track, x.stamp_ns, x.first_seen.tolist()) == (y.track, y.stamp_ns, y.first_seen.tolist())


def test_key_frames_see_their_points_from_their_own_camera() -> None:
    _, (sequence,) = town(1, 4)
    track = sequence.tracks[0]
    for k, keyframe in enumerate(keyframes_of(sequence)):
        mine = track.observations[track.observations[:, 0] == k, 1]
        homogeneous = np.column_stack([track.points[mine], np.ones(len(mine))])
        expected = (np.linalg.inv(track.poses[k]) @ homogeneous.T).T[:, :3]
        np.testing.assert_allclose(keyframe.points_C, expected, atol=1e-4)
        assert keyframe.depth == pytest.approx(np.median(expected[:, 2]), rel=1e-6)
        assert (keyframe.points_C[:, 2] > 0).all()


def test_an_unfinished_folder_is_refused(tmp_path: Path) -> None:
    _, sequences = town(1, 3)
    write(tmp_path, sequences)
    (tmp_path / MANIFEST).unlink()
    with pytest.raises(MasError, match=r"no manifest\.json"):
        load_sequences(tmp_path)


@pytest.mark.parametrize(("u", "refused"), [(639.0, False), (705.0, True)])
def test_views_are_checked_against_the_manifests_camera(tmp_path: Path, u: float, refused: bool) -> None:
    """The second agent's camera has 640 pixels a row."""
    _, sequences = town(2, 3)
    write(tmp_path, sequences)
    write_views(tmp_path / sequences[1].name, 0, PointViews.sorted(np.zeros(1, int), np.zeros(1, int), [[u, 5.0]]))
    if not refused:
        assert load_sequences(tmp_path)[1][1].views[0] is not None
        return
    with pytest.raises(FrontendError, match=r"agent_01/views_0\.npz: a view at pixel .* outside the image of 640x360"):
        load_sequences(tmp_path)


def spoil_manifest(folder: Path, **changes: object) -> None:
    content = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps({**content, **changes}))


def test_an_unknown_key_in_the_manifest_is_named(tmp_path: Path) -> None:
    write(tmp_path, town(1, 3)[1])
    spoil_manifest(tmp_path, flavour="vanilla")
    with pytest.raises(MasError, match=r"manifest\.json: flavour"):
        load_sequences(tmp_path)


def test_vectors_of_another_model_are_refused(tmp_path: Path) -> None:
    _, sequences = town(2, 3)
    write(tmp_path, sequences)
    replace(sequences[1].places, sha256="cd" * 32).save(tmp_path / "agent_01" / PLACES)
    with pytest.raises(MasError, match=r"agent_01.*made by model.*cdcdcdcdcdcd"):
        load_sequences(tmp_path)


def test_vectors_of_other_images_are_refused() -> None:
    _, (sequence,) = town(1, 4)
    shifted = replace(sequence.places, stamps_ns=sequence.places.stamps_ns + 2_000_000)
    with pytest.raises(MasError, match=r"0\.002000 s apart"):
        replace(sequence, places=shifted)


def test_a_missing_agent_is_named(tmp_path: Path) -> None:
    _, sequences = town(2, 3)
    write(tmp_path, sequences)
    (tmp_path / "agent_01").rename(tmp_path / "agent_07")
    with pytest.raises(MasError, match="agent_01: missing"):
        load_sequences(tmp_path)
