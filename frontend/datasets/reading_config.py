"""Settings of reading: what a user says of the images where the files themselves do not."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class ReadingConfig(BaseModel):
    """How the folder and the image files of a data set are read."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    masks: Path | None = Field(
        default=None,
        description="masks of the images: one image for all, or a folder with one for each, named as COLMAP does "
        "(name.png.png) or as the image; white is used, black gives no points (none: masks/ or mask.png in SRC)",
    )
    mosaic: Literal["auto", "yes", "no"] = Field(
        default="auto", description="whether images of one channel are a Bayer mosaic (auto: by their content)"
    )
    depth_by_content: bool = Field(
        default=True,
        description="refuse images of 16 bits that are depth pictures by their content as a camera's; false takes them",
    )
    robots: bool = Field(
        default=False,
        description="take every sub-folder that holds images as a robot, whatever its name; false takes those whose "
        "names are not of cameras (left, cam0, depth) or of recordings (seq-01, 00, run_2)",
    )
