"""Real messages, changed in a few places, given to agents in the states in which the real ones came.

``python tests/mas/fuzz_messages.py 100000 [SEED]`` (``make fuzz``) tries so many and tells what escaped; a bounded
number is tried in ``test_fuzzed_messages.py``. Most changed messages still pass decoding: what decoding refuses tests
nothing behind it.
"""

from __future__ import annotations

import copy
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np
from factory import town
from scipy.sparse.linalg import SuperLU

from maslam._replaced import replaced
from maslam.mas.agent import Agent
from maslam.mas.config import MasConfig
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.messages import Message, decode, encode
from maslam.mas.protocol.tensors import MessageError
from maslam.mas.simulation import Environment, make_agents, make_transport
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.transport.transport import InProcessTransport, RefusedMessage

# Factors of matrices never change, and cannot be copied.
copy._deepcopy_dispatch[SuperLU] = lambda one, memo: one  # type: ignore[attr-defined]
LIMIT = 2**24
_IN_A_ROW = 8
METHODS = ("rbcd", "multifrontal", "two-level")
INTEGERS = [0, 1, 2, 3, 7, 77, 255, 4095, 10**5, 2**31, 2**32 - 1, 2**62, -1]
FLOATS = [0.0, -0.0, 1.0, -1.0, 1e-9, 1e-300, 1e6, 1e9, 1e30, 1e308, float("inf"), float("nan")]


@dataclass
class Moment:
    """An agent just before a message came to it; ``bytes`` of that message."""

    agent: Agent
    data: bytes
    kind: str
    now_ns: int


@dataclass
class Findings:
    """What came of changed messages: how many, how many of them passed decoding, what escaped from where, and what a
    solver's node raised that it should have refused itself (the agent refuses it then)."""

    tried: int = 0
    decoded: int = 0
    slowest_s: float = 0.0
    slowest: str = ""
    escaped: Counter[str] = field(default_factory=Counter)
    unforeseen: Counter[str] = field(default_factory=Counter)


def moments(config: MasConfig, each: int, agents: int = 3, keyframes: int = 12) -> list[Moment]:
    """Moments of a short run: ``each`` of every kind of message, spread over the run."""
    manifest, sequences = town(agents, keyframes, spacing_m=6.0, drifting=0.03)
    team = make_agents(manifest, sequences, config)
    environment = Environment(
        team, [keyframes_of(s) for s in sequences], make_transport(config, lambda sent: None), config
    )
    kept: dict[str, list[Moment]] = {}
    seen: Counter[str] = Counter()

    def before(agent: Agent, message: Message) -> None:
        kind = message.body.kind
        seen[kind] += 1
        places = kept.setdefault(kind, [])
        # Powers of two: the first ones, and later ones more and more rarely.
        if len(places) < each or seen[kind] & (seen[kind] - 1) == 0:
            places.append(Moment(copied(agent), encode(message), kind, environment.now_ns))
            del places[: max(len(places) - each, 0)]

    for agent in team:
        handle = agent.handle
        agent.handle = lambda m, agent=agent, handle=handle: (before(agent, m), handle(m))[1]  # type: ignore[method-assign,misc]
    for number in range(environment.steps + 40):
        environment.step(number)
        if number >= environment.steps and environment.over:
            break
    for places in kept.values():
        for moment in places:
            vars(moment.agent).pop("handle", None)
    return [m for _, places in sorted(kept.items()) for m in places]


def copied(agent: Agent) -> Agent:
    """The agent as it is; key-frames never change and are shared."""
    state = agent.state
    shared: list[Any] = [state.profile, state.config, agent.policy, *state.keyframes, *state.verified.values()]
    memo: dict[int, Any] = {id(one): one for one in shared}
    handle = vars(agent).pop("handle", None)
    out = copy.deepcopy(agent, memo)
    if handle is not None:
        agent.handle = handle  # type: ignore[method-assign]
    return out


class Changer:
    """Changes messages; everything drawn from ``rng``."""

    def __init__(self, rng: np.random.Generator, pool: list[Any]) -> None:
        self.rng, self.pool = rng, pool

    def changed(self, data: bytes) -> bytes:
        """The message with one to three changes; mostly one that still decodes, if one of a few does."""
        for _ in range(6):
            fields = msgspec.msgpack.decode(data)
            for _ in range(int(self.rng.integers(1, 4))):
                self._change(fields)
            out = msgspec.msgpack.encode(fields)
            if self._decodes(out):
                return out
        return out

    def _decodes(self, data: bytes) -> bool:
        try:
            decode(data, LIMIT)
        except MessageError:
            return False
        return True

    def _change(self, fields: Any) -> None:
        paths = list(_paths(fields[3], [3]))
        path = paths[int(self.rng.integers(len(paths)))]
        target = fields
        for key in path[:-1]:
            target = target[key]
        old = target[path[-1]]
        if isinstance(old, list) and old and self.rng.random() < 0.7:
            self._restructure(old)
            return
        target[path[-1]] = self._other(old)

    def _restructure(self, part: list[Any]) -> None:
        k = int(self.rng.integers(len(part)))
        match int(self.rng.integers(3)):
            case 0:
                del part[k]
            case 1:
                part.insert(k, copy.deepcopy(part[k]))
            case 2:
                part[k] = copy.deepcopy(self.pool[int(self.rng.integers(len(self.pool)))])

    def _other(self, value: Any) -> Any:
        rng = self.rng
        if isinstance(value, bool):
            return not value
        if isinstance(value, int):
            return int(rng.choice([value + 1, max(value - 1, 0), *INTEGERS]))
        if isinstance(value, float):
            return float(rng.choice([*FLOATS, -value, 3 * value, 1.001 * value]))
        if isinstance(value, bytes) and value:
            return self._bytes(value)
        if isinstance(value, str):
            return value + "x" * int(rng.choice([0, 1, 300]))
        return None if rng.random() < 0.5 else int(rng.choice(INTEGERS))

    def _bytes(self, value: bytes) -> bytes:
        rng = self.rng
        kind = int(rng.integers(4))
        if kind == 0 and len(value) % 4 == 0:
            wide = "<f8" if len(value) % 8 == 0 and rng.random() < 0.5 else "<f4"
            numbers = np.frombuffer(value, dtype=wide).copy()
            with np.errstate(over="ignore"):
                numbers[int(rng.integers(len(numbers)))] = rng.choice(FLOATS)
            return numbers.tobytes()
        if kind == 1:
            return value[: int(rng.integers(len(value)))] + rng.bytes(int(rng.integers(0, 9)))
        out = bytearray(value)
        for _ in range(int(rng.integers(1, 4))):
            out[int(rng.integers(len(out)))] = int(rng.integers(256))
        return bytes(out)


