"""Settings of what is read of a recording: a part of its time, every so-manieth image, topics by name."""

from __future__ import annotations

from pydantic import Field

from maslam._settings import Settings

_MOST_S = 1e9


class RecordingConfig(Settings):
    """Which images of a source are read. Topics are of bags; the others serve any source."""

    start_s: float = Field(
        default=0.0, ge=0.0, le=_MOST_S, allow_inf_nan=False, description="begin so many seconds after the first image"
    )
    end_s: float | None = Field(
        default=None,
        gt=0.0,
        le=_MOST_S,
        allow_inf_nan=False,
        description="end so many seconds after the first image; none reads to the end",
    )
    stride: int = Field(default=1, ge=1, le=1_000_000, description="read every so-manieth image")
    rate_hz: float | None = Field(
        default=None,
        gt=0.0,
        le=1000.0,
        allow_inf_nan=False,
        description="read at most so many images per second; none reads all",
    )
    image_topic: str | None = Field(
        default=None,
        description="bags: topic of the images, whole or its last part (camera/image_raw: that of every robot)",
    )
    right_topic: str | None = Field(default=None, description="bags: topic of the right images, as image_topic")
    depth_topic: str | None = Field(default=None, description="bags: topic of the depth images, as image_topic")
    camera_topic: str | None = Field(
        default=None, description="bags: topic of the (left) camera's camera_info, as image_topic"
    )
    truth_topic: str | None = Field(
        default=None, description="bags: topic of true poses of the camera (PoseStamped, Odometry, TransformStamped)"
    )
    gps_topic: str | None = Field(
        default=None,
        description="bags: topic of positions (NavSatFix), as image_topic, where a robot has several; none as a word: "
        "not read",
    )
