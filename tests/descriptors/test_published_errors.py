"""Files of weights that are damaged, or hold something else: one line that says what."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maslam.descriptors.errors import DescriptorError
from maslam.descriptors.published.matconvnet import parse_matconvnet, read_matconvnet
from maslam.descriptors.published.onnx_export import export_vgg
from maslam.tools.cli import main
from tests.descriptors import published

pytest.importorskip("onnx")

NETWORK = published.random_network(7)


def export_weights(path: Path, out: Path, *options: str) -> int:
    return main(["netvlad", "export", str(path), str(out), "--quiet", *options])


def _without(net: dict[str, Any], number: int) -> None:
    net["layers"] = net["layers"][:, [k for k in range(net["layers"].size) if k != number]]


def _set(net: dict[str, Any], number: int, **fields: Any) -> None:
    net["layers"][0, number].update(fields)


def _spoil(net: dict[str, Any], number: int) -> None:
    net["layers"][0, number]["weights"][0, 0].flat[3] = np.nan


def _narrow(net: dict[str, Any], number: int) -> None:
    weights = net["layers"][0, number]["weights"]
    weights[0, 0] = weights[0, 0][:, :, :-1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda net: _without(net, 1), "layer 2 'conv1_2' is a convolution, where VGG16-NetVLAD has a ReLU"),
        (lambda net: _without(net, 29), "is the VLAD layer, where VGG16-NetVLAD has a normalisation over channels"),
        (lambda net: _without(net, 34), "ends after 34 layers, where the L2 normalisation of the whole vector was"),
        (lambda net: _set(net, 0, stride=np.array([[2.0, 2.0]])), r"'conv1_1' has stride \[2.0, 2.0\], VGG16 1"),
        (lambda net: _set(net, 3, method="avg"), "pools by 'avg', VGG16 by the maximum"),
        (lambda net: _set(net, 29, param=np.array([[5.0, 2.0, 1e-4, 0.75]])), r"'preL2': its param is \[5"),
        (lambda net: _spoil(net, 2), "weight of conv1_2: holds numbers that are not finite"),
        (lambda net: _spoil(net, 33), "weight of the whitening: holds numbers that are not finite"),
        (lambda net: _narrow(net, 7), "weight of conv2_2: expected 6x6x3x3, found 6x5x3x3"),
        (lambda net: _narrow(net, 33), "'WPCA': expected 40 numbers in and a bias for each out, found 39x12 and 12"),
        (lambda net: net["meta"].update(normalization=0), "holds no averageImage"),
        (lambda net: net.pop("layers"), "holds no variable 'net' with layers"),
    ],
)
def test_what_is_wrong_with_a_matconvnet_file_is_said(tmp_path: Path, change: Any, said: str) -> None:
    net = published.matconvnet_net(NETWORK)
    change(net)
    source = published.save_matconvnet(tmp_path / "bad.mat", net)
    with pytest.raises(DescriptorError, match=rf"bad\.mat: .*{said}"):
        parse_matconvnet(source)


def test_damaged_and_foreign_files_are_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch = pytest.importorskip("torch")
    good = published.save_matconvnet(tmp_path / "good.mat", published.matconvnet_net(NETWORK)).read_bytes()
    alone = published.save_with_objects(tmp_path / "alone.mat", NETWORK, True, described=False).read_bytes()
    uncompressed = bytearray(
        published.save_matconvnet(tmp_path / "plain.mat", published.matconvnet_net(NETWORK), False).read_bytes()
    )
    uncompressed[132:136] = (3_000_000_000).to_bytes(4, "little")
    state = {name: torch.tensor(a) for name, a in published.torch_state(NETWORK).items()}
    partial = {name: value for name, value in state.items() if "24" not in name}
    narrow = {**state, "pool.centroids": torch.zeros(5, 7)}
    files: dict[str, tuple[Any, str]] = {
        "cut.mat": (good[: len(good) // 2], "cut.mat: damaged or cut short"),
        "bent.mat": (good[:500] + bytes(80) + good[580:], "bent.mat: scipy cannot read it"),
        "huge.mat": (bytes(uncompressed), "huge.mat: damaged or cut short"),
        "new.mat": (b"MATLAB 7.3 MAT-file" + bytes(200), "save it with -v7"),
        "old.mat": (b"MATLAB 5.0 MAT-file".ljust(126) + b"MI", "not a little-endian MATLAB 5 file"),
        "alone.mat": (alone, "alone.mat: layer 31 is an object, and the file does not say what is in it"),
        "text.pt": (b"hello", "text.pt: not a checkpoint"),
        "list.pt": ([1, 2], "holds a list, not a dictionary"),
        "other.pt": ({"weights": torch.zeros(3)}, "a PyTorch file with weights in it; expected"),
        "part.pt": ({"state_dict": partial}, "part.pt: encoder.24.weight is missing (and 1 more of"),
        "narrow.pt": ({"state_dict": narrow}, "narrow.pt: centres: expected 5x8, found 5x7"),
        "code.pt": ({"state_dict": state, "code": os.system}, "code.pt: not a checkpoint"),
    }
    for name, (content, said) in files.items():
        if isinstance(content, bytes):
            (tmp_path / name).write_bytes(content)
        else:
            torch.save(content, tmp_path / name)
        assert export_weights(tmp_path / name, tmp_path / "never.onnx") == 1, name
        error = capsys.readouterr().err
        assert said in error and "unexpected" not in error and error.count("\n") == 1, error
    assert not (tmp_path / "never.onnx").exists()
    for options, said in (
        (["--dim", "13"], "--dim 13: the whitening of the file gives 12 numbers"),
        (["--dim", "0"], "--dim 0: the whitening"),
        (["--pixels", "0"], "--pixels must be at least 1"),
    ):
        assert export_weights(tmp_path / "good.mat", tmp_path / "never.onnx", *options) == 1
        assert said in capsys.readouterr().err
    assert export_weights(tmp_path / "good.mat", tmp_path / "never.txt") == 1
    assert export_weights(tmp_path / "none.mat", tmp_path / "never.onnx") == 1


def test_weights_too_many_for_one_file_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = parse_matconvnet(published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK)))
    monkeypatch.setattr("maslam.descriptors.published.onnx_export.MAX_BYTES", 1000)
    with pytest.raises(DescriptorError, match="do not fit into one ONNX file; keep fewer with --dim"):
        export_vgg(weights, tmp_path / "net.onnx")


def test_the_reader_is_a_process_of_its_own_which_a_damaged_file_may_end(tmp_path: Path) -> None:
    good = published.save_matconvnet(tmp_path / "good.mat", published.matconvnet_net(NETWORK))
    apart, here = read_matconvnet(good, 5), parse_matconvnet(good, 5)
    for name in ("mean", "deviation", "assign", "assign_bias", "centres", "whitening", "whitening_bias"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(here, name))
    for one, other in zip(apart.convolutions, here.convolutions, strict=True):
        np.testing.assert_array_equal(one.weight, other.weight)
        np.testing.assert_array_equal(one.bias, other.bias)
    assert apart.softening == here.softening
    bad = tmp_path / "bad.mat"
    bad.write_bytes(good.read_bytes()[:-1000])
    with pytest.raises(DescriptorError, match=r"bad\.mat: damaged or cut short"):
        read_matconvnet(bad)


def test_a_reader_that_crashes_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from maslam.descriptors.published.isolation import read_apart

    (tmp_path / "crashing_reader.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.syspath_prepend(str(tmp_path))
    ended = r"x\.mat: damaged: its reader was ended by it \(SIGSEGV\)"
    with pytest.raises(DescriptorError, match=ended), read_apart("crashing_reader", tmp_path / "x.mat", None):
        pass
