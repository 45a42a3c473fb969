"""One agent of a SEQS folder as it is before it has met anybody."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from ..agent import Agent
from ..config import MasConfig
from ..errors import MasError
from ..manifest import AgentEntry, Manifest, read_manifest
from ..policies.presets import policy_of
from ..sequence import AgentSequence, load_agent
from ..simulation import CommonProfile, coder_of, profile_of
from ..state.agent_state import Ownership
from ..state.keyframe import keyframes_of
from .credentials import name_of_agent
from .recorded_agent import AgentInputs


def check_live(config: MasConfig) -> None:
    """``MasError`` where settings are not for agents on a network."""
    if config.faults.any:
        raise MasError("faults.*: only a simulation makes faults on purpose; a network makes its own")
    if policy_of(config, 0).ownership is Ownership.CLUSTERS:
        raise MasError(
            f"policy {config.policy}: owners of clusters are given to all agents before they meet; on a network "
            "nobody does: choose another preset or policy"
        )


def entry_of(folder: Path, me: int) -> tuple[Manifest, AgentEntry]:
    """The manifest of a SEQS folder, and in it the entry of agent ``me``: the one of its number, or the only one."""
    manifest = read_manifest(folder)
    named = [e for e in manifest.agents if e.name == name_of_agent(me)]
    if not named and len(manifest.agents) != 1:
        names = ", ".join(e.name for e in manifest.agents)
        raise MasError(f"{folder}: no sequence of {name_of_agent(me)}, only {names}")
    return manifest, (named or list(manifest.agents))[0]


def own_sequence(folder: Path, me: int) -> AgentSequence:
    """The sequence of agent ``me`` in a SEQS folder."""
    manifest, entry = entry_of(folder, me)
    return load_agent(folder / entry.name, entry, manifest)


def read_agent(folder: Path, me: int, config: MasConfig) -> AgentInputs:
    """Agent ``me`` with its key-frames, read from a SEQS folder."""
    manifest, entry = entry_of(folder, me)
    return inputs_of(me, manifest, entry, load_agent(folder / entry.name, entry, manifest), config)


def inputs_of(
    me: int, manifest: Manifest, entry: AgentEntry, sequence: AgentSequence, config: MasConfig
) -> AgentInputs:
    """The agent of a sequence, which knows nobody yet."""
    policy = policy_of(config, me)
    common = CommonProfile(manifest.descriptor, coder_of(manifest, config.places.code), policy.ownership)
    profile = replace(profile_of(me, (), entry, sequence, common), complete=False)
    agent = Agent(profile, config, policy)
    return AgentInputs(agent, keyframes_of(sequence), round(config.max_message_mb * 2**20))


def digest_of(inputs: AgentInputs) -> bytes:
    """16 bytes that stand for what an agent is made of: its settings, and its key-frames or its camera."""
    made = hashlib.blake2b(inputs.agent.state.config.model_dump_json().encode(), digest_size=16)
    made.update(inputs.made_of.encode())
    for keyframe in inputs.keyframes:
        for part in (keyframe.T_T_C, keyframe.vector, keyframe.points_C, keyframe.descriptors):
            made.update(part.tobytes())
        made.update(f"{keyframe.time_ns} {keyframe.stamp_ns}".encode())
    return made.digest()
