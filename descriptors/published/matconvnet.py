"""The authors' VGG16-NetVLAD, a MatConvNet network in a MATLAB 5 file, to checked arrays:
``vd16_pitts30k_conv5_3_vlad_preL2_intra_white.mat``, or the copy whose objects were made structs
(``Pitts30K_struct.mat``).

Conventions, after the code that wrote the file: images are RGB, 0 to 255, minus the first pixel of the average image;
filters are (height, width, in, out); centres are stored negated; a VLAD vector runs through the centres first.
"""

from __future__ import annotations

import struct
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptorError
from .isolation import REFUSED, limit_memory, load_weights, read_apart, save_weights
from .matlab_objects import WORKSPACE, MatlabObjects, as_fields
from .vgg_weights import NAMES, POOLED, Convolution, Floats, VggWeights, rows_to_keep

MAX_BYTES = 2_200_000_000
"""A variable of such a file ends at 2 GiB; the published one is 0.6 GB unpacked."""
_COMPRESSED, _HEADER = 15, 128
_BACKBONE = [
    kind
    for name in NAMES
    for kind in ("conv", *(["relu"] if name != NAMES[-1] else []), *(["pool"] if name in POOLED else []))
]
_HEAD = ["normalize", "vlad", "normalize", "unit"]
_WHITENING = ["conv", "unit"]
_WORDS = {
    "conv": "a convolution",
    "relu": "a ReLU",
    "pool": "a pooling",
    "normalize": "a normalisation over channels",
    "vlad": "the VLAD layer",
    "unit": "the L2 normalisation of the whole vector",
}


@dataclass(frozen=True)
class _NetworkLayer:
    """``kind``: a key of ``_WORDS``, or MatConvNet's own word for anything else; ``number`` counts from one."""

    number: int
    name: str
    kind: str
    fields: dict[str, Any]

    def __str__(self) -> str:
        return f"layer {self.number} '{self.name}'"


def read_matconvnet(path: Path, dim: int | None = None) -> VggWeights:
    """The weights in ``path``, of the whitening the first ``dim`` outputs alone (None: all 4096).

    ``DescriptorError`` with one line for a file that is none, or holds another network, a missing layer, a wrong size
    or a number that is not finite. Nothing in the file is executed; what reads it is a process of its own, as scipy's
    reader of such files can be brought down by a damaged one.
    """
    _check_sizes(path)
    with read_apart(__name__, path, dim) as out:
        return load_weights(out)


def parse_matconvnet(path: Path, dim: int | None = None) -> VggWeights:
    """:func:`read_matconvnet` in this process."""
    variables = _load(path)
    try:
        return _weights(variables, dim)
    except DescriptorError as error:
        raise DescriptorError(f"{path}: {error}") from error


def _load(path: Path) -> dict[str, Any]:
    """The network and the properties of its objects, as scipy reads them."""
    from scipy.io import loadmat

    _check_sizes(path)
    try:
        return dict(loadmat(path, variable_names=["net", WORKSPACE]))
    except Exception as error:  # scipy has a kind of error for every kind of damage
        raise DescriptorError(f"{path}: scipy cannot read it: {' '.join(str(error).split())}") from error


def _check_sizes(path: Path) -> None:
    """Refuse what is no such file, or would unpack to more than one can hold, before it does."""
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise DescriptorError(f"{path}: {size / 1e9:.1f} GB, a MATLAB 5 file of a network has less than 2.2")
    with path.open("rb") as file:
        header = file.read(_HEADER)
        if header.startswith(b"MATLAB 7.3"):
            raise DescriptorError(f"{path}: a MATLAB 7.3 (HDF5) file; save it with -v7 in MATLAB")
        if not header.startswith(b"MATLAB 5.0") or header[-2:] != b"IM":
            raise DescriptorError(f"{path}: not a little-endian MATLAB 5 file")
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack("<II", tag)
            start = file.tell()
            unpacked = _unpacked(file.read(min(length, 1024))) if kind == _COMPRESSED else length
            if not 0 <= unpacked <= MAX_BYTES or start + length > size:
                raise DescriptorError(f"{path}: damaged or cut short at byte {start} of {size}")
            file.seek(start + length)


def _unpacked(beginning: bytes) -> int:
    """Bytes that a compressed variable says to have; -1 where it is none."""
    try:
        inner = zlib.decompressobj().decompress(beginning, 8)
    except zlib.error:
        return -1
    return int(struct.unpack("<I", inner[4:8])[0]) if len(inner) == 8 else -1


