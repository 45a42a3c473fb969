"""The torch side: the network against a plain numpy reading of the paper, training that learns, export that equals
torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from maslam.descriptors.config import NetVladConfig, ProjectionConfig, TrainingConfig  # noqa: E402
from maslam.descriptors.errors import DescriptorError  # noqa: E402
from maslam.descriptors.training.augmentation import PHOTOS, augment_pair, share_strips  # noqa: E402
from maslam.descriptors.training.initialisation import fit_projection, initialise  # noqa: E402
from maslam.descriptors.training.losses import info_nce  # noqa: E402
from maslam.descriptors.training.network import VladLayer, build_network  # noqa: E402
from maslam.descriptors.training.onnx_export import export_onnx  # noqa: E402
from maslam.descriptors.training.projection import learn_projection  # noqa: E402
from maslam.descriptors.training.trainer import PlaceSet, Trainer, load_network, read_checkpoint  # noqa: E402
from tests.descriptors.conftest import textured_image  # noqa: E402

TINY = NetVladConfig(channels=(8, 16, 16), strides=(2, 2, 2), context=(24,), local_dim=16, clusters=8, dim=32)
PLAIN = TINY.model_copy(update={"context": (), "gradient_levels": ()})
SMALL = TrainingConfig(
    network=TINY,
    steps=25,
    pairs=12,
    width=64,
    height=48,
    learning_rate=3e-3,
    warmup_steps=5,
    initial_images=64,
    checkpoint_every=10,
)


@pytest.fixture(scope="module")
def places() -> list[PlaceSet]:
    views = np.stack([textured_image(seed, 72, 96) for seed in range(40)])[:, None]
    return [PlaceSet("pictures", views, strips=0.3)]


def test_vlad_layer_is_the_papers_formula() -> None:
    rng = np.random.default_rng(0)
    layer = VladLayer(5, 7)
    centres = rng.normal(size=(5, 7))
    layer.set_centres(torch.tensor(centres, dtype=torch.float32), 3.0)
    features = rng.normal(size=(2, 7, 3, 4))
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    got = layer(torch.tensor(features, dtype=torch.float32)).detach().numpy()
    for n in range(2):
        vlad = np.zeros((5, 7))
        for x in features[n].reshape(7, -1).T:
            score = np.exp(-3.0 * np.square(x - centres).sum(axis=1))
            vlad += (score / score.sum())[:, None] * (x - centres)
        vlad /= np.linalg.norm(vlad, axis=1, keepdims=True)
        np.testing.assert_allclose(got[n], vlad.ravel() / np.linalg.norm(vlad), atol=1e-5)


def test_light_that_scales_and_shifts_changes_nothing() -> None:
    network = build_network(TINY, 0).eval()
    image = torch.tensor(textured_image(1), dtype=torch.float32)[None, None]
    with torch.no_grad():
        difference = (network(image) - network(0.5 * image + 40.0)).norm()
    assert float(difference) < 0.01


@pytest.mark.parametrize(
    ("config", "narrow"),
    [(TINY, (39, 97)), (PLAIN, (33, 97)), (TINY.model_copy(update={"gradient_levels": (1,)}), (33, 97))],
)
def test_exported_graph_equals_torch(tmp_path: Path, config: NetVladConfig, narrow: tuple[int, int]) -> None:
    ort = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    network = build_network(config, 4)
    images = np.stack([textured_image(seed, 48, 64) for seed in range(48)])
    initialise(network, images, np.random.default_rng(1))
    fit_projection(network, images)
    if config.context:  # it starts as nothing
        torch.nn.init.ones_(network.context[-1].weight)
    for name in ("a.onnx", "b.onnx"):
        export_onnx(network, tmp_path / name)
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()
    session = ort.InferenceSession(str(tmp_path / "a.onnx"), providers=["CPUExecutionProvider"])
    for count, height, width in ((1, 48, 64), (3, 120, 160), (2, *narrow)):
        batch = np.stack([textured_image(seed, height, width) for seed in range(count)])[:, None]
        with torch.no_grad():
            expected = network(torch.from_numpy(batch)).numpy()
        got = session.run(None, {"images": batch})[0]
        np.testing.assert_allclose(got, expected, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(got, axis=1), 1.0, atol=1e-5)


def test_export_of_a_constant_image_is_finite(tmp_path: Path) -> None:
    ort = pytest.importorskip("onnxruntime")
    export_onnx(build_network(TINY, 0).eval(), tmp_path / "m.onnx")
    session = ort.InferenceSession(str(tmp_path / "m.onnx"), providers=["CPUExecutionProvider"])
    assert np.isfinite(session.run(None, {"images": np.full((1, 1, 48, 64), 90, dtype=np.uint8)})[0]).all()


def test_training_learns_and_repeats(places: list[PlaceSet]) -> None:
    # Convolutions alone: with gradient histograms beside them, it starts where these get to in so few steps.
    losses, weights = [], []
    for _ in range(2):
        trainer = Trainer(SMALL.model_copy(update={"network": PLAIN}), places)
        trainer.start()
        losses.append([p.loss for p in trainer.run(every=5)])
        weights.append(trainer.network.project.weight.detach().numpy().copy())
    assert losses[0][-1] < 0.8 * losses[0][0]
    assert losses[0] == losses[1]
    np.testing.assert_array_equal(weights[0], weights[1])


def test_training_with_gradient_histograms_learns_too(places: list[PlaceSet]) -> None:
    # They start where convolutions alone get to, so what is learned shows on batches kept aside, not from step to step,
    # and in images with more than a handful of histograms.
    larger = {"steps": 60, "width": 96, "height": 72, "learning_rate": 1e-3}
    trainer = Trainer(SMALL.model_copy(update=larger), places)
    trainer.start()
    kept = [trainer._batch(1000 + k) for k in range(6)]

    def loss() -> float:
        trainer.network.train()
        with torch.no_grad():
            vlads = [trainer.network.aggregate(torch.cat(pair)) for pair in kept]
            return float(np.mean([info_nce(*v.chunk(2), torch.tensor(12.0))[0] for v in vlads]))

    before = loss()
    list(trainer.run())
    assert loss() < 0.9 * before


def test_a_resumed_training_goes_where_an_unbroken_one_goes(tmp_path: Path, places: list[PlaceSet]) -> None:
    whole = Trainer(SMALL, places)
    whole.start()
    for progress in whole.run(every=10):
        if progress.step == 10:
            whole.save(tmp_path / "ten.pt")
    resumed = Trainer(SMALL, places)
    resumed.resume(tmp_path / "ten.pt")
    list(resumed.run(every=10))
    for a, b in zip(whole.network.parameters(), resumed.network.parameters(), strict=True):
        np.testing.assert_array_equal(a.detach().numpy(), b.detach().numpy())


def test_checkpoints_are_checked(tmp_path: Path, places: list[PlaceSet]) -> None:
    (tmp_path / "broken.pt").write_bytes(b"no checkpoint")
    with pytest.raises(DescriptorError, match=r"broken\.pt: not a checkpoint"):
        read_checkpoint(tmp_path / "broken.pt")
    trainer = Trainer(SMALL, places)
    trainer.save(tmp_path / "zero.pt")
    assert load_network(tmp_path / "zero.pt").config == TINY
    with pytest.raises(DescriptorError, match="another training configuration"):
        Trainer(SMALL.model_copy(update={"pairs": 10}), places).resume(tmp_path / "zero.pt")


def test_projection_is_partly_whitened_principal_components() -> None:
    network = build_network(TINY, 2)
    images = np.stack([textured_image(seed, 48, 64) for seed in range(64)])
    initialise(network, images, np.random.default_rng(3))
    shares = fit_projection(network, images)
    batch = torch.from_numpy(images)[:, None]
    with torch.no_grad():
        vlads = network.aggregate(batch).double().numpy()
        outputs = network.project(network.aggregate(batch)).numpy()
    centred = vlads - vlads.mean(axis=0)
    _, singular, axes = np.linalg.svd(centred, full_matrices=False)
    expected = centred @ axes[:32].T / (singular[:32] / singular[0]) ** 0.75
    np.testing.assert_allclose(np.abs(outputs), np.abs(expected), atol=1e-4)
    np.testing.assert_allclose(shares, singular[:32] ** 2 / (singular**2).sum(), atol=1e-6)
    assert (np.diff(outputs.var(axis=0)) <= 1e-9).all()


def test_the_learned_projection_finds_what_principal_axes_of_noise_hide() -> None:
    # Places differ along 40 weak directions, views along 30 strong ones that say nothing about the place.
    rng = np.random.default_rng(8)
    place, noise = rng.normal(size=(500, 40)), [3.0 * rng.normal(size=(500, 30)) for _ in range(2)]
    basis = np.linalg.qr(rng.normal(size=(100, 70)))[0].T
    first, second = (np.hstack([place, one]) @ basis + 5.0 for one in noise)
    config = ProjectionConfig(axes=70, steps=200, pairs=128, learning_rate=1e-2)
    found = []
    for train, steps in ((400, 0), (400, 200)):
        weight, bias = learn_projection(
            first[:train].astype(np.float32),
            second[:train].astype(np.float32),
            32,
            config.model_copy(update={"steps": steps}),
            0,
        )
        a, b = ((side @ weight.T + bias) for side in (first[train:], second[train:]))
        a, b = (side / np.linalg.norm(side, axis=1, keepdims=True) for side in (a, b))
        found.append(float((np.argmax(a @ b.T, axis=1) == np.arange(len(a))).mean()))
        spread = (np.concatenate([first[:train], second[:train]]) @ weight.T + bias).var(axis=0)
        assert (np.diff(spread) < 1e-3).all()  # strongest first
    # Of 70 directions 32 are kept: principal axes alone keep the strong ones.
    assert found[0] < 0.5 and found[1] > 0.8


def test_a_start_from_smaller_weights_keeps_them(tmp_path: Path, places: list[PlaceSet]) -> None:
    old = Trainer(SMALL.model_copy(update={"network": PLAIN}), places)
    old.start()
    old.save(tmp_path / "plain.pt")
    grown = Trainer(SMALL, places)
    fresh = grown.start_from(tmp_path / "plain.pt")
    assert {name.split(".")[0] for name in fresh} == {"context", "gradient_reduce", "gradient_vlad"}
    batch = torch.from_numpy(textured_image(3, 48, 64))[None, None]
    old.network.eval(), grown.network.eval()
    with torch.no_grad():  # the new layers add nothing yet
        torch.testing.assert_close(grown.network.local_features(batch), old.network.local_features(batch))


def test_places_that_see_each_other_never_meet_in_a_batch() -> None:
    views = np.zeros((30, 2, 8, 8), dtype=np.uint8) + np.arange(30, dtype=np.uint8)[:, None, None, None]
    near = np.abs(np.subtract.outer(np.arange(30), np.arange(30))) <= 2
    place_set = PlaceSet("line", views, conflicts=near)
    for seed in range(20):
        first, second = place_set.draw(8, np.random.default_rng(seed))
        index = first[:, 0, 0].astype(int)
        np.testing.assert_array_equal(index, second[:, 0, 0])
        assert not near[np.ix_(index, index)][~np.eye(len(index), dtype=bool)].any()


def test_the_two_views_of_a_place_differ() -> None:
    views = np.arange(24, dtype=np.uint8).reshape(8, 3, 1, 1) * np.ones((1, 1, 4, 4), dtype=np.uint8)
    first, second = PlaceSet("p", views).draw(8, np.random.default_rng(0))
    assert (first != second).all()
    assert (first // 3 == second // 3).all()


def test_augmentation_repeats_and_stays_an_image(images: list[np.ndarray]) -> None:
    stack = np.stack(images)
    a, b = augment_pair(stack, stack, (48, 64), PHOTOS, np.random.default_rng(1))
    again, _ = augment_pair(stack, stack, (48, 64), PHOTOS, np.random.default_rng(1))
    assert a.shape == b.shape == (8, 1, 48, 64)
    assert torch.equal(a, again)
    assert not torch.equal(a, b)
    assert float(a.min()) >= 0 and float(a.max()) <= 255
    assert float(a.std()) > 10


def test_collages_share_a_strip(images: list[np.ndarray]) -> None:
    stack = np.stack(images)
    collages = share_strips(stack, 1.0, np.random.default_rng(2))
    for i in range(0, 8, 2):
        changed = [np.flatnonzero((collages[i + k] != stack[i + k]).any(axis=0)) for k in (0, 1)]
        columns = [collages[i + k][:, changed[k][0] : changed[k][-1] + 1] for k in (0, 1)]
        assert min(c.shape[1] for c in columns) >= 20
