"""The public face: quick to import, typed results, the command line's files, one BLAS thread, safe without a guard."""

from __future__ import annotations

import csv
import inspect
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import maslam
from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli

MEASURED = {"timing.json", "index.html"}
"""What shows measured times."""


@pytest.fixture(scope="module")
def run(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> maslam.Run:
    return maslam.slam(town_stereo, tmp_path_factory.mktemp("face") / "out", seed=3, settings=SETTINGS)


SETTINGS = {"places.gap_keyframes": 2, "odometry": {"features.landmarks": 500}}


def pools() -> set[int]:
    """Numbers of threads that BLAS libraries would use now."""
    from threadpoolctl import threadpool_info

    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


# -- importing ---------------------------------------------------------------------------------------------------------


def test_importing_costs_no_library_and_little_time() -> None:
    code = (
        "import sys, time; began = time.perf_counter(); import maslam; took = time.perf_counter() - began;"
        "print(took, [n for n in ('numpy', 'numba', 'cv2', 'scipy', 'pydantic') if n in sys.modules])"
    )
    said = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(3)]
    assert all(one.stdout.endswith(" []\n") for one in said)
    assert min(float(one.stdout.split()[0]) for one in said) < 0.2


def test_everything_promised_is_there_and_documented() -> None:
    promised = (
        "open_dataset Odometry NetVlad preprocess run slam evaluate read_g2o write_g2o optimise optimise_distributed "
        "preset MaslamError __version__"
    )
    assert set(promised.split()) <= set(maslam.__all__) == {*maslam.__all__} and len(set(maslam.__all__)) == len(
        maslam.__all__
    )
    for name in maslam.__all__:
        thing = getattr(maslam, name)
        assert isinstance(thing, str) or inspect.getdoc(thing), name
        assert name in dir(maslam)
    with pytest.raises(AttributeError, match="no attribute 'slamm'"):
        maslam.slamm  # type: ignore[attr-defined]  # noqa: B018


def test_all_errors_have_one_root() -> None:
    from maslam.backend.errors import BackendError
    from maslam.descriptors.errors import DescriptorError
    from maslam.frontend.errors import FrontendError
    from maslam.mas.errors import MasError
    from maslam.tools.common.errors import UsageError

    for error in (BackendError, DescriptorError, FrontendError, MasError, UsageError):
        assert issubclass(error, maslam.MaslamError)


# -- the same as the command line --------------------------------------------------------------------------------------


def test_the_files_are_those_of_the_command(run: maslam.Run, town_stereo: Path, tmp_path: Path) -> None:
    words = ["--seed", "3", "--places.gap-keyframes", "2", "--odometry.features.landmarks", "500"]
    assert cli.main(["slam", str(town_stereo), str(tmp_path / "out"), "--workers", "2", "--quiet", *words]) == 0
    names = [
        {p.relative_to(f) for p in f.rglob("*") if p.is_file() and p.name not in MEASURED}
        for f in (run.folder, tmp_path / "out")
    ]
    assert names[0] == names[1] and len(names[0]) > 40
    assert [n for n in names[0] if (run.folder / n).read_bytes() != (tmp_path / "out" / n).read_bytes()] == []