def _weights(variables: dict[str, Any], dim: int | None) -> VggWeights:
    net = as_fields(variables.pop("net", None))
    if "layers" not in net:
        raise DescriptorError("holds no variable 'net' with layers: not a MatConvNet network")
    layers = _layers(net["layers"], variables.get(WORKSPACE))
    _check_order(layers)
    convolutions = [layer for layer in layers if layer.kind == "conv"]
    normalisations = [layer for layer in layers if layer.kind == "normalize"]
    (vlad,) = (layer for layer in layers if layer.kind == "vlad")
    assign, assign_bias, centres = _vlad(vlad)
    softening = {_softening(layer, centres.shape[1]) for layer in normalisations}
    if len(softening) > 1:
        raise DescriptorError(f"its normalisations differ in what they add to a squared length: {sorted(softening)}")
    whitening, whitening_bias = None, None
    rest = convolutions[len(NAMES) :]
    if rest:
        whitening, whitening_bias = _whitening(rest[0], centres.shape, dim)
    else:
        rows_to_keep(dim, None)
    return VggWeights(
        convolutions=tuple(_convolution(layer) for layer in convolutions[: len(NAMES)]),
        mean=_mean(net),
        deviation=np.ones(3, dtype=np.float32),
        assign=assign,
        assign_bias=assign_bias,
        centres=centres,
        whitening=whitening,
        whitening_bias=whitening_bias,
        softening=softening.pop(),
    )


def _layers(cells: Any, workspace: Any) -> list[_NetworkLayer]:
    """Layers as they stand in the file, be they structs or objects of a class."""
    objects: MatlabObjects | None = None
    layers = []
    for number, cell in enumerate(np.asarray(cells).ravel(), start=1):
        fields, name = as_fields(cell), ""
        if {"s1", "s2", "arr"} <= fields.keys():  # scipy's MatlabOpaque
            if objects is None:
                if workspace is None:
                    raise DescriptorError(f"layer {number} is an object, and the file does not say what is in it")
                objects = MatlabObjects(workspace)
            name = bytes(fields["s2"]).decode("ascii", "replace")
            fields = {"type": "custom"} | objects.properties(fields["arr"])
        name = _text(fields.get("name")) or name
        kind = _text(fields.get("type"))
        if kind == "custom":
            kind = "vlad" if np.asarray(fields.get("weights")).size > 1 else "unit"
        layers.append(_NetworkLayer(number, name, kind, fields))
    return layers


def _check_order(layers: list[_NetworkLayer]) -> None:
    """An error that names the first layer which VGG16-NetVLAD has not at its place."""
    kinds = [layer.kind for layer in layers]
    order = list(range(len(kinds)))
    for k in range(len(kinds) - 1):  # of a maximum, before or after the ReLU, nothing changes; the file has it before
        if (kinds[k], kinds[k + 1]) == ("pool", "relu"):
            kinds[k : k + 2], order[k : k + 2] = ["relu", "pool"], [k + 1, k]
    expected = _BACKBONE + _HEAD
    if len(kinds) > len(expected):
        expected = expected + _WHITENING
    for k, wanted in enumerate(expected):
        if k >= len(kinds):
            raise DescriptorError(f"ends after {len(kinds)} layers, where {_WORDS[wanted]} was expected")
        if kinds[k] != wanted:
            found = _WORDS.get(kinds[k], f"'{kinds[k]}'")
            raise DescriptorError(f"{layers[order[k]]} is {found}, where VGG16-NetVLAD has {_WORDS[wanted]}")
    if len(kinds) > len(expected):
        raise DescriptorError(f"{layers[len(expected)]} comes after the last one of VGG16-NetVLAD")
    for layer in layers:
        _check_settings(layer)


def _check_settings(layer: _NetworkLayer) -> None:
    """Anything but the settings of VGG16 would change what comes out without changing a size."""
    wanted: dict[str, float] = {}
    if layer.kind == "conv":
        wanted = {"stride": 1, "pad": 1 if layer.number <= len(_BACKBONE) else 0, "dilate": 1}
    elif layer.kind == "pool":
        wanted = {"pool": 2, "stride": 2, "pad": 0}
        if _text(layer.fields.get("method", "max")) != "max":
            raise DescriptorError(f"{layer} pools by '{_text(layer.fields['method'])}', VGG16 by the maximum")
    elif layer.kind == "relu":
        wanted = {"leak": 0}
    for key, value in wanted.items():
        found = np.asarray(layer.fields.get(key, value))
        if not np.issubdtype(found.dtype, np.number) or not (found == value).all():
            raise DescriptorError(f"{layer} has {key} {found.ravel().tolist()}, VGG16 {value:g}")


def _convolution(layer: _NetworkLayer) -> Convolution:
    weight, bias = _arrays(layer, 2)
    if weight.ndim != 4:
        raise DescriptorError(f"{layer}: filters are (height, width, in, out), found {weight.shape}")
    return Convolution(np.ascontiguousarray(weight.transpose(3, 2, 0, 1)), bias.ravel())


