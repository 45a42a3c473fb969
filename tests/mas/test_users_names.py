"""Results carry the user's times and names: trajectories in the images' own stamps, COLMAP images under their files'
names with every view of a point."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of

from maslam.api.results import Run
from maslam.backend.geometry import se3_inverse, transform_points
from maslam.frontend.files.trajectory import read_tum
from maslam.mas.config import MasConfig
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import run
from maslam.tools.report.run_data import read_run
from maslam.tools.report.sections import sections
from maslam.tools.report.summary_table import table_of

DEFAULT = preset("default")
EPOCH_NS = 1_305_031_102_175_304_000  # a data set's clock, not ours


def named(sequence: AgentSequence) -> AgentSequence:
    """The same with a clock of its own and names of images as a data set has them."""
    frames = sequence.keyframe_stamps_ns // 100_000_000
    images = tuple(f"{sequence.name}/rgb/{1000 + 7 * f}.jpg" for f in frames)
    return replace(sequence, start_ns=EPOCH_NS + sequence.start_ns, places=replace(sequence.places, images=images))


def ran(folder: Path, config: MasConfig = DEFAULT) -> list[AgentSequence]:
    world = make_world(3)  # round a corner: what lies on one line cannot be aligned
    sequences = [named(make_sequence(world, circuit(25.0 + 5.0 * a, 21.0), 3, a)) for a in range(2)]
    run(manifest_of(sequences), sequences, config, folder)
    return sequences


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[AgentSequence]]:
    folder = tmp_path_factory.mktemp("named") / "run"
    return folder, ran(folder)


def test_trajectories_have_the_stamps_of_the_images(done: tuple[Path, list[AgentSequence]]) -> None:
    folder, sequences = done
    for sequence in sequences:
        images = EPOCH_NS + (sequence.start_ns - EPOCH_NS) + 100_000_000 * np.arange(42)
        for name, expected in (
            ("trajectory.tum", images),
            ("groundtruth.tum", images),
            ("trajectory_keyframes.tum", images[::3]),
        ):
            np.testing.assert_array_equal(read_tum(folder / sequence.name / name).stamps_ns, expected)
    first = (folder / "agent_01" / "trajectory.tum").read_text().split()[0]
    assert first == "1305031103.175304000"


def test_evo_takes_a_trajectory_with_the_data_sets_own_ground_truth(
    done: tuple[Path, list[AgentSequence]], tmp_path: Path
) -> None:
    pytest.importorskip("evo", reason="the extra 'evo' is not installed")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    folder, sequences = done
    truth = sequences[1].groundtruth
    assert truth is not None
    lines = ["# timestamp tx ty tz qx qy qz qw"]  # written as the data set would, not by us
    for stamp, centre in zip((truth.stamps_ns + sequences[1].start_ns).tolist(), truth.centres.tolist(), strict=True):
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {centre[0]} {centre[1]} {centre[2]} 0 0 0 1")
    (tmp_path / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    pair = [
        file_interface.read_tum_trajectory_file(str(path))
        for path in (tmp_path / "groundtruth.txt", folder / "agent_01" / "trajectory.tum")
    ]
    reference, estimate = sync.associate_trajectories(*pair)
    assert estimate.num_poses == 42
    estimate.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    said = json.loads((folder / "summary.json").read_text())["ate_rmse_m"]["agents"][1]
    assert ape.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(said, rel=1e-3)


def test_times_from_the_agents_own_start_are_an_option_and_read_as_the_images(tmp_path: Path) -> None:
    sequences = ran(tmp_path / "run", DEFAULT.model_copy(update={"times": "agent"}))
    assert read_tum(tmp_path / "run" / "agent_01" / "trajectory.tum").stamps_ns[0] == 0
    result = Run.load(tmp_path / "run").agents[1]
    assert result.truth is not None
    for read in (result.trajectory, result.truth, result.keyframes):
        assert read.stamps_ns[0] == sequences[1].start_ns


def test_a_run_from_before_is_read_by_its_own_clock(done: tuple[Path, list[AgentSequence]], tmp_path: Path) -> None:
    """Before 0.3 times counted from the agent's start and the summary did not say so."""
    folder, sequences = done
    old = tmp_path / "old"
    ran(tmp_path / "zero", DEFAULT.model_copy(update={"times": "agent"}))
    shutil.copytree(tmp_path / "zero", old)
    summary = json.loads((old / "summary.json").read_text())
    for key in ("times", "coverage", "alignments", "left_out"):
        del summary[key]
    (old / "summary.json").write_text(json.dumps(summary))
    assert "Coverage" not in [section.title for section in sections(read_run(old))] and "tracked" not in table_of(old)
    today, before = read_run(folder), read_run(old)
    for one, other in zip(today.agents, before.agents, strict=True):
        np.testing.assert_array_equal(one.estimate.stamps_ns, other.estimate.stamps_ns)
        assert one.truth is not None and other.truth is not None
        np.testing.assert_array_equal(one.truth.stamps_ns, other.truth.stamps_ns)
        for owner, copy in one.copies.items():
            np.testing.assert_array_equal(copy.stamps_ns, other.copies[owner].stamps_ns)
    for here, there in zip(today.in_world, before.in_world, strict=True):
        np.testing.assert_allclose(here, there, atol=1e-9)
    assert Run.load(old).agents[0].coverage is None and today.position_at(1, sequences[1].start_ns) is not None


