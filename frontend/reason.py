"""Why a frame has no pose, or a doubtful one: a kind, and the sentence with its figures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reason:
    """One refusal, or one doubt about a pose. ``kind``: its cause without figures, so that refusals can be counted;
    ``text``: with the figure reached and the one needed. ``reached``: the figure as a share of what is needed, of a
    doubt as a share of its bound; of one kind the highest came nearest, or is the worst."""

    kind: str
    text: str
    reached: float = 0.0

    @classmethod
    def few(cls, kind: str, count: int, need: int, what: str) -> Reason:
        """``count`` where ``need`` are needed; ``what`` follows the count: "points found"."""
        return cls(kind, f"only {count} {what}, need {need}", count / max(need, 1))


NO_REASON = Reason("", "")
STANDS_SHORT = "the camera stands still, the track is too short"
"""Kind of a sequence that has one key-frame only, since its camera never moves."""


class Tally:
    """Refusals of a stretch of frames, counted by kind; it does not grow with the number of frames."""

    def __init__(self) -> None:
        self._kinds: dict[str, tuple[int, Reason]] = {}

    def add(self, refusal: Reason, frames: int = 1) -> None:
        """``frames`` more frames were refused for this reason."""
        count, best = self._kinds.pop(refusal.kind, (0, refusal))
        self._kinds[refusal.kind] = count + frames, refusal if refusal.reached >= best.reached else best

    def merge(self, other: Tally) -> None:
        """Add the refusals of another stretch, a later one."""
        for count, best in other._kinds.values():
            self.add(best, count)

    def main(self) -> tuple[int, Reason] | None:
        """The most frequent kind, of equals the latest: number of frames, and the refusal that came nearest."""
        ranked = sorted(self._kinds.values(), key=lambda entry: entry[0])
        return ranked[-1] if ranked else None

    def text(self, best_is: str = "nearest") -> str:
        """The main reason with its best figure, then the other kinds, most frequent first; empty without refusals."""
        ranked = sorted(self._kinds.values(), key=lambda entry: entry[0])[::-1]
        if not ranked:
            return ""
        count, best = ranked[0]
        of = f"{best_is} of {count} frames" if best.reached > 0 else f"{count} frames"
        parts = [f"{best.text} ({of})" if count > 1 else best.text]
        parts += [f"{other.kind} ({n} frame{'s'[n == 1 :]})" for n, other in ranked[1:]]
        return "; ".join(parts)
