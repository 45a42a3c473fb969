"""VGG16-NetVLAD from files that others made, against a plain numpy evaluation of the same numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import read_card
from maslam.descriptors.errors import DescriptorError
from maslam.descriptors.inference import NetVlad
from maslam.descriptors.published.matconvnet import parse_matconvnet
from maslam.descriptors.published.matlab_objects import WORKSPACE, MatlabObjects
from maslam.descriptors.published.onnx_export import export_vgg
from maslam.tools.cli import main
from maslam.tools.place_benchmarks.rendered import HELD_OUT_SEEDS, cache_path, config_for, save_places
from tests.descriptors import published
from tests.descriptors.conftest import textured_image
from tests.descriptors.published import CENTRES, CHANNELS, DIM, MEAN
from tests.descriptors.test_benchmarks import _street

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


def test_files_of_older_versions_and_without_whitening_are_read(tmp_path: Path) -> None:
    net = published.matconvnet_net(NETWORK)
    net["layers"] = net["layers"][:, :33]
    net["normalization"] = net.pop("meta")["normalization"]
    net["normalization"]["averageImage"] = np.tile(published.single(MEAN), (224, 224, 1))
    for layer in net["layers"].ravel():
        if layer["type"] == "conv":
            (layer["filters"], layer["biases"]), _ = layer["weights"].ravel(), layer.pop("weights")
    source = published.save_matconvnet(tmp_path / "old.mat", net, compress=False)
    assert export_weights(source, tmp_path / "old.onnx") == 0
    assert_equal_to_numpy(tmp_path / "old.onnx", MEAN, np.ones(3), False, 0)
    with pytest.raises(DescriptorError, match="--dim 5: the file has no whitening"):
        parse_matconvnet(source, 5)


def test_the_first_numbers_are_the_whole_vectors_first_scaled(tmp_path: Path) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK))
    for dim in (DIM, 7):
        export_vgg(parse_matconvnet(source, dim), tmp_path / f"{dim}.onnx")
    images = colour_images(2, 48, 80)
    cut = run(tmp_path / f"{DIM}.onnx", images)[:, :7]
    expected = cut / np.linalg.norm(cut, axis=1, keepdims=True)
    np.testing.assert_allclose(run(tmp_path / "7.onnx", images), expected, atol=1e-6)


@pytest.mark.parametrize("has_saveobj", [False, True])
@pytest.mark.parametrize("version", [1, 2])
def test_layers_saved_as_objects_are_read(tmp_path: Path, has_saveobj: bool, version: int) -> None:
    source = published.save_with_objects(tmp_path / "objects.mat", NETWORK, has_saveobj, version)
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
    from maslam.descriptors.published.vgg16 import Vgg16NetVlad

    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK, 2))
    network = Vgg16NetVlad(parse_matconvnet(source))
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


def test_it_is_calibrated_and_evaluated_like_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK))
    model = tmp_path / "vgg.onnx"
    assert export_weights(source, model, "--name", "vgg", "--pixels", "3072") == 0
    config = config_for("town").model_copy(update={"places": 12})
    save_places(cache_path(tmp_path, "town", HELD_OUT_SEEDS, config), _street(12))
    options = ["--cache", str(tmp_path), "--worlds", "1", "--places", "12", "--kinds", "town", "--quiet"]
    assert main(["netvlad", "calibrate", str(model), *options]) == 0
    card = read_card(model)[1]
    assert card.calibration is not None and card.threshold == card.calibration.strict.distance < 2.0
    capsys.readouterr()
    wanted = ["--data", str(tmp_path), "--json", "--methods", "netvlad"]
    assert main(["netvlad", "eval", "--model", str(model), *wanted, *options]) == 0
    records = [r for r in json.loads(capsys.readouterr().out) if r["method"] == "netvlad:vgg"]
    # The two views of a place are the same picture: numbers that nothing was taken from must tell.
    assert [(r["dataset"], r["recall_at_1"]) for r in records if r["code"] == "float32"] == [("town_9500", 1.0)]


def test_a_file_gives_the_same_bytes_each_time(tmp_path: Path) -> None:
    source = published.save_matconvnet(tmp_path / "net.mat", published.matconvnet_net(NETWORK))
    for name in ("a.onnx", "b.onnx"):
        assert export_weights(source, tmp_path / name) == 0
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()
