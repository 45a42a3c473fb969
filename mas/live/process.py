"""The loop of one agent in its own process: images' times, messages and time go in, messages go out.

There is no common clock, no list of all agents, no word that all is over. An agent's logical time is that of its own
recording; times in messages travel as durations. It says how far it is (:class:`~.framing.DrivePhase`): once nobody
present drives any more it settles what it knows, and ends when nobody present has anything left to do.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from ..config import MasConfig
from ..contracts.effects import Effects
from ..protocol.messages import decode, encode
from ..protocol.tensors import MessageError
from .config import LiveConfig
from .cpu_parts import CpuParts
from .drive import Drive, RecordedDrive
from .durations import arrived, departing
from .framing import DrivePhase
from .neighbours import Met, Neighbours, Received
from .recorded_agent import RecordedAgent, signatures_in
from .signed_maps import MapSignatures, split_signed

# So many messages are handled before time goes on.
_AT_ONCE = 256
_LONGEST_WAIT_S, _SHORT_S, _LAST_FRAMES_S = 0.25, 0.02, 1.0
# Parts of CPU time, beside the purposes of messages: new key-frames, the policy's steps, frames and signatures.
KEYFRAMES, STEPS, LINK = "keyframes", "steps", "link"
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LiveProgress:
    """``seen`` of ``keyframes``, at the logical time ``now_ns``; ``neighbours``: how many agents are there."""

    now_ns: int
    seen: int
    keyframes: int
    phase: DrivePhase
    neighbours: int


class AgentProcess:
    """``agent`` with its ``neighbours``. ``began_ns``: logical time at which this process begins: 0, or that of the
    end of the journal that it goes on with. ``drive``: where key-frames come from; None: the agent's sequence.
    ``cpu``: takes the CPU time of messages by their purpose, of steps, key-frames and the link."""

    def __init__(
        self,
        agent: RecordedAgent,
        neighbours: Neighbours,
        config: MasConfig,
        live: LiveConfig,
        began_ns: int = 0,
        drive: Drive | None = None,
        cpu: CpuParts | None = None,
    ) -> None:
        self.agent = agent
        self.cpu = cpu or CpuParts()
        self.neighbours = neighbours
        self.config = config
        self.live = live
        self.drive = drive or RecordedDrive(agent)
        kept = signatures_in(agent.journal.path)
        self.signatures = MapSignatures(neighbours.credentials, agent.agent, kept)
        self._began_ns = began_ns
        self._step_ns = round(config.step_s * 1e9)
        self._next_tick = -(-began_ns // self._step_ns)
        self._zero = time.monotonic()
        self._reminded_ns = began_ns
        self._met: set[int] = set()
        self._still_since: float | None = None
        self._warned: dict[int, str] = {}

    @property
    def now_ns(self) -> int:
        """Logical time."""
        return self._began_ns + round((time.monotonic() - self._zero) * self.live.speed * 1e9)

    def run(self, progress: Callable[[LiveProgress], None], each: Callable[[], None] = lambda: None) -> None:
        """Until nobody present has anything left to do. However it ends, the others get notice that the agent goes.
        ``each`` is called after each step."""
        self._zero = time.monotonic()
        try:
            while self.step(progress):
                each()
        finally:
            self.leave()

    def step(self, progress: Callable[[LiveProgress], None]) -> bool:
        """Let time go on, and exchange messages until the next step or reminder; whether there is more to do."""
        self._time_goes_on(progress)
        self._exchange()
        return not self._over()

    def leave(self) -> None:
        """Give the others notice, and let the last frames go."""
        self.neighbours.announce(DrivePhase.LEAVING)
        until = time.monotonic() + _LAST_FRAMES_S
        while time.monotonic() < until and self.neighbours.busy:
            self.neighbours.flush()
            self.neighbours.receive(_SHORT_S)

    def _exchange(self) -> None:
        """Send what is due, and act on what comes until it is time for the next step."""
        with self.cpu.part(LINK):
            self.neighbours.flush()
            wait_s = self._wait_s()
            for _ in range(_AT_ONCE):
                came = self.neighbours.receive(wait_s)
                if came is None:
                    return
                for one in came:
                    self._take(one)
                wait_s = 0.0

    # -- what goes in -------------------------------------------------------------------------------------------------

    def _time_goes_on(self, progress: Callable[[LiveProgress], None]) -> None:
        now_ns, agent = self.now_ns, self.agent
        if now_ns >= self._next_tick * self._step_ns:
            self._next_tick = now_ns // self._step_ns + 1
            with self.cpu.part(KEYFRAMES):
                self.drive.observe(now_ns)
            self._note_phase(now_ns)
            self._reminded_ns = now_ns
            with self.cpu.part(STEPS):
                effects = agent.tick(now_ns)
            self._send(effects, now_ns)
            seen, known = agent.inputs.seen, self.drive.keyframes
            progress(LiveProgress(now_ns, seen, known, self.neighbours.phase, len(self._present())))
        elif agent.agent.waiting and now_ns - self._reminded_ns >= round(self.config.link.repeat_s * 1e9):
            self._remind(now_ns)

    def _remind(self, now_ns: int) -> None:
        self._reminded_ns = now_ns
        with self.cpu.part(STEPS):
            effects = self.agent.remind(now_ns)
        self._send(effects, now_ns)

    def _take(self, came: Received | Met) -> None:
        now_ns = self.now_ns
        if isinstance(came, Met):
            if came.other not in self._met:
                self._met.add(came.other)
                self.agent.meet(came.other, now_ns)
            return
        try:
            signed = split_signed(came.data)
            message = arrived(decode(signed.message, self.agent.inputs.max_message_bytes), now_ns)
            if message.recipient != self.neighbours.me:
                raise MessageError(f"a message for agent {message.recipient}")
            if message.sender != came.sender:
                raise MessageError(f"a message in the name of agent {message.sender}")
            # Contracts are judged by the time at which their messages come.
            if now_ns - self._reminded_ns >= round(self.config.link.repeat_s * 1e9):
                self._remind(now_ns)
            kept = self.signatures.check(message, signed.signatures, self.neighbours.certificate(came.sender))
        except MessageError as error:
            self._warn(came.sender, str(error))
            self._send(self.agent.refuse(came.sender, str(error), now_ns), now_ns)
            return
        self._still_since = None
        if kept:
            self.agent.keep_signatures(kept, now_ns)
        with self.cpu.part(message.body.traffic):
            effects = self.agent.handle(message, now_ns)
        self._send(effects, now_ns)

    def _send(self, effects: Effects, now_ns: int) -> None:
        with self.cpu.part(LINK):
            for message in effects.messages:
                data = encode(departing(message, now_ns))
                self.neighbours.send(message.recipient, self.signatures.seal(message, data))

    # -- the end ------------------------------------------------------------------------------------------------------

    def _present(self) -> dict[int, DrivePhase]:
        return {a: phase for a, phase in self.neighbours.phases().items() if phase is not DrivePhase.LEAVING}

    def _note_phase(self, now_ns: int) -> None:
        """Say how far the agent is, where that has changed."""
        inputs = self.agent.inputs
        driven = self.drive.over
        others = self._present().values()
        if not driven:
            phase = DrivePhase.DRIVING
        elif not inputs.agent.context.closing:
            # Its neighbours must know that it has arrived before any of them can close.
            phase = DrivePhase.CLOSING
            alone = not others and time.monotonic() - self._zero < self.live.alone_s
            if not alone and DrivePhase.DRIVING not in others:
                self.agent.finish(now_ns)
        else:
            # A phase that is not acknowledged yet keeps nobody busy: where answers take longer than a step, saying so
            # would be the next thing to say, without end.
            still = inputs.agent.quiet and not self.neighbours.sending
            phase = DrivePhase.RESTING if still else DrivePhase.CLOSING
        if phase is not self.neighbours.phase:
            self.neighbours.announce(phase)

    def _over(self) -> bool:
        if self.neighbours.phase is not DrivePhase.RESTING or any(
            p is not DrivePhase.RESTING for p in self._present().values()
        ):
            self._still_since = None
            return False
        now = time.monotonic()
        self._still_since = now if self._still_since is None else self._still_since
        return now - self._still_since >= self.live.settle_s

    def _wait_s(self) -> float:
        until_tick = (self._next_tick * self._step_ns - self.now_ns) / 1e9 / self.live.speed
        wait = min(until_tick, _LONGEST_WAIT_S)
        if self.agent.agent.waiting or self.neighbours.busy:
            wait = min(wait, self.config.link.repeat_s / self.live.speed, 0.05)
        return max(wait, 0.0)

    def _warn(self, other: int, text: str) -> None:
        """Say once what is wrong with another agent."""
        if self._warned.get(other) != text:
            self._warned[other] = text
            log.warning("agent %d: %s", other, text)
