"""The front end's and a sweep's work on a Ray cluster: two nodes on this machine give what its own processes give."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from maslam.frontend.config import OdometryConfig
from maslam.tools import cli
from maslam.tools.common.cluster import run_on_cluster
from maslam.tools.common.errors import ToolError
from maslam.tools.common.progress import Silent
from maslam.tools.pipeline.preprocess import preprocess
from maslam.tools.pipeline.preprocess_options import PreprocessSettings

ray = pytest.importorskip("ray", reason="the extra 'ray' is not installed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a cluster of two nodes with one core each."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:  # its processes find this file
        patch.setenv(
            "PYTHONPATH", os.pathsep.join(filter(None, (str(Path(__file__).parent), os.environ.get("PYTHONPATH"))))
        )
        yield from _running(Cluster)


def _running(Cluster: Any) -> Iterator[str]:
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    made.add_node(num_cpus=1)
    yield made.address
    made.shutdown()


def where(job: int, advance: Callable[[int], None]) -> tuple[str, str | None]:
    if job < 0:
        raise ToolError("a job that fails")
    time.sleep(3.0)  # long enough for the other node to take one
    return ray.get_runtime_context().get_node_id(), os.environ.get("OMP_NUM_THREADS")


def test_jobs_go_to_both_nodes_and_one_that_fails_stops_no_other(cluster: str) -> None:
    jobs = {f"job {n}": (n, 1) for n in (0, 1, 2, -1)}
    done = run_on_cluster(where, jobs, cluster, Silent())
    assert list(done) == list(jobs)
    assert str(done["job -1"].error) == "a job that fails"
    results = [one.result for one in done.values() if one.result is not None]
    assert len(results) == 3 and len({node for node, _ in results}) == 2
    assert {threads for _, threads in results} == {"1"}
    assert not ray.is_initialized()


def test_a_data_set_is_preprocessed_as_by_this_machine_alone(cluster: str, town_stereo: Path, tmp_path: Path) -> None:
    alone = PreprocessSettings(OdometryConfig(), workers=1)
    there = PreprocessSettings(OdometryConfig(), workers=1, ray=cluster)
    first = preprocess(town_stereo, tmp_path / "alone", alone, Silent())
    second = preprocess(town_stereo, tmp_path / "there", there, Silent())
    assert first == second and len(first.agents) == 2
    files = sorted(p.relative_to(tmp_path / "alone") for p in (tmp_path / "alone").rglob("agent_*/*"))
    assert (
        files
        and [f for f in files if (tmp_path / "alone" / f).read_bytes() != (tmp_path / "there" / f).read_bytes()] == []
    )


def test_where_no_cluster_is_it_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], town_stereo: Path) -> None:
    assert cli.main(["preprocess", str(town_stereo), str(tmp_path / "out"), "--ray", "127.0.0.1:1", "--quiet"]) == 1
    assert "--ray 127.0.0.1:1: no Ray cluster there: " in capsys.readouterr().err
