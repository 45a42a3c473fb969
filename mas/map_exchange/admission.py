"""Whether a map that was bought is kept, and where it is laid (thesis section 3.9.3). Pure.

First a map that stands far from where place matches say is laid on them (consistency check); then one that no match
agrees with is rejected (accuracy check); then, if the old copy agreed with all matches, only what is new is taken
(redundancy check).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..protocol.ids import MatchId
from ..state.agent_state import AgentState
from .evidence_checks import EvidenceStatistics, Witness, best_motion, evidence_of, tolerance, witnesses
from .map_copy import MapCopy, with_new_keyframes
from .purchase import ArrivedMap


@dataclass(frozen=True, eq=False)
class Admission:
    """``copy``: the map as it is kept, None if it is rejected, with the ``reason``; ``evidence``: how far it is off
    the place matches then; ``aligned_by``: the match it was laid on, ``redundant``: only new key-frames were taken."""

    copy: MapCopy | None
    evidence: EvidenceStatistics | None
    reason: str = ""
    aligned_by: MatchId | None = None
    redundant: bool = False

    def remarks(self) -> dict[str, Any]:
        """For events: how many place matches, how far off, and what was done."""
        out: dict[str, Any] = {"matches": 0} if self.evidence is None else dict(self.evidence.figures())
        if self.aligned_by is not None:
            out["aligned_by"] = str(self.aligned_by)
        if self.redundant:
            out["redundant"] = True
        return out


@dataclass(frozen=True, eq=False)
class AlignedMap:
    """A map copy after the consistency check, with its ``witnesses`` where it stands now; ``aligned_by``: the match
    that it was laid on, None where it stayed."""

    copy: MapCopy
    witnesses: list[Witness]
    aligned_by: MatchId | None = None


def admit(arrived: ArrivedMap, old: MapCopy | None, state: AgentState, others: Mapping[int, MapCopy]) -> Admission:
    """Judge a map that came in; ``old``: the copy that is here. The match that it was placed by cannot judge it."""
    verdict = _judged(arrived, witnesses(arrived.copy, state, others), state)
    same = tolerance(state.config.merge.redundancy_m, state)
    if verdict.copy is not None and old is not None and same is not None:
        before = evidence_of(witnesses(old, state, others))
        if before is not None and before.worst_m <= same:
            return Admission(with_new_keyframes(old, verdict.copy), before, redundant=True)
    return verdict


def recheck(copy: MapCopy, state: AgentState, others: Mapping[int, MapCopy]) -> Admission:
    """Judge a map that is held. It may have been laid on any of its matches, so the one that agrees best says nothing
    where there are others."""
    found = witnesses(copy, state, others)
    best = min(found, key=lambda w: w.metres).match if len(found) > 1 else None
    return _judged(ArrivedMap(copy, best), found, state)


def _judged(arrived: ArrivedMap, found: list[Witness], state: AgentState) -> Admission:
    """Consistency, then accuracy."""
    now = aligned(arrived.copy, found, state)
    limit = tolerance(state.config.merge.accuracy_m, state)
    judges = _judges(now.witnesses, state, {arrived.placed_by, now.aligned_by})
    how = evidence_of(judges) if limit is not None else None
    if how is not None and limit is not None:
        agree = sum(w.metres <= limit for w in judges)
        off = f"{how.matches} of them, off by {how.least_m:.2f} to {how.worst_m:.2f}"
        if not agree:
            return Admission(None, how, f"no place match agrees: {off}")
        if agree < state.config.merge.accuracy_share * len(judges):
            return Admission(None, how, f"few place matches agree: {agree} of {off}")
    return Admission(now.copy, evidence_of(now.witnesses), aligned_by=now.aligned_by)


def _judges(found: list[Witness], state: AgentState, placing: set[MatchId | None]) -> list[Witness]:
    """The witnesses but those that placed the map. Where a share of them must agree, those of the same key-frame of the
    map say nothing new either: it is there already, however wrong the rest of the map is."""
    judges = [w for w in found if w.match not in placing]
    if not state.config.merge.accuracy_share:
        return judges
    there = [w.found.translation for w in found if w.match in placing]
    return [w for w in judges if not any(np.array_equal(w.found.translation, p) for p in there)] or judges


def aligned(copy: MapCopy, found: list[Witness], state: AgentState) -> AlignedMap:
    """The consistency check: the map, laid on a match where its witnesses ``found`` say that it stands too far off."""
    limit = tolerance(state.config.merge.consistency_m, state)
    if copy.frame == state.frame and not any(state.me in w.match.agents for w in found):
        limit = None  # it stands where its owner has it; another copy, perhaps an older one, does not know better
    how = evidence_of(found) if limit is not None else None
    if how is None or limit is None or how.median_m <= limit:
        return AlignedMap(copy, found)
    motion, match = best_motion(found)
    return AlignedMap(copy.moved(motion), [w.after(motion) for w in found], match)
