"""Place vectors of one sequence on disk: ``netvlad.npz``, which says what made it, and the predecessor's bare float
file."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_npz
from maslam._bounded import open_npz

from .errors import DescriptorError

_VERSION = 1
_FIELDS = {"version", "name", "sha256", "dim", "stamps_ns", "vectors", "textured"}
PREDECESSOR_DIM = 4096
PREDECESSOR_NAME = "vd16_pitts30k_conv5_3_vlad_preL2_intra_white"
"""The network whose features the predecessor's files hold."""


@dataclass(frozen=True)
class PlaceVectors:
    """Vectors of K key-frames: ``stamps_ns`` ``(K,)`` int64, ``vectors`` ``(K, dim)`` float32 unit rows,
    ``textured`` ``(K,)`` bool.

    ``name`` and ``sha256`` say which model made them; ``dim`` is repeated so that a cut file shows. ``images``: the
    name of each one's image, or empty where stamps say it all.
    """

    name: str
    sha256: str
    dim: int
    stamps_ns: NDArray[np.int64]
    vectors: NDArray[np.float32]
    textured: NDArray[np.bool_]
    images: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.stamps_ns)
        if self.images and len(self.images) != count:
            raise DescriptorError(f"place vectors of {self.name}: {count} stamps, {len(self.images)} names of images")
        shapes = (self.stamps_ns.shape, self.vectors.shape, self.textured.shape)
        if shapes != ((count,), (count, self.dim), (count,)):
            raise DescriptorError(
                f"place vectors of {self.name}: {count} stamps and dimension {self.dim}, but shapes {shapes}"
            )
        if not np.isfinite(self.vectors).all():
            row = int(np.flatnonzero(~np.isfinite(self.vectors).all(axis=1))[0])
            raise DescriptorError(f"place vectors of {self.name}: vector {row} is not finite")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def save(self, path: Path) -> None:
        """Write as ``.npz`` without pickle, whole or not at all; equal vectors give equal bytes."""
        fields: dict[str, Any] = {
            "version": np.int64(_VERSION),
            "name": np.array(self.name),
            "sha256": np.array(self.sha256),
            "dim": np.int64(self.dim),
            "stamps_ns": self.stamps_ns,
            "vectors": self.vectors.astype("<f4"),
            "textured": self.textured,
        }
        if self.images:
            fields["images"] = np.array(self.images)
        write_npz(path, fields)

    @classmethod
    def load(cls, path: Path) -> PlaceVectors:
        """Read and check :meth:`save`'s file."""
        try:
            with open_npz(path) as file:
                fields = {key: file[key] for key in file.files}
        except FileNotFoundError as error:
            raise DescriptorError(f"{path}: not found") from error
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise DescriptorError(f"{path}: not a file of place vectors: {error}") from error
        if fields.keys() - {"images"} != _FIELDS:
            raise DescriptorError(f"{path}: not a file of place vectors: it holds {sorted(fields)}")
        if int(fields["version"]) != _VERSION:
            raise DescriptorError(
                f"{path}: version {int(fields['version'])} of place vectors; this program reads {_VERSION}"
            )
        try:
            return cls(
                str(fields["name"]),
                str(fields["sha256"]),
                int(fields["dim"]),
                fields["stamps_ns"].astype(np.int64),
                fields["vectors"].astype(np.float32),
                fields["textured"].astype(bool),
                tuple(str(image) for image in fields.get("images", ())),
            )
        except DescriptorError as error:
            raise DescriptorError(f"{path}: {error}") from error


def import_predecessor(
    path: Path, image_stamps_ns: NDArray[np.int64], keyframe_stamps_ns: NDArray[np.int64], dim: int = 128
) -> PlaceVectors:
    """Vectors of key-frames from the predecessor's ``netvlad_feats.bin``: 4096 float32 for every image of the
    sequence, no header.

    A key-frame takes the image nearest in time. The first ``dim`` values are kept (its PCA output is sorted by
    variance) and scaled to unit length. The file does not say which network made it; the one its authors used is
    assumed, and the hash is of that name.
    """
    import hashlib

    if not 0 < dim <= PREDECESSOR_DIM:
        raise DescriptorError(f"{path}: dimension must lie in 1..{PREDECESSOR_DIM}, got {dim}")
    try:
        size = path.stat().st_size
    except OSError as error:
        raise DescriptorError(f"{path}: {error.strerror}") from error
    expected = 4 * PREDECESSOR_DIM * len(image_stamps_ns)
    if size != expected or not len(image_stamps_ns):
        raise DescriptorError(
            f"{path}: {size} bytes, but {len(image_stamps_ns)} images of {PREDECESSOR_DIM} float32 make {expected}"
        )
    values = np.fromfile(path, dtype="<f4").reshape(-1, PREDECESSOR_DIM)
    order = np.argsort(image_stamps_ns, kind="stable")
    stamps = np.asarray(image_stamps_ns, dtype=np.int64)[order]
    right = (
        np.clip(np.searchsorted(stamps, keyframe_stamps_ns), 1, max(len(stamps) - 1, 1)) if len(stamps) > 1 else None
    )
    if right is None:
        nearest = np.zeros(len(keyframe_stamps_ns), dtype=np.int64)
    else:
        closer_left = keyframe_stamps_ns - stamps[right - 1] <= stamps[right] - keyframe_stamps_ns
        nearest = np.where(closer_left, right - 1, right)
    cut = values[order[nearest], :dim].astype(np.float64)
    norms = np.linalg.norm(cut, axis=1)
    unit = (cut / np.maximum(norms, 1e-12)[:, None]).astype(np.float32)
    digest = hashlib.sha256(PREDECESSOR_NAME.encode()).hexdigest()
    return PlaceVectors(
        PREDECESSOR_NAME, digest, dim, np.asarray(keyframe_stamps_ns, dtype=np.int64), unit, norms > 1e-6
    )
