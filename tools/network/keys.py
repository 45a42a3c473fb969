"""``maslam keys``: certificates of a team, so that no agent can take another's name."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.errors import ToolError, UsageError
from ..common.parser import at_least_one


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``DIR`` and who is in the team."""
    parser.add_argument(
        "folder",
        metavar="DIR",
        type=Path,
        help="for the certificates: DIR/agent_00, ... go on the robots, one on each; DIR/authority stays at home, with "
        "it agents can be added to the team",
    )
    parser.add_argument("--agents", type=at_least_one, default=2, metavar="N", help="agents 0 to N-1 (default: 2)")
    parser.add_argument("--add", type=int, metavar="NUMBER", help="add this one agent to a team instead")
    parser.add_argument(
        "--revoke",
        metavar="NAME",
        help="take back the certificate of this agent (agent_03 or 3) instead: DIR/*/revoked.pem go on the robots, one "
        "is enough, agents pass it on",
    )
    parser.add_argument("--team", default="team", metavar="NAME", help="the team's name (default: %(default)s)")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.mas.live.authority import AUTHORITY_FOLDER, make_team
    from maslam.mas.protocol.ids import MAX_AGENTS

    if arguments.revoke is not None:
        _revoke(arguments.folder, arguments.revoke)
        return
    if arguments.add is not None and not (arguments.folder / AUTHORITY_FOLDER).is_dir():
        raise ToolError(f"{arguments.folder}: no team to add an agent to: no {AUTHORITY_FOLDER} in it")
    agents = list(range(arguments.agents)) if arguments.add is None else [arguments.add]
    if not all(0 <= agent < MAX_AGENTS for agent in agents):
        raise UsageError(f"agents have numbers from 0 to {MAX_AGENTS - 1}")
    made = make_team(arguments.folder, arguments.team, agents)
    for folder in made:
        print(folder)
    print(
        f"keep {arguments.folder / AUTHORITY_FOLDER} off the robots: who has it can add agents to team {arguments.team}"
    )


def _revoke(folder: Path, name: str) -> None:
    from maslam.mas.live.authority import AUTHORITY_FOLDER, revoke
    from maslam.mas.live.revocation import REVOKED

    digits = name.removeprefix("agent_")
    if not digits.isascii() or not digits.isdigit():
        raise UsageError(f"--revoke {name}: the name of an agent is like agent_03")
    if not (folder / AUTHORITY_FOLDER).is_dir():
        raise ToolError(f"{folder}: no team: no {AUTHORITY_FOLDER} in it")
    for path in revoke(folder, int(digits[:9])):
        print(path)
    print(f"copy {REVOKED} into the folder of one running agent or more: they load it and pass it on")