def test_colmap_images_have_the_names_of_their_files(done: tuple[Path, list[AgentSequence]]) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    folder, sequences = done
    for me in ("agent_00", "agent_01"):
        model = pycolmap.Reconstruction(str(folder / me / "maps" / "colmap"))
        names = {image.name for image in model.images.values()}
        own = sequences[int(me[-2:])].places.images
        assert set(own) < names <= {name for s in sequences for name in s.places.images}


def test_colmap_has_every_view_of_a_point(tmp_path: Path) -> None:
    """One agent: each image has a 2-D point for each observation of its key-frame, where the point is in its camera."""
    pycolmap = pytest.importorskip("pycolmap")
    alone = [named(make_sequence(make_world(3), circuit(0.0, 30.0), 3))]
    run(manifest_of(alone), alone, DEFAULT, tmp_path / "run")
    model = pycolmap.Reconstruction(str(tmp_path / "run" / "agent_00" / "maps" / "colmap"))
    (track,) = alone[0].tracks
    observed = np.bincount(track.observations[:, 0], minlength=len(track))
    seen = {image.name: image for image in model.images.values()}
    assert [seen[name].num_points2D() for name in alone[0].places.images] == observed.tolist()
    views = np.bincount(track.observations[:, 1])
    assert model.num_points3D() == (views > 1).sum(), "what one image alone sees is a pixel and no point"
    assert model.compute_mean_track_length() == pytest.approx(views[views > 1].mean()) and (
        model.compute_mean_track_length() > 3
    )
    camera = next(iter(model.cameras.values()))
    k = 7
    points = track.points[track.observations[track.observations[:, 0] == k, 1]]
    p = transform_points(se3_inverse(track.poses[k]), points)
    expected = p[:, :2] / p[:, 2:] * camera.params[:2] + camera.params[2:]
    found = np.array([q.xy for q in seen[alone[0].places.images[k]].points2D])
    np.testing.assert_allclose(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)], atol=1e-3)


def test_a_copy_has_the_views_of_its_owner_and_no_image_sees_a_point_twice(
    done: tuple[Path, list[AgentSequence]],
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    folder, sequences = done
    model = pycolmap.Reconstruction(str(folder / "agent_00" / "maps" / "colmap"))
    copied = [i for i in model.images.values() if i.name in sequences[1].places.images]
    views = [
        len(list(model.points3D[p.point3D_id].track.elements)) for i in copied for p in i.points2D if p.has_point3D()
    ]
    assert len(views) > 500 and np.mean(views) > 2
    for point in model.points3D.values():
        images = [element.image_id for element in point.track.elements]
        assert len(images) == len(set(images)) >= 1