def test_blas_has_one_thread_inside_every_call(town_stereo: Path, tmp_path: Path) -> None:
    from threadpoolctl import threadpool_limits

    inside: list[set[int]] = []

    class Watching(maslam.Policy):
        def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
            inside.append(pools())
            return []

        def optimise(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
            return []

        def buy(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
            return []

    class Words:
        """A vocabulary that is asked at the end of a track."""

        def words(self, descriptors: np.ndarray) -> np.ndarray:
            inside.append(pools())
            return np.zeros((len(descriptors), 2), dtype=np.int32)

        def bag(self, descriptors: np.ndarray) -> object:
            raise NotImplementedError

    def told(title: str, done: int, total: int) -> None:
        inside.append(pools())

    with threadpool_limits(3):
        sequences = maslam.preprocess(town_stereo, tmp_path / "seqs", progress=told)
        after_preprocess = len(inside)
        maslam.run(sequences, tmp_path / "run", policy=Watching())
        after_run = len(inside)
        sequence = maslam.open_dataset(town_stereo).sequences[0]
        odometry = maslam.Odometry(sequence.rig, vocabulary=Words())  # type: ignore[arg-type]
        for frame in sequence.frames(0, 6):
            odometry.process(frame)
        odometry.finish()
        assert pools() == {3}
    assert 0 < after_preprocess < after_run < len(inside)
    assert all(numbers == {1} for numbers in inside)


def test_each_frame_is_processed_on_one_thread(town_stereo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from threadpoolctl import threadpool_limits

    from maslam.frontend import odometry

    inside: list[set[int]] = []
    monkeypatch.setattr(odometry.Odometry, "process", lambda self, frame: inside.append(pools()))
    sequence = maslam.open_dataset(town_stereo).sequences[0]
    with threadpool_limits(3):
        maslam.Odometry(sequence.rig).process(sequence.read(0))
        assert inside == [{1}] and pools() == {3}


# -- results -----------------------------------------------------------------------------------------------------------


def test_a_run_holds_what_its_files_say(run: maslam.Run) -> None:
    said = json.loads((run.folder / "summary.json").read_text())
    assert run.summary.model_dump(mode="json") == said and run.summary.seed == 3
    assert run.timing.wall_s > 0 and run.report == run.folder / "report" / "index.html"
    assert run.config.places.gap_keyframes == 2 and run.config.preset == "maslam"
    assert run.manifest.settings["odometry"]["features"]["landmarks"] == 500
    assert [agent.name for agent in run.agents] == ["agent_00", "agent_01"]
    for agent, trajectory in zip(run.agents, run.trajectories, strict=True):
        read = read_tum(run.folder / agent.name / "trajectory.tum")
        np.testing.assert_array_equal(trajectory.poses, read.poses)
        assert len(agent.keyframes) == said["keyframes_placed"][agent.index]
        assert agent.truth is not None and len(agent.graph.poses) >= len(agent.keyframes) and agent.map_file.is_file()
        error = maslam.evaluate(trajectory, agent.truth)
        assert error.rmse_m == pytest.approx(said["ate_rmse_m"]["agents"][agent.index], rel=1e-3)
    with open(run.folder / "matches.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [m.outcome for m in run.matches] == [row["outcome"] for row in rows]
    assert sum(match.accepted for match in run.matches) == said["matches"]["accepted"] > 0
    accepted = next(match for match in run.matches if match.accepted)
    assert accepted.T_M_Q is not None and accepted.false is False
    assert run.timeline["time_s"][-1] > 0


def test_a_run_is_repeated_from_its_own_settings(run: maslam.Run, tmp_path: Path) -> None:
    again = maslam.run(run.folder / "sequences", tmp_path / "again", preset=run.config)
    assert again.summary == maslam.evaluate(run) == maslam.Run.load(run.folder).summary


def test_odometry_alone_is_what_preprocessing_does(run: maslam.Run, town_stereo: Path) -> None:
    sequence = maslam.open_dataset(town_stereo).sequences[0]
    odometry = maslam.Odometry(sequence.rig, settings={"features.landmarks": 500})
    for frame in sequence.frames():
        odometry.process(frame)
    (trajectory,) = odometry.finish().trajectories
    kept = maslam.Sequences.load(run.folder / "sequences").read()[0].trajectory
    np.testing.assert_array_equal(trajectory.stamps_ns - sequence.stamps_ns[0], kept.stamps_ns)
    np.testing.assert_allclose(trajectory.poses, kept.poses, atol=1e-8)


# -- what can be wrong -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"places.treshold": 0.8}, "the settings: unknown setting 'places.treshold'; did you mean 'places.threshold'?"),
        ({"places": {"threshold": 7}}, "the settings: places.threshold: input should be less than or equal to 2"),
        ({"seed": 1, "seed.x": 2}, "'seed.x' and 'seed' cannot both be set"),
        ({"policy": "quary_all"}, "there is no policy 'quary_all'; did you mean 'query_all'?"),
    ],
)
def test_a_wrong_setting_is_said_before_any_work(settings: dict[str, object], said: str, tmp_path: Path) -> None:
    with pytest.raises(maslam.MaslamError, match=r".") as caught:
        maslam.slam(tmp_path / "nothing", tmp_path / "out", settings=settings)
    assert said in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_other_mistakes_are_one_line_each(tmp_path: Path, run: maslam.Run) -> None:
    truth = run.agents[0].truth
    assert truth is not None
    later = maslam.Trajectory(truth.stamps_ns + 10**12, truth.poses)
    mistakes = {
        "rig: 'stero': one of mono, stereo, rgbd": lambda: maslam.open_dataset(tmp_path, rig="stero"),
        "no such folder": lambda: maslam.open_dataset(tmp_path / "none"),
        "no summary.json": lambda: maslam.Run.load(tmp_path),
        "there is no preset 'best'": lambda: maslam.run(tmp_path, tmp_path / "out", preset="best"),
        "preprocessing knows 'odometry.": lambda: maslam.preprocess(tmp_path, tmp_path, settings={"seed": 1}),
        "workers: at least 1, not 0": lambda: maslam.preprocess(tmp_path, tmp_path, workers=0),
        "0 of 20 poses have a true one": lambda: maslam.evaluate(later, truth),
        "a trajectory is compared with the truth": lambda: maslam.evaluate(truth),  # type: ignore[call-overload]
    }
    for said, call in mistakes.items():
        with pytest.raises(maslam.MaslamError) as caught:
            call()
        assert said in str(caught.value) and "\n" not in str(caught.value)


# -- graphs ------------------------------------------------------------------------------------------------------------


def test_graphs_are_read_optimised_and_written(tmp_path: Path) -> None:
    from maslam.backend.geometry import se3_exp

    rng = np.random.default_rng(0)
    truth = np.array([se3_exp(np.array([k, 0.3 * k, 0, 0, 0, 0.2 * k])) for k in range(12)])
    nodes = [maslam.NodeId(k // 6, k % 6) for k in range(12)]
    pairs = [(k, k + 1) for k in range(11)] + [(0, 7), (2, 9), (5, 11)]
    edges = tuple(maslam.Edge(nodes[i], nodes[j], np.linalg.inv(truth[i]) @ truth[j]) for i, j in pairs)
    noisy = {n: T @ se3_exp(0.1 * rng.normal(size=6)) for n, T in zip(nodes, truth, strict=True)}
    maslam.write_g2o(tmp_path / "two.g2o", maslam.PoseGraph(noisy, edges))
    graph = maslam.read_g2o(str(tmp_path / "two.g2o"))
    central = maslam.optimise(graph, cost="U")
    assert central.cost_before > 0.1 and central.cost_after < 1e-9
    shared = maslam.optimise_distributed(graph, method="rbcd", settings={"cost_tolerance": 1e-12})
    assert shared.traffic.wire_bytes > 0 and len(shared.outcomes) == 2
    assert len(repr(shared)) < 2000 and "2 robots, 12 poses, 14 edges" in repr(shared), "a notebook prints it"
    maslam.write_g2o(tmp_path / "solved.g2o", central.graph)
    assert maslam.optimise(maslam.read_g2o(tmp_path / "solved.g2o"), cost="U").cost_before < 1e-9
    with pytest.raises(maslam.MaslamError, match="did you mean 'iterations'"):
        maslam.optimise(graph, settings={"iteration": 3})


def test_robots_with_one_camera_find_their_units() -> None:
    """Robot 1 measures in half metres that shrink: two matches say so, and the metric robot's metre is everybody's."""
    units = {NodeId(r, k): 1.0 if r == 0 else 0.5 * 0.98**k for r in range(2) for k in range(6)}
    truth = {NodeId(r, k): se3(so3_exp([0.0, 0.1 * k, 0.0]), [k, 0.2 * k, 3.0 * r]) for r in range(2) for k in range(6)}
    pairs = [(NodeId(r, k), NodeId(r, k + 1)) for r in range(2) for k in range(5)]
    pairs += [(NodeId(0, k), NodeId(1, k)) for k in (0, 5)]
    edges = []
    for i, j in pairs:
        T = se3_inverse(truth[i]) @ truth[j]
        T[:3, 3] /= units[i]
        kind = EdgeKind.SEPARATOR if i.robot != j.robot else EdgeKind.ODOMETRY
        edges.append(Edge(i, j, T, 100.0 * np.eye(6), kind, units[j] / units[i]))
    graph = PoseGraph({n: truth[NodeId(n.robot, 0)] for n in truth}, tuple(edges))
    found = maslam.optimise_distributed(graph, method="elected", monocular=[1])
    for n, T in truth.items():
        np.testing.assert_allclose(found.graph.poses[n], T, atol=1e-3)
        assert found.units[n] == pytest.approx(units[n], rel=1e-3)
    assert maslam.optimise_distributed(found.graph, method="elected").outcomes[0].cost_before < 1e-3, "in one unit"
    with pytest.raises(maslam.MaslamError, match="no robot 7"):
        maslam.optimise_distributed(graph, monocular=[7])


def test_a_world_is_rendered_as_the_command_renders_it(tmp_path: Path) -> None:
    pytest.importorskip("open3d")
    told: list[tuple[str, int, int]] = []
    world = maslam.render(
        tmp_path / "face",
        agents=2,
        frames=1,
        rig="rgbd",
        size=(64, 48),
        seed=3,
        settings={"cheap": True, "rate_hz": 5.0},
        progress=lambda *step: told.append(step),
    )
    words = "--agents 2 --frames 1 --rig rgbd --size 64x48 --seed 3 --cheap true --rate-hz 5 --workers 1 --quiet"
    assert cli.main(["render", str(tmp_path / "command"), *words.split()]) == 0
    made, same = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / "face", tmp_path / "command")
    )
    assert made and made == same
    assert [s.rig.kind for s in world.sequences] == [maslam.RigKind.RGBD] * 2 and told[-1] == ("images", 2, 2)
    with pytest.raises(maslam.MaslamError, match="did you mean 'light_change'"):
        maslam.render(tmp_path / "face", settings={"light_chang": 0.5})
    with pytest.raises(maslam.MaslamError, match="agents"):
        maslam.render(tmp_path / "face", agents=0)
    with pytest.raises(maslam.MaslamError, match="workers: at least 1, not 0"):
        maslam.render(tmp_path / "other", workers=0)
    with pytest.raises(maslam.MaslamError, match="face"):
        maslam.render(tmp_path / "face", agents=3)
