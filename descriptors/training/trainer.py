"""Training of NetVLAD from images alone: symmetric InfoNCE over pairs of views of one place.

Images come as :class:`PlaceSet` (photographs, rendered worlds); nothing here reads or renders them. Every step
draws its batch from ``(seed, step)``, so a resumed training goes exactly where an unbroken one would have gone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ValidationError
from torch import Tensor, nn

from maslam._atomic import replacing
from maslam._replaced import replaced

from ..config import TrainingConfig
from ..errors import DescriptorError
from .augmentation import PHOTOS, Augmentation, augment_pair, share_strips
from .initialisation import initialise, settle_batch_norms, vlads_of
from .losses import info_nce
from .network import NetVladNetwork, build_network
from .projection import learn_projection, set_projection

_MAX_SCALE = 60.0


@dataclass(frozen=True)
class PlaceSet:
    """Places seen V times each: ``views`` ``(P, V, h, w)`` uint8; V = 1 for photographs, whose second view is made.

    ``conflicts`` ``(P, P)`` bool: pairs of places that see each other and so must not be separated (None: no such
    pairs). ``group``: sets of one group take turns, one in each batch, so that a batch holds many places of one world:
    its look-alikes are the negatives that teach most. ``weight``: the group's share of the batches, relative to the
    others'. ``strips``: share of neighbours in a batch that are made look-alikes by a common strip.
    """

    name: str
    views: NDArray[np.uint8]
    conflicts: NDArray[np.bool_] | None = None
    weight: float = 1.0
    group: str = ""
    augmentation: Augmentation = PHOTOS
    strips: float = 0.0

    def __post_init__(self) -> None:
        if self.views.ndim != 4 or self.views.dtype != np.uint8:
            raise DescriptorError(
                f"place set {self.name}: views must be (P, V, h, w) uint8, got {self.views.shape} {self.views.dtype}"
            )
        if self.conflicts is not None and self.conflicts.shape != (len(self.views),) * 2:
            raise DescriptorError(
                f"place set {self.name}: {len(self.views)} places but conflicts of shape {self.conflicts.shape}"
            )

    def draw(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Two images ``(n, h, w)`` of each of up to ``count`` places, no two of which see each other."""
        chosen: list[int] = []
        blocked = np.zeros(len(self.views), dtype=bool)
        for place in rng.permutation(len(self.views)):
            if not blocked[place]:
                chosen.append(int(place))
                if self.conflicts is not None:
                    blocked |= self.conflicts[place]
                if len(chosen) == count:
                    break
        return self.pair_of(np.array(chosen), rng)

    def pair_of(self, index: NDArray[np.int_], rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Two images ``(n, h, w)`` of each of these places; the same one twice where a place has but one."""
        seen = self.views.shape[1]
        a = rng.integers(seen, size=len(index))
        b = (a + rng.integers(1, seen, size=len(index))) % seen if seen > 1 else a
        return self.views[index, a], self.views[index, b]


@dataclass(frozen=True)
class TrainingProgress:
    """One line of a training's log; ``validation`` is empty between validations."""

    step: int
    loss: float
    accuracy: float
    scale: float
    validation: dict[str, float]


class Trainer:
    """The state of a training: network, optimiser, step; on a GPU where there is one. ``run`` yields progress;
    ``save`` and ``resume`` keep all of it."""

    def __init__(self, config: TrainingConfig, sets: Sequence[PlaceSet]) -> None:
        if not sets:
            raise DescriptorError("training needs at least one set of places")
        self.config, self.sets, self.step = config, list(sets), 0
        self._previous_threads = torch.get_num_threads()
        torch.set_num_threads(config.threads)
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.network: NetVladNetwork = build_network(config.network, config.seed).to(self.device)
        self.log_scale = nn.Parameter(torch.tensor(math.log(config.start_scale), device=self.device))
        decayed = [p for p in self.network.parameters() if p.ndim > 1]
        plain = [p for p in self.network.parameters() if p.ndim <= 1] + [self.log_scale]
        groups = [{"params": decayed, "weight_decay": config.weight_decay}, {"params": plain, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=config.learning_rate)

    def start(self) -> None:
        """k-means centres, principal axes, batch-norm statistics (``initialisation``)."""
        rng = np.random.default_rng([self.config.seed, 0, 1])
        initialise(self.network, self.sample_images(self.config.initial_images, rng), rng)

    def start_from(self, path: Path) -> list[str]:
        """Start, but with all weights of a checkpoint that this network has too; names of the layers that it lacks."""
        self.start()
        weights = read_checkpoint(path)["network"]
        own = self.network.state_dict()
        taken = {name: value for name, value in weights.items() if name in own and value.shape == own[name].shape}
        if not any(name.startswith("backbone") for name in taken):
            raise DescriptorError(f"{path}: none of its layers fits this network")
        self.network.load_state_dict(taken, strict=False)
        return sorted({name.rsplit(".", 1)[0] for name in own if name not in taken and not name.startswith("project")})

    def run(
        self, validate: Callable[[NetVladNetwork], dict[str, float]] | None = None, every: int = 50
    ) -> Iterator[TrainingProgress]:
        """Train up to the configured number of steps; yields the averages of every ``every`` steps."""
        loss_sum = accuracy_sum = count = 0.0
        for batch in self._batches():
            loss, accuracy = self._train_step(batch)
            loss_sum, accuracy_sum, count = loss_sum + loss, accuracy_sum + accuracy, count + 1
            if self.step % every == 0 or self.step == self.config.steps:
                figures = {}
                if validate is not None and (
                    self.step % self.config.checkpoint_every == 0 or self.step == self.config.steps
                ):
                    self.network.eval()
                    figures = validate(self.network)
                yield TrainingProgress(
                    self.step, loss_sum / count, accuracy_sum / count, float(self.log_scale.detach().exp()), figures
                )
                loss_sum = accuracy_sum = count = 0.0

    def finish(self) -> None:
        """Settle batch norms, and learn the projection from two views of every place."""
        rng = np.random.default_rng([self.config.seed, 0, 2])
        settle_batch_norms(self.network, self.sample_images(self.config.initial_images, rng))
        first, second = (vlads_of(self.network, side) for side in self.every_place(rng))
        dim, how = self.config.network.dim, self.config.projection
        set_projection(self.network, *learn_projection(first, second, dim, how, self.config.seed))
        torch.set_num_threads(self._previous_threads)

    def every_place(self, rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Two augmented views ``(P, H, W)`` of every place of every set; again and again where there are too few for as
        many images as training starts from."""
        size = (self.config.height, self.config.width)
        rounds = math.ceil(self.config.initial_images / (2 * sum(len(one.views) for one in self.sets)))
        sides: tuple[list[NDArray[np.uint8]], list[NDArray[np.uint8]]] = ([], [])
        for one in self.sets * rounds:
            for rows in np.array_split(np.arange(len(one.views)), max(1, len(one.views) // self.config.pairs)):
                pair = augment_pair(*one.pair_of(rows, rng), size, one.augmentation, rng)
                for side, views in zip(sides, pair, strict=True):
                    side.append(views[:, 0].numpy().astype(np.uint8))
        return np.concatenate(sides[0]), np.concatenate(sides[1])

    def sample_images(self, count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
        """``(count, H, W)`` augmented training images, from the sets by their weights."""
        out: list[Tensor] = []
        while sum(map(len, out)) < count:
            out.extend(self._draw_batch(rng))
        return np.ascontiguousarray(torch.cat(out)[:count, 0].numpy().astype(np.uint8))

    def save(self, path: Path) -> None:
        """Write the whole state; atomically, so that a broken write never looks like a checkpoint."""
        state = {
            "config": self.config.model_dump_json(),
            "step": self.step,
            "network": self.network.state_dict(),
            "log_scale": self.log_scale.detach(),
            "optimiser": self.optimiser.state_dict(),
        }
        with replacing(path) as part:
            torch.save(state, part)

    def resume(self, path: Path) -> None:
        """Continue from :meth:`save`; a checkpoint of another configuration is an error (a longer training is not)."""
        state = read_checkpoint(path)
        config = _config_of(state, path)
        same = {"steps": 0, "checkpoint_every": 1, "threads": 1}
        if replaced(config, **same) != replaced(self.config, **same):
            raise DescriptorError(f"{path}: checkpoint of another training configuration")
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        with torch.no_grad():
            self.log_scale.copy_(state["log_scale"])
        self.step = int(state["step"])

    def _draw_batch(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Both views of a batch, ``(n, 1, H, W)`` each. Every batch mixes all groups: batch norms see in training
        what they see later, and no batch can be recognised by its style."""
        groups: dict[str, list[PlaceSet]] = {}
        for one in self.sets:
            groups.setdefault(one.group or one.name, []).append(one)
        taken = [members[int(rng.integers(len(members)))] for _, members in sorted(groups.items())]
        weights = np.array([one.weight for one in taken])
        counts = rng.multinomial(self.config.pairs, weights / weights.sum())
        size = (self.config.height, self.config.width)
        parts = []
        for chosen, count in zip(taken, counts, strict=True):
            if count:
                first, second = chosen.draw(int(count), rng)
                strip_seed = int(rng.integers(2**32))  # the same strips in both views
                if chosen.strips > 0:
                    first = share_strips(first, chosen.strips, np.random.default_rng(strip_seed))
                    second = share_strips(second, chosen.strips, np.random.default_rng(strip_seed))
                parts.append(augment_pair(first, second, size, chosen.augmentation, rng))
        return torch.cat([a for a, _ in parts]), torch.cat([b for _, b in parts])

    def _batches(self) -> Iterator[tuple[Tensor, Tensor]]:
        """The batches of all steps to go; the next one is made in the background while one is learned from."""
        with ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(1,)) as background:
            coming = None
            for step in range(self.step, self.config.steps):
                batch = (coming or background.submit(self._batch, step)).result()
                coming = background.submit(self._batch, step + 1) if step + 1 < self.config.steps else None
                yield batch

    def _batch(self, step: int) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            return self._draw_batch(np.random.default_rng([self.config.seed, 1, step]))

    def _train_step(self, batch: tuple[Tensor, Tensor]) -> tuple[float, float]:
        first, second = (views.to(self.device) for views in batch)
        self.network.train()
        rate = self.config.learning_rate * _schedule(self.step, self.config)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        # On the VLAD vector, not behind the projection: trained jointly, the projection learns the training images by
        # heart, and separates places of another world far worse than the vector it is given
        # (docs/appendix/netvlad.md).
        vlad = self.network.aggregate(torch.cat([first, second]), self.config.gradient_thinning, self.step)
        scale = self.log_scale.exp().clamp(max=_MAX_SCALE)
        loss, accuracy = info_nce(vlad[: len(first)], vlad[len(first) :], scale)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.step += 1
        if not math.isfinite(float(loss.detach())):
            raise DescriptorError(f"training diverged at step {self.step}: loss is not finite")
        return float(loss.detach()), float(accuracy)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The state that :meth:`Trainer.save` wrote, read without executing anything in the file."""
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise DescriptorError(f"{path}: not a checkpoint of NetVLAD training: {error}") from error
    if not isinstance(state, dict) or not {"config", "step", "network"} <= state.keys():
        raise DescriptorError(f"{path}: not a checkpoint of NetVLAD training")
    return state


def load_network(path: Path) -> NetVladNetwork:
    """The network of a checkpoint, ready to evaluate."""
    state = read_checkpoint(path)
    config = _config_of(state, path)
    network = build_network(config.network, config.seed)
    network.load_state_dict(state["network"])
    return network.eval()


def _config_of(state: dict[str, Any], path: Path) -> TrainingConfig:
    try:
        return TrainingConfig.model_validate_json(state["config"])
    except ValidationError as error:
        raise DescriptorError(
            f"{path}: made by another version of this program ({error.error_count()} settings differ)"
        ) from error


def _schedule(step: int, config: TrainingConfig) -> float:
    if step < config.warmup_steps:
        return (step + 1) / config.warmup_steps
    done = (step - config.warmup_steps) / max(config.steps - config.warmup_steps, 1)
    return 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0)))
