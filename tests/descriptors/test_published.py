"""VGG16-NetVLAD from files that others made, against a plain numpy evaluation of the same numbers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.card import read_card
from descriptors.errors import DescriptorError
from descriptors.inference import NetVlad
from descriptors.matconvnet import read_matconvnet
from descriptors.matlab_objects import WORKSPACE, MatlabObjects
from descriptors.vgg_export import export_vgg
from descriptors.vgg_weights import VggWeights
from tests.descriptors import matlab_file, published
from tests.descriptors.conftest import textured_image
from tests.descriptors.published import CENTRES, CHANNELS, DIM, MEAN
from tools.cli import main

pytest.importorskip("onnx")

NETWORK = published.random_network(7)
SIZES = ((1, 64, 64), (2, 37, 53), (3, 33, 97), (1, 16, 130))
IMAGENET = (255 * np.array([0.485, 0.456, 0.406]), 255 * np.array([0.229, 0.224, 0.225]))


def colour_images(count: int, height: int, width: int) -> NDArray[np.uint8]:
    """``(count, 3, height, width)``, red, green and blue all different."""

    def channel(seed: int) -> NDArray[np.uint8]:
        return textured_image(seed, max(height, 48), max(width, 64))[:height, :width]

    return np.stack([np.stack([channel(10 * k + c) for c in range(3)]) for k in range(count)])


def run(path: Path, images: NDArray[np.uint8]) -> NDArray[np.float32]:
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(None, {"images": images})[0])


def assert_equal_to_numpy(path: Path, mean: Any, deviation: Any, bias: bool, dim: int | None) -> None:
    for count, height, width in SIZES:
        images = colour_images(count, height, width)
        expected = [published.describe(NETWORK, image, mean, deviation, bias, dim) for image in images]
        np.testing.assert_allclose(run(path, images), expected, atol=1e-4)


def export_weights(path: Path, out: Path, *options: str) -> int:
    return main(["netvlad", "export", str(path), str(out), "--quiet", *options])


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("dim", [None, 5])
def test_matconvnet_file_is_the_network_it_describes(tmp_path: Path, version: int, dim: int | None) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK, version))
    assert export_weights(source, tmp_path / "net.onnx", *(["--dim", str(dim)] if dim else [])) == 0
    assert_equal_to_numpy(tmp_path / "net.onnx", MEAN, np.ones(3), version == 2, dim)


def test_the_first_numbers_are_the_whole_vectors_first_scaled(tmp_path: Path) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK))
    for dim in (DIM, 7):
        export_vgg(read_matconvnet(source, dim), tmp_path / f"{dim}.onnx")
    images = colour_images(2, 48, 80)
    cut = run(tmp_path / f"{DIM}.onnx", images)[:, :7]
    expected = cut / np.linalg.norm(cut, axis=1, keepdims=True)
    np.testing.assert_allclose(run(tmp_path / "7.onnx", images), expected, atol=1e-6)


def with_objects(path: Path, has_saveobj: bool, version: int = 1, described: bool = True) -> Path:
    """The same network as the authors saved it: VLAD and L2 layers are objects of classes."""
    net = published.matconvnet_net(NETWORK, version)
    name = "layerVLAD" if version == 1 else "layerVLADv2"
    l2 = {"type": "custom", "name": "wholeL2", "precious": False}
    vlad = {"type": "custom", "name": "VLAD", "K": np.zeros((0, 0)), "weights": np.zeros((0, 0)), "precious": False}
    classes = [(name, vlad), ("layerWholeL2Normalize", l2)]
    arrays = published.vlad_arrays(NETWORK, version)
    own = {"type": "custom", "name": "vlad:core", "K": np.array([[5.0]]), "weights": arrays}
    objects = [(1, own, has_saveobj), (2, {"name": "postL2"}, False), (2, {"name": "finalL2"}, False)]
    layers = net["layers"]
    layers[0, 30] = matlab_file.Object(name, 1, 1)
    layers[0, 32] = matlab_file.Object("layerWholeL2Normalize", 2, 2)
    layers[0, 34] = matlab_file.Object("layerWholeL2Normalize", 3, 2)
    return matlab_file.save(path, "net", net, matlab_file.workspace(classes, objects) if described else None)


@pytest.mark.parametrize("has_saveobj", [False, True])
@pytest.mark.parametrize("version", [1, 2])
def test_layers_saved_as_objects_are_read(tmp_path: Path, has_saveobj: bool, version: int) -> None:
    source = with_objects(tmp_path / "objects.mat", has_saveobj, version)
    assert export_weights(source, tmp_path / "net.onnx") == 0
    assert_equal_to_numpy(tmp_path / "net.onnx", MEAN, np.ones(3), version == 2, None)


def test_objects_that_matlab_wrote_are_read() -> None:
    import scipy.io

    file = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data" / "some_functions.mat"
    if not file.is_file():
        pytest.skip("this scipy comes without its test data")
    variables = scipy.io.loadmat(file)
    reference = np.array([0xDD000000, 2, 1, 1, 2, 0], dtype=np.uint32)
    workspace = MatlabObjects(variables[WORKSPACE]).properties(reference)["any"][1, 0]
    assert {name: workspace[0, 0][name].item() for name in "abc"} == {n: variables[n].item() for n in "abc"}


@pytest.mark.parametrize(
    ("version", "module", "legacy", "mapped"),
    [(1, "", False, True), (2, "module.", False, True), (1, "module.", True, False)],
)
def test_torch_checkpoint_is_the_network_it_describes(
    tmp_path: Path, version: int, module: str, legacy: bool, mapped: bool
) -> None:
    torch = pytest.importorskip("torch")
    state = {name: torch.tensor(a) for name, a in published.torch_state(NETWORK, version, module=module).items()}
    # What a training script leaves beside the weights: numbers of numpy, the optimiser's state.
    figures = {"recalls": {1: np.float64(0.8), 5: np.float32(0.9)}, "best_score": np.float64(0.9), "epoch": np.int64(3)}
    content = {"state_dict": state, "optimizer": {"state": {}, "param_groups": [{"lr": 1e-4}]}, **figures}
    torch.save(content, tmp_path / "c.pth.tar", _use_new_zipfile_serialization=not legacy)
    for dim in (None, 5):
        assert export_weights(tmp_path / "c.pth.tar", tmp_path / "c.onnx", *(["--dim", "5"] if dim else [])) == 0
        assert_equal_to_numpy(tmp_path / "c.onnx", *IMAGENET, version == 2, dim)


def test_torch_checkpoint_without_whitening_gives_the_vlad_vector(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch = pytest.importorskip("torch")
    state = {name: torch.tensor(a) for name, a in published.torch_state(NETWORK, whitened=False).items()}
    torch.save(state, tmp_path / "raw.pth")
    assert export_weights(tmp_path / "raw.pth", tmp_path / "raw.onnx") == 0
    assert_equal_to_numpy(tmp_path / "raw.onnx", *IMAGENET, False, 0)
    assert read_card(tmp_path / "raw.onnx")[1].dim == CENTRES * CHANNELS
    assert export_weights(tmp_path / "raw.pth", tmp_path / "cut.onnx", "--dim", "5") == 1
    assert "raw.pth: --dim 5: the file has no whitening" in capsys.readouterr().err


def test_torch_module_evaluates_trains_and_is_exported(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from descriptors.vgg16 import Vgg16NetVlad

    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK, 2))
    network = Vgg16NetVlad(read_matconvnet(source))
    images = colour_images(2, 37, 53)
    expected = [published.describe(NETWORK, image, MEAN, np.ones(3), True, None) for image in images]
    np.testing.assert_allclose(network(torch.tensor(images)).detach().numpy(), expected, atol=1e-4)

    optimiser = torch.optim.SGD(network.parameters(), lr=1e-3)
    target = torch.nn.functional.normalize(torch.ones(2, DIM), dim=1)
    losses = []
    for _ in range(5):
        loss = (network(torch.tensor(images)) - target).square().sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0]
    assert all(one.grad is not None and one.grad.abs().sum() > 0 for one in network.parameters())

    trained = network(torch.tensor(images)).detach().numpy()
    torch.save({"state_dict": network.state_dict()}, tmp_path / "further.pth")
    assert export_weights(tmp_path / "further.pth", tmp_path / "further.onnx") == 0
    np.testing.assert_allclose(run(tmp_path / "further.onnx", images), trained, atol=1e-4)
    np.testing.assert_allclose(Vgg16NetVlad(network.weights())(torch.tensor(images)).detach().numpy(), trained)


def test_agents_describe_with_it_colours_in_the_right_order(tmp_path: Path) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK))
    assert export_weights(source, tmp_path / "net.onnx", "--dim", "5", "--pixels", str(48 * 80)) == 0
    path, card = read_card(tmp_path / "net.onnx")
    assert (card.colour, card.dim, card.input_pixels, card.threshold, card.calibration) == (True, 5, 3840, 2.0, None)
    assert "CVPR 2016" in card.source and "net.mat" in card.source and card.licence != "BSD-3-Clause"
    net = NetVlad.load(path)
    (image,) = colour_images(1, 48, 80)
    grey = textured_image(3, 48, 80)
    bgr = np.ascontiguousarray(image[::-1].transpose(1, 2, 0))
    for given, seen in ((bgr, image), (grey, np.stack([grey] * 3))):
        expected = published.describe(NETWORK, seen, MEAN, np.ones(3), False, 5)
        np.testing.assert_allclose(net.describe([given])[0], expected, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(net.describe([np.full((480, 640), 90, dtype=np.uint8)])), 1, atol=1e-5)


def test_a_file_gives_the_same_bytes_each_time(tmp_path: Path) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK))
    for name in ("a.onnx", "b.onnx"):
        assert export_weights(source, tmp_path / name) == 0
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()


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
        read_matconvnet(source)


def test_damaged_and_foreign_files_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch = pytest.importorskip("torch")
    good = published.save_matconvnet(tmp_path / "good.mat", published.matconvnet_net(NETWORK)).read_bytes()
    alone = with_objects(tmp_path / "alone.mat", True, described=False).read_bytes()
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
    weights = read_matconvnet(published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK)))
    assert isinstance(weights, VggWeights)
    monkeypatch.setattr("descriptors.vgg_export.MAX_BYTES", 1000)
    with pytest.raises(DescriptorError, match="do not fit into one ONNX file; keep fewer with --dim"):
        export_vgg(weights, tmp_path / "net.onnx")