def _paths(value: Any, path: list[int]) -> Any:
    if len(path) > 1:
        yield path
    if isinstance(value, list):
        for k, part in enumerate(value):
            yield from _paths(part, [*path, k])


def pool_of(chosen: list[Moment]) -> list[Any]:
    """Parts of real messages."""
    parts: list[Any] = []
    for moment in chosen:
        body = msgspec.msgpack.decode(moment.data)[3]
        for path in _paths(body, []):
            part = body
            for key in path:
                part = part[key]
            if len(msgspec.msgpack.encode(part)) < 4000:
                parts.append(part)
    return parts[:5000]


def handed(moment: Moment, data: bytes, findings: Findings) -> None:
    """Hand bytes to the moment's agent, by a transport; then time goes on. Whatever is raised escapes."""
    agent = moment.agent
    transport = InProcessTransport(LIMIT)
    sender = msgspec.msgpack.decode(moment.data)[0]
    findings.tried += 1
    started = time.perf_counter()
    transport.carry(sender, agent.state.me, data)
    message = transport.receive()
    if isinstance(message, RefusedMessage):
        agent.refuse(message.sender, message.reason)
    elif message is not None:
        findings.decoded += 1
        effects = agent.handle(message)
        effects += agent.tick(moment.now_ns) + agent.remind(moment.now_ns + 10**7)
        for answer in effects.messages:
            decode(encode(answer), LIMIT)
        reasons = [str(event.fields.get("reason", "")) for event in effects.events]
        findings.unforeseen.update(f"{moment.kind}: {r}" for r in reasons if "leads nowhere" in r)
    took = time.perf_counter() - started
    if took > findings.slowest_s:
        findings.slowest_s, findings.slowest = took, moment.kind


def fuzzed(chosen: list[Moment], count: int, seed: int, until_s: float = float("inf")) -> Findings:
    """So many changed messages, a few in a row to a copy of an agent in a true state; then a long time passes there."""
    rng, findings = np.random.default_rng(seed), Findings()
    changer, began = Changer(rng, pool_of(chosen)), time.perf_counter()
    moment, left = chosen[0], 0
    for _ in range(count):
        if not left:
            moment = chosen[int(rng.integers(len(chosen)))]
            moment, left = replace(moment, agent=copied(moment.agent)), _IN_A_ROW
        left -= 1
        try:
            handed(moment, changer.changed(moment.data), findings)
            if not left:
                moment.agent.tick(moment.now_ns + 10**11)
        except Exception as error:  # noqa: BLE001 - whatever it is, it escaped
            where = traceback.extract_tb(error.__traceback__)[-1]
            findings.escaped[
                f"{moment.kind}: {type(error).__name__} {str(error)[:80]} {where.filename[-40:]}:{where.lineno}"
            ] += 1
        if time.perf_counter() - began > until_s:
            break
    return findings


def systems() -> dict[str, MasConfig]:
    """The presets, and ours with each other solver."""
    out = {name: preset(name) for name in ("maslam", "default", "selection")}
    ours = out["maslam"].optimisation
    for method in METHODS:
        solver = replaced(ours.solver, method=method, length_sigma=0.0)
        out[method] = replaced(out["maslam"], optimisation=replaced(ours, solver=solver))
    return out


def main(count: int, seed: int, until_s: float = float("inf")) -> int:
    warnings.simplefilter("ignore")
    out, done, escaped, unforeseen = sys.stdout, 0, Counter[str](), Counter[str]()
    variants = systems()
    for number, (name, config) in enumerate(variants.items()):
        chosen = moments(config, 6)
        if number > 2:  # of another solver its messages are new
            chosen = [m for m in chosen if m.kind.startswith("Solver") or m.kind == "OptimiseTask"]
        found = fuzzed(chosen, count // len(variants), seed + number, until_s / len(variants))
        out.write(
            f"{name}: {found.tried} messages, {found.decoded} passed decoding, slowest {found.slowest_s:.2f} s "
            f"({found.slowest}), {sum(found.escaped.values())} errors escaped\n"
        )
        escaped += found.escaped
        unforeseen += found.unforeseen
        done += found.tried
    for what, times in escaped.most_common():
        out.write(f"  {times} x {what}\n")
    for what, times in unforeseen.most_common():
        out.write(f"  caught at the agent: {times} x {what}\n")
    return 1 if escaped else 0


if __name__ == "__main__":
    sys.exit(
        main(
            int(sys.argv[1]),
            int(sys.argv[2]) if len(sys.argv) > 2 else 0,
            float(sys.argv[3]) if len(sys.argv) > 3 else float("inf"),
        )
    )
