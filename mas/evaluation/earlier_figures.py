"""Figures of a run that was made onto an earlier one."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class EarlierFigures(BaseModel):
    """``agents``: how many are of the earlier run, the first ones; ``frame``: agent and track whose first camera is the
    origin of its map; ``in_frame``: later agents that stand in it at the end. ``ate_rmse_m``: of each agent, its
    key-frames against the truth under the alignment of the earlier agents' key-frames alone (None: not in the frame, or
    no truth); ``before_rmse_m``: the same of the earlier ones when this run began. ``moved``: root mean square way that
    the earlier key-frames have moved in the frame, in its unit; None where they are in another frame now."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    agents: int
    frame: tuple[int, int]
    in_frame: list[int]
    ate_rmse_m: list[float | None]
    before_rmse_m: list[float | None]
    moved: float | None
