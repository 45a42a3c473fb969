"""Which robot and which camera an image topic belongs to, by its name alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_TRANSPORTS = ("compressed", "compressedDepth", "compressed_depth", "theora", "ffmpeg", "zstd", "avif", "h264", "h265")
_NO_CAMERA = re.compile(r"disparity|mask|label|segment|confidence|heat_?map|theora|overlay|detect|debug|feature")
_DEPTH = re.compile(r"depth")
_REGISTERED = re.compile(r"aligned|registered")
_IMAGE = re.compile(r"(image|img)\w*|color|colour|raw|mono|rect")
"""A last part of a name that says what of a camera's images these are, not which camera's."""
_CAMERA = re.compile(
    r"(usb_?|rgb_?|web_?)?cam(era)?s?_?\d*|left|right|infra(red)?_?\d*|ir|nir|colou?r|rgb|depth\w*|aligned\w*|image\w*|img|"
    r"front\w*|rear\w*|back\w*|side\w*|top|bottom|forward|backward|up|down\w*|upward|fisheye\w*|stereo|mono|thermal|lwir|"
    r"gr[ae]y|zed\w*|realsense\w*|d4\d\d\w*|t265|oak\w*|kinect\w*|k4a|flir|bumblebee\w*|blackfly\w*|wide|tele|events?|"
    r"davis|dvs|sensors?|visual|vision|perception|driver|alphasense\w*|multisense\w*|video|kitti|loam|dataset"
)
"""Of a word in a first part of a name that is a camera's, no robot's."""
_SIDES = (
    ("left", "right"),
    ("infra1", "infra2"),
    ("infra_1", "infra_2"),
    ("ir1", "ir2"),
    ("cam0", "cam1"),
    ("cam_0", "cam_1"),
    ("camera0", "camera1"),
    ("camera_0", "camera_1"),
    ("image_0", "image_1"),
    ("l", "r"),
)
_BETTER = ("image_raw", "image", "image_rect_raw", "image_rect", "image_color", "image_rect_color", "image_mono")
"""Images of one camera: the one that is closest to the sensor comes first."""


@dataclass(frozen=True)
class ImageName:
    """``topic``, and its ``base`` without the part that says how images are transmitted."""

    topic: str
    base: str

    @classmethod
    def of(cls, topic: str, compressed: bool) -> ImageName:
        """``compressed``: it holds compressed images, so that its last part may be the transport's."""
        head, _, last = topic.rpartition("/")
        return cls(topic, head if compressed and head and last in _TRANSPORTS else topic)

    @property
    def parts(self) -> tuple[str, ...]:
        """Parts of the base."""
        return tuple(part for part in self.base.split("/") if part)

    @property
    def camera(self) -> str:
        """What all topics of one camera begin with."""
        head, _, last = self.base.rpartition("/")
        return head if head and _IMAGE.fullmatch(last.lower()) else self.base

    @property
    def is_depth(self) -> bool:
        """Whether it is called depth."""
        return bool(_DEPTH.search(self.base.lower())) or self.topic.endswith(("compressedDepth", "compressed_depth"))

    @property
    def is_registered(self) -> bool:
        """Whether it is called depth as another camera would see it."""
        return bool(_REGISTERED.search(self.base.lower()))

    @property
    def is_rectified(self) -> bool:
        """Whether it is called rectified."""
        return "rect" in re.split(r"[^a-z0-9]+", self.base.rpartition("/")[2].lower())

    @property
    def is_derived(self) -> bool:
        """Whether it is called something that is no camera's image."""
        return bool(_NO_CAMERA.search(self.topic.lower()))

    @property
    def rank(self) -> int:
        """Among the topics of one camera, which is taken: the smallest."""
        last = self.base.rpartition("/")[2]
        return _BETTER.index(last) if last in _BETTER else len(_BETTER)

    @property
    def camera_info(self) -> tuple[str, ...]:
        """Topics on which the camera's calibration may be, likely ones first."""
        head = self.base.rpartition("/")[0]
        return tuple(dict.fromkeys((f"{self.camera}/camera_info", f"{self.base}/camera_info", f"{head}/camera_info")))


def by_robot(names: Sequence[ImageName]) -> dict[str, list[ImageName]]:
    """The topics of each robot, by the part of their names that is the robot's; one robot ``""`` where names do not
    tell robots apart.

    The first part that topics differ in is the robot's where it is no word for a camera, and the rest either goes
    on for two parts or is the same for all.
    """
    depth = _common(names)
    robots: dict[str, list[ImageName]] = {}
    for name in names:
        robots.setdefault(name.parts[depth] if depth < len(name.parts) else "", []).append(name)
    rests = [{name.parts[depth + 1 :] for name in own} for own in robots.values()]
    long = all(len(rest) >= 2 for own in rests for rest in own)
    alike = all(own == rests[0] for own in rests) and all(rest for rest in rests[0])
    if len(robots) < 2 or "" in robots or any(_is_camera(robot) for robot in robots) or not (long or alike):
        return {"": list(names)}
    return dict(sorted(robots.items()))


def right_of(name: ImageName, among: Sequence[ImageName]) -> ImageName | None:
    """The topic of the right camera of a pair whose left one is ``name``, by the two words in which they differ."""
    for left, right in _SIDES:
        other = re.sub(rf"(?<![a-z0-9]){left}(?![a-z0-9])", right, name.base.lower())
        if other != name.base.lower():
            for one in among:
                if one.base.lower() == other:
                    return one
    return None


def _common(names: Sequence[ImageName]) -> int:
    """Number of first parts that all names share, and after which something follows."""
    depth = 0
    while all(depth + 1 < len(name.parts) for name in names) and len({name.parts[: depth + 1] for name in names}) == 1:
        depth += 1
    return depth


def _is_camera(part: str) -> bool:
    words = [word for word in re.split(r"[^a-z0-9]+", part.lower()) if word]
    return any(_CAMERA.fullmatch(word) for word in words) or bool(_CAMERA.fullmatch(part.lower()))
