"""The predecessor (thesis sections 2.2.3 and 4.1; Cieslewski, Choudhary and Scaramuzza, ICRA 2018): ask the owner of
the cluster, optimise as soon as there is something new."""

from __future__ import annotations

from ..errors import MasError
from ..state.agent_state import AgentState, Ownership
from .base import Outlook, Policy
from .cluster_owners import owner_of


class Predecessor(Policy):
    """No decisions: one agent is asked, whoever owns the vector's cluster, perhaps itself; the whole group optimises
    automatically whenever the last optimisation has ended and a match is new; no map is bought."""

    ownership = Ownership.CLUSTERS

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        profile = state.profile
        if profile.centres is None:
            raise MasError("clustered place recognition without centres: nobody owns a cluster")
        return [owner_of(profile.coder.cut(state.keyframes[keyframe].vector[None])[0], profile.centres)]

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        return sorted(state.group) if outlook.pending_matches else []

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        return []
