"""Ours and a user's own pass the same contracts. The user's are those of ``examples/``."""

from __future__ import annotations

import csv
import importlib.util
import json
import socket
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from contracts import DescriptorContract, PolicyContract, ReaderContract, TransportContract
from dataset_makers import make_scene, write_euroc, write_kitti, write_rendered, write_seven_scenes, write_tum

import maslam
from maslam.frontend.datasets.readers import ANY_IMAGES, OURS
from maslam.mas.policies.presets import policy_of, preset
from maslam.mas.transport.faults import FaultyTransport
from maslam.mas.transport.transport import InProcessTransport

ROOT = Path(__file__).resolve().parents[2]


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name[:2]}", ROOT / "examples" / name)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class TestOurs(PolicyContract):
    @pytest.fixture(params=["predecessor", "default", "optimised", "selection", "maslam"], autouse=True)
    def of_preset(self, request: pytest.FixtureRequest) -> None:
        self.preset = request.param

    def make(self) -> maslam.Policy:
        return policy_of(preset(self.preset), 0)


class TestOwnPolicy(PolicyContract):
    def make(self) -> maslam.Policy:
        return example("02_own_policy.py").AskTheLikeliest()


WRITERS = {
    "kitti": write_kitti,
    "euroc": write_euroc,
    "tum": write_tum,
    "7scenes": write_seven_scenes,
    "images": partial(write_rendered, rig="stereo"),
}


class TestOurReaders(ReaderContract):
    @pytest.fixture(params=WRITERS, autouse=True)
    def of_kind(self, request: pytest.FixtureRequest) -> None:
        self.kind = request.param

    def make(self) -> maslam.Reader:
        return next(reader for reader in (*OURS, ANY_IMAGES) if reader.kind == self.kind)

    def write(self, folder: Path) -> None:
        WRITERS[self.kind](folder, make_scene())


def write_csv_dataset(folder: Path, images: int = 5) -> None:
    import cv2

    rng = np.random.default_rng(0)
    with open(folder / "frames.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "file"])
        for i in range(images):
            cv2.imwrite(str(folder / f"shot{i}.png"), rng.integers(0, 255, (24, 32), dtype=np.uint8))
            table.writerow([f"{i / 10:.3f}", f"shot{i}.png"])
    camera = {"width": 32, "height": 24, "fx": 30.0, "fy": 30.0, "cx": 15.5, "cy": 11.5}
    (folder / "camera.json").write_text(json.dumps(camera))


class TestOwnReader(ReaderContract):
    def make(self) -> maslam.Reader:
        return example("04_own_dataset.py").CsvReader()

    def write(self, folder: Path) -> None:
        write_csv_dataset(folder)


class TestNetVlad(DescriptorContract):
    def make(self) -> maslam.Descriptor:
        return maslam.NetVlad.load()


class TestOwnDescriptor(DescriptorContract):
    def make(self) -> maslam.Descriptor:
        return example("03_own_descriptor.py").EdgeMap()


class TestInProcess(TransportContract):
    def make(self) -> maslam.Transport:
        return InProcessTransport()


class TestFaultyWithoutFaults(TransportContract):
    def make(self) -> maslam.Transport:
        return FaultyTransport(InProcessTransport(), preset("maslam").faults, seed=0)


class SocketPair(maslam.Transport):
    """A user's own: every byte goes through the operating system."""

    def __init__(self) -> None:
        super().__init__()
        self._out, self._in = socket.socketpair()
        self._sent: list[tuple[int, int, int]] = []
        for end in (self._out, self._in):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**22)

    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        self._sent.append((sender, recipient, len(data)))
        self._out.sendall(data)

    def arrive(self) -> maslam.HandedOver | None:
        if not self._sent:
            return None
        sender, recipient, length = self._sent.pop(0)
        return maslam.HandedOver(sender, recipient, self._in.recv(length, socket.MSG_WAITALL))


class TestOwnTransport(TransportContract):
    def make(self) -> maslam.Transport:
        return SocketPair()
