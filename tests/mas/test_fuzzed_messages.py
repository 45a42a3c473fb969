"""No message of any content ends an agent: real ones, changed, to live agents in the states in which those came."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fuzz_messages import Findings, Moment, copied, fuzzed, handed, moments, systems
from hypothesis import given, settings
from hypothesis import strategies as st

from maslam.backend.distributed.multifrontal.frontal_node import FrontalNode
from maslam.backend.geometry import Sim3
from maslam.backend.relpose.verification import Verdict
from maslam.mas.place_recognition import verification
from maslam.mas.protocol.messages import Failure, decode
from maslam.mas.protocol.tensors import MessageError

LIMIT = 2**24


@cache
def some(name: str) -> list[Moment]:
    return moments(systems()[name], 2, agents=2, keyframes=8)


@pytest.mark.parametrize("name", ["maslam", "default", "rbcd", "multifrontal", "two-level"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=6, deadline=None)
def test_nothing_escapes(name: str, seed: int) -> None:
    found = fuzzed(some(name), 16, seed)
    assert not found.escaped and found.tried == 16


def test_what_a_solver_raises_ends_no_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    def raising(self: FrontalNode, message: object) -> list[object]:
        raise IndexError("index 7 is out of bounds")

    chosen = [m for m in some("multifrontal") if m.kind == "SolverUpdate"]
    monkeypatch.setattr(FrontalNode, "handle", raising)
    found = Findings()
    for moment in chosen:
        handed(replace(moment, agent=copied(moment.agent)), moment.data, found)
    assert chosen and found.tried == len(chosen)
    assert any("IndexError: index 7" in what for what in found.unforeseen)


def test_a_verdict_beyond_all_bounds_is_a_failure_and_ends_no_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    far = Sim3(np.eye(3), np.array([1e12, 0.0, 0.0]))
    verdict = Verdict(False, "too few inliers", far, matches=9, inliers=4, rmse=0.1, full_information=None)
    monkeypatch.setattr(verification, "verify", lambda *_: verdict)
    moment = next(m for m in some("maslam") if m.kind == "VerifyTask")
    effects = copied(moment.agent).handle(decode(moment.data, LIMIT))
    assert [type(m.body) for m in effects.messages] == [Failure]


def test_half_of_all_changed_messages_pass_decoding() -> None:
    found = fuzzed(some("default"), 120, 0)
    assert not found.escaped and found.decoded >= 60


@given(kinds=st.integers(0, 10**6), depth=st.integers(1, 3000), array=st.booleans())
@settings(max_examples=40, deadline=None)
def test_nesting_of_any_depth_is_an_error_and_no_crash(kinds: int, depth: int, array: bool) -> None:
    chosen = some("default")
    data = chosen[kinds % len(chosen)].data
    nested = (b"\x91" if array else b"\x81\x01") * depth + b"\xc0"
    for bad in (data[:-1] + nested, b"\x96" + data[1:] + nested):
        with pytest.raises(MessageError):
            raise_unless_whole(bad)


def raise_unless_whole(data: bytes) -> None:
    """Decode; a further element at the end is skipped where it is not too deep, which is no crash either."""
    decode(data, LIMIT)
    raise MessageError("skipped")
