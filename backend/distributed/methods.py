"""Choice of the node for each method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from ..config import SolverConfig
from ..errors import BackendError
from .descent_node import DescentNode
from .elected import ElectedNode
from .elected_selection import SelectingNode
from .free_node import FreeNode
from .multifrontal.frontal_node import FrontalNode
from .node import Node
from .share import Share, SolverOutcome
from .two_level.two_level_node import TwoLevelNode
from .with_priors.prior_node import PriorNode

USE_PRIORS = ("elected", "multifrontal", "two-level", "rbcd")
"""Methods that use priors."""


class SolverNode(Protocol):
    """One robot's part in any method; what the messages are is the method's own matter."""

    share: Share
    outcome: SolverOutcome | None

    def start(self) -> Sequence[Any]:
        """The first messages."""

    def handle(self, message: Any) -> Sequence[Any]:
        """Take a message in; returns what is to be sent because of it. :class:`BackendError` where it makes no sense,
        which a message of another method does not."""

    def tick(self) -> Sequence[Any]:
        """It has waited long enough: what to send to go on. Counts silence where that leaves members out."""

    def again(self, message: Any) -> Sequence[Any]:
        """Return what the sender of ``message``, which came before, may have missed; changes nothing."""


def node_for(share: Share, config: SolverConfig) -> SolverNode:
    """One robot's part in the method that ``config`` names: start, handle, tick, outcome."""
    if config.robust != "none" and config.method not in ("rbcd", "elected"):
        raise BackendError(f"robust selection ({config.robust}) works with rbcd and elected, not {config.method}")
    if share.priors or share.positions:
        check_priors(config.method)
    if share.length_sigma and config.method != "elected":
        raise BackendError(
            f"lengths as unknowns (length_sigma) are known to central and elected, not to {config.method}"
        )
    if share.heading_sigma and not share.length_sigma:
        raise BackendError("headings as unknowns (heading_sigma_deg) are found beside lengths: set length_sigma too")
    if share.heading_sigma and config.elected_longest > 1:
        raise BackendError("headings as unknowns (heading_sigma_deg) need elected_longest 1: turns bend stretches")
    if share.length_sigma and config.robust != "none":
        raise BackendError(f"lengths as unknowns (length_sigma) do not go with robust selection ({config.robust})")
    if share.positions and config.method != "elected":
        return PriorNode(share, config, _plain_node)
    return _plain_node(share, config)


def check_priors(method: str) -> None:
    """:class:`BackendError` where a method, by the name that its user gave it, uses no priors."""
    if method not in USE_PRIORS:
        known = ", ".join(("central", *USE_PRIORS))
        raise BackendError(f"priors (GPS) are used by the methods {known}, not by {method}")


def _plain_node(share: Share, config: SolverConfig) -> SolverNode:
    match config.method:
        case "rbcd":
            return DescentNode(share, config)
        case "rbcd-async":
            return FreeNode(share, config)
        case "two-level":
            return TwoLevelNode(share, config)
        case "multifrontal":
            return FrontalNode(share, config)
        case "elected":
            return ElectedNode(share, config) if config.robust == "none" else SelectingNode(share, config)
        case _:
            return Node(share, config)