def _vlad(layer: _NetworkLayer) -> tuple[Floats, Floats, Floats]:
    """Assignment ``(K, D)``, its bias ``(K,)`` and centres ``(K, D)``; the second version of the layer has a bias."""
    arrays = _arrays(layer, 2, 3)
    assign, stored = (_matrix(layer, array).T for array in (arrays[0], arrays[-1]))
    bias = arrays[1].ravel() if len(arrays) == 3 else np.zeros(len(assign), dtype=np.float32)
    return np.ascontiguousarray(assign), bias, np.ascontiguousarray(-stored)


def _whitening(layer: _NetworkLayer, centres: tuple[int, ...], dim: int | None) -> tuple[Floats, Floats]:
    """The first ``dim`` rows of the whitening, turned to our order of a VLAD vector."""
    weight, bias = _arrays(layer, 2)
    matrix, (clusters, channels) = _matrix(layer, weight), centres
    if len(matrix) != clusters * channels or bias.size != matrix.shape[1]:
        raise DescriptorError(
            f"{layer}: expected {clusters * channels} numbers in and a bias for each out, "
            f"found {matrix.shape[0]}x{matrix.shape[1]} and {bias.size}"
        )
    rows = rows_to_keep(dim, bias.size)
    cut = matrix[:, :rows].T.reshape(-1, channels, clusters)  # a view: 4096 rows have 512 MB
    return np.ascontiguousarray(cut.transpose(0, 2, 1)).reshape(len(cut), -1), bias.ravel()[:rows].copy()


def _softening(layer: _NetworkLayer, channels: int) -> float:
    """Constant that vl_nnnormalize adds, from its four numbers: window, kappa, alpha, beta of x / (kappa + alpha *
    sum)^beta."""
    found = np.asarray(layer.fields.get("param", ())).ravel().astype(np.float64)
    if len(found) != 4 or found[0] < 2 * channels or found[2] != 1 or found[3] != 0.5 or not 0 <= found[1] < 1e-3:
        raise DescriptorError(
            f"{layer}: its param is {found.tolist()}, not that of an L2 normalisation ({2 * channels}, 1e-12, 1, 0.5)"
        )
    return float(found[1])


def _mean(net: dict[str, Any]) -> Floats:
    """Of red, green and blue; as the authors' code, the first pixel of an image of averages."""
    for holder in (as_fields(net.get("meta")), net):  # older files have no meta
        average = np.asarray(as_fields(holder.get("normalization")).get("averageImage", ()))
        if average.ndim >= 2 and average.shape[-1] == 3 and np.issubdtype(average.dtype, np.number):
            return average.reshape(-1, 3)[0].astype(np.float32)
    raise DescriptorError("holds no averageImage of three channels under net.meta.normalization")


def _arrays(layer: _NetworkLayer, *counts: int) -> list[Floats]:
    """The layer's weights as float32, so many of them."""
    found = layer.fields.get("weights")
    cells = list(np.asarray(found).ravel()) if found is not None else []
    if not cells and "filters" in layer.fields:  # before MatConvNet beta 17
        cells = [layer.fields["filters"], layer.fields.get("biases")]
    if len(cells) not in counts or not all(np.issubdtype(np.asarray(cell).dtype, np.floating) for cell in cells):
        raise DescriptorError(
            f"{layer}: expected {' or '.join(map(str, counts))} arrays of weights, found {len(cells)} cells"
        )
    return [np.asarray(cell).astype(np.float32, copy=False) for cell in cells]


def _matrix(layer: _NetworkLayer, array: NDArray[Any]) -> NDArray[Any]:
    """``(1, 1, in, out)`` as ``(in, out)``."""
    if array.ndim < 2 or array.shape[-2] * array.shape[-1] != array.size:
        raise DescriptorError(f"{layer}: expected 1x1xINxOUT, found {'x'.join(map(str, array.shape))}")
    return array.reshape(array.shape[-2:], order="F")


def _text(value: Any) -> str:
    """A MATLAB string as scipy reads it, an array of one."""
    array = np.asarray(value)
    return str(array.ravel()[0]) if array.size == 1 and array.dtype.kind == "U" else ""


def main(path: str, dim: str, out: str) -> int:
    """The process that :func:`read_matconvnet` starts."""
    limit_memory()
    try:
        save_weights(Path(out), parse_matconvnet(Path(path), None if dim == "all" else int(dim)))
    except (DescriptorError, MemoryError) as error:
        sys.stderr.write(f"{error}\n" if isinstance(error, DescriptorError) else f"{path}: claims too much memory\n")
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
