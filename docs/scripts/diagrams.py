"""The diagrams of the documents: ``python docs/scripts/diagrams.py`` writes them to ``docs/pictures/``.

The state machine is drawn from the tables that the code runs by, so that a picture cannot say anything else.
"""

from __future__ import annotations

from pathlib import Path

from svg_drawing import BLUE, FAINT, GREEN, INK, ORANGE, PAPER, RED, Drawing, SequenceDrawing

from maslam.mas.contracts.contract import CONTRACTOR_SENDS, ENDED, MANAGER_SENDS, ContractState

PICTURES = Path(__file__).resolve().parent.parent / "pictures"
MANAGER, CONTRACTOR = BLUE, ORANGE
PLACES = {
    "called": (80, 96),
    "bid": (280, 96),
    "awarded": (480, 96),
    "working": (690, 96),
    "done": (890, 96),
    "refused": (80, 206),
    "rejected": (280, 206),
    "failed": (585, 206),
    "cancelled": (380, 316),
    "expired": (740, 316),
}
"""Centres of the states' boxes."""


def contract_states() -> Drawing:
    """The state machine of one contract."""
    sheet = Drawing(970, 350, "State machine of a contract between a manager and a contractor")
    for (state, message), after in {**CONTRACTOR_SENDS, **MANAGER_SENDS}.items():
        if after is not ContractState.CANCELLED:
            colour = MANAGER if (state, message) in MANAGER_SENDS else CONTRACTOR
            _transition(sheet, state.value, after.value, message.__name__, colour)
    _from_any_running_state(sheet)
    for state in ContractState:
        colour = INK if state not in ENDED else GREEN if state is ContractState.DONE else RED
        sheet.box(*PLACES[state.value], state.value, colour)
    sheet.line([(80, 46), (80, 78)], MANAGER)
    sheet.text(90, 60, "Call opens it", MANAGER, anchor="start", size=12)
    sheet.text(640, 24, "sent by the manager", MANAGER, anchor="start", size=12)
    sheet.text(640, 42, "sent by the contractor", CONTRACTOR, anchor="start", size=12)
    return sheet


def _transition(sheet: Drawing, before: str, after: str, words: str, colour: str) -> None:
    (x0, y0), (x1, y1) = PLACES[before], PLACES[after]
    if y0 == y1:
        sheet.line([(x0 + 54, y0), (x1 - 55, y1)], colour)
        sheet.text((x0 + x1) / 2, y0 - 8, words, colour, size=12)
        return
    lean = (x1 > x0) - (x1 < x0)
    start, end = (x0 + 16 * lean, y0 + 17), (x1 - 16 * lean, y1 - 18)
    sheet.line([start, end], colour)
    side = 8 if lean <= 0 else -8
    middle = ((start[0] + end[0]) / 2 + (30 if lean < 0 else side), (start[1] + end[1]) / 2 + 4)
    sheet.text(*middle, words, colour, anchor="start" if lean <= 0 else "end", size=12)


def _from_any_running_state(sheet: Drawing) -> None:
    """Cancel and the deadline end a contract in each of the four running states: one bracket for all."""
    sheet.line([(30, 240), (30, 254), (744, 254), (744, 240)], FAINT, head=False)
    sheet.text(40, 249, "in each of: called, bid, awarded, working", FAINT, anchor="start", size=12)
    for end, words, colour in (("cancelled", "Cancel", MANAGER), ("expired", "deadline passed, at both sides", FAINT)):
        x, y = PLACES[end]
        sheet.line([(x, 254), (x, y - 18)], colour)
        sheet.text(x - 8, y - 32, words, colour, anchor="end", size=12)


def contract_sequence() -> Drawing:
    """One call to three contractors."""
    sheet = SequenceDrawing(["manager", "contractor A", "contractor B", "contractor C"], 12, "One call for proposals")
    for who in (1, 2, 3):
        sheet.message(0, who, "Call: operation, deadline", MANAGER)
    sheet.message(1, 0, "Bid: state, bytes, ready at", CONTRACTOR)
    sheet.message(2, 0, "Bid", CONTRACTOR)
    sheet.message(3, 0, "Refusal: reason", CONTRACTOR)
    sheet.note(0, "benefit per byte: A wins")
    sheet.message(0, 1, "Award: task", MANAGER)
    sheet.message(0, 2, "Rejection", MANAGER)
    sheet.message(1, 0, "Confirmation: committed", CONTRACTOR)
    sheet.note(1, "works")
    sheet.message(1, 0, "Result: outcome", CONTRACTOR)
    return sheet


def keyframe_sequence() -> Drawing:
    """From a key-frame to a shared map, preset maslam; each arrow is a contract of its own."""
    sheet = SequenceDrawing(["agent 2", "agent 0 (directory)", "agent 1"], 9, "A key-frame on its way to a shared map")
    sheet.note(0, "key-frame: place vector")
    sheet.message(0, 1, "place query: coded vector", BLUE)
    sheet.message(1, 0, "nearest: a key-frame of agent 1", BLUE)
    sheet.message(0, 2, "verification: map points", ORANGE)
    sheet.message(2, 0, "verdict, T_M_Q, information", ORANGE)
    sheet.note(0, "accepted: one group")
    sheet.message(0, 2, "optimisation: separators", GREEN)
    sheet.message(2, 0, "common frame", GREEN)
    sheet.message(2, 0, "map: what is new in it", RED)
    return sheet


def frames() -> Drawing:
    """Which transforms a place match joins."""
    sheet = Drawing(760, 250, "Frames of a place match between two agents")
    sheet.box(90, 60, "O (agent 0)\norigin", BLUE, width=130)
    sheet.box(90, 190, "O (agent 1)\norigin", ORANGE, width=130)
    sheet.box(400, 60, "M\nmatch camera", BLUE, width=130)
    sheet.box(400, 190, "Q\nquery camera", ORANGE, width=130)
    sheet.line([(334, 60), (157, 60)], BLUE)
    sheet.text(245, 50, "T_O_M  (odometry)", BLUE, size=12)
    sheet.line([(334, 190), (157, 190)], ORANGE)
    sheet.text(245, 180, "T_O_Q  (odometry)", ORANGE, size=12)
    sheet.line([(400, 164), (400, 87)], GREEN)
    sheet.text(412, 130, "T_M_Q  (place match)", GREEN, anchor="start", size=12)
    sheet.line([(90, 164), (90, 87)], INK, dash="5 4")
    sheet.text(102, 130, "what the match makes known", INK, anchor="start", size=12)
    sheet.text(560, 54, "an arrow T_A_B", FAINT, anchor="start", size=12)
    sheet.text(560, 72, "points from B to A:", FAINT, anchor="start", size=12)
    sheet.text(560, 90, "p_A = T_A_B p_B", FAINT, anchor="start", size=12)
    return sheet


def overview() -> Drawing:
    """From images to one map."""
    sheet = Drawing(920, 250, "From images to one map")
    for k, (y, name) in enumerate([(50, "agent 0"), (125, "agent 1"), (200, "agent N")]):
        sheet.text(20, y + 4, name, FAINT, anchor="start", size=12)
        for x, words in (
            (150, "images"),
            (310, "odometry"),
            (470, "key-frames,\nplace vectors"),
            (650, "agent:\ngraph, map"),
        ):
            sheet.box(x, y, words, INK if x < 600 else BLUE, width=120, fill=PAPER if x == 150 else "#eef2f6")
        for x in (210, 370):
            sheet.line([(x, y), (x + 38, y)], FAINT)
        sheet.line([(530, y), (588, y)], FAINT)
        sheet.line([(710, y), (790, 125 + 9 * (k - 1))], FAINT)
    for y in (78, 153):
        sheet.line([(650, y), (650, y + 19)], ORANGE)
        sheet.line([(636, y + 19), (636, y)], ORANGE)
    sheet.text(628, 92, "messages", ORANGE, anchor="end", size=12)
    sheet.text(628, 167, "messages", ORANGE, anchor="end", size=12)
    sheet.box(845, 125, "one map,\nheld by\neach agent", GREEN, width=104)
    return sheet


DRAWINGS = {
    "contract_states.svg": contract_states,
    "contract_sequence.svg": contract_sequence,
    "keyframe_sequence.svg": keyframe_sequence,
    "frames.svg": frames,
    "overview.svg": overview,
}


def main() -> None:
    """Write every diagram."""
    for name, draw in DRAWINGS.items():
        (PICTURES / name).write_text(draw().svg(), encoding="utf-8")


if __name__ == "__main__":
    main()
