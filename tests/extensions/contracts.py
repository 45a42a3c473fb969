"""What every policy, dataset reader, descriptor and transport must do. A test of ours, or of a user's own, inherits one
of these classes and says how to make the thing."""

from __future__ import annotations

import csv
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factory import town
from sample_messages import examples

import maslam
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.messages import Bid, encode
from maslam.mas.protocol.tensors import MessageError
from maslam.mas.simulation import make_agents, run
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.transport.transport import RefusedMessage, Sent

AGENTS = 3


def outlook(**changes: Any) -> maslam.Outlook:
    """What an agent may know in the middle of a run."""
    others = frozenset(range(1, AGENTS))
    fields: dict[str, Any] = {
        "pending_matches": 2, "since_optimised": 100, "since_bought": {}, "since_matched": {1: 3}, "stale": others,
        "distances": {1: 0.4, 2: 0.9}, "reachable": others, "closing": False, "delivered": {1: 4},
    }  # fmt: skip
    return maslam.Outlook(**{**fields, **changes})


SITUATIONS = (
    outlook(),
    outlook(closing=True),
    outlook(pending_matches=0, stale=frozenset(), distances={}, delivered={}),
    outlook(reachable=frozenset(), closing=True),
)


class PolicyContract:
    """``make()`` gives a new policy; ``preset`` is what it is run with."""

    preset = "maslam"

    def make(self) -> maslam.Policy:
        raise NotImplementedError

    def settings(self) -> maslam.MasConfig:
        """Place vectors here have 32 numbers; the predecessor's code takes 128."""
        config = preset(self.preset)
        return config.model_copy(update={"places": config.places.model_copy(update={"code": "float32"})})

    @pytest.fixture
    def state(self) -> maslam.AgentState:
        """Agent 0 of three after six key-frames, before it has met anyone."""
        manifest, sequences = town(AGENTS, 6, spacing_m=8.0)
        agent = make_agents(manifest, sequences, self.settings())[0]
        for keyframe in keyframes_of(sequences[0]):
            agent.observe(keyframe)
        return agent.state

    def answers(self, policy: maslam.Policy, state: maslam.AgentState) -> list[Any]:
        """Of all methods in all situations, in one order."""
        found: list[Any] = []
        for now in SITUATIONS:
            found += [policy.ask(state, now, len(state.keyframes) - 1), policy.recall(state, now, 1)]
            found += [policy.optimise(state, now), policy.peer_to_peer(state, now), policy.buy(state, now)]
        return found

    def test_names_agents_that_exist(self, state: maslam.AgentState) -> None:
        policy, everyone = self.make(), set(range(AGENTS))
        for now in SITUATIONS:
            assert set(policy.ask(state, now, 5)) | set(policy.recall(state, now, 1)) <= everyone
            assert set(policy.buy(state, now)) <= everyone - {state.me}
            members = policy.optimise(state, now)
            assert set(members) <= state.group and (not members or state.me in members)

    def test_changes_nothing_of_the_agent(self, state: maslam.AgentState) -> None:
        before = pickle.dumps((state.group, state.accepted, state.version, state.poses, sorted(state.verified)))
        self.answers(self.make(), state)
        assert before == pickle.dumps((state.group, state.accepted, state.version, state.poses, sorted(state.verified)))

    def test_two_of_a_kind_decide_alike(self, state: maslam.AgentState) -> None:
        assert self.answers(self.make(), state) == self.answers(self.make(), state)

    def test_a_bid_is_worth_a_finite_number(self) -> None:
        policy = self.make()
        for cost in (0, 1, 10**9):
            bid = Bid(ready_ns=5, cost_bytes=cost)
            assert all(np.isfinite(policy.worth(s, 3.0, bid, deadline)) for s in (0.0, 1.0) for deadline in (0, 9))

    def test_a_run_ends_and_is_the_same_again(self, tmp_path: Path) -> None:
        manifest, sequences = town(AGENTS, 14, spacing_m=7.0)
        for name in ("first", "second"):
            summary = run(manifest, sequences, self.settings(), tmp_path / name, policy=self.make)
        with open(tmp_path / "first" / "traffic.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        assert rows and summary.steps < 300
        for name in ("traffic.csv", "matches.csv", "events.jsonl", "config.yaml", "summary.json"):
            assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes(), name


class ReaderContract:
    """``make()`` gives a reader, ``write(folder)`` fills an empty folder with a data set of its kind."""

    def make(self) -> maslam.Reader:
        raise NotImplementedError

    def write(self, folder: Path) -> None:
        raise NotImplementedError

    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        folder = tmp_path / "recording"
        folder.mkdir()
        self.write(folder)
        return folder

    def test_recognises_its_own_and_nothing_else(self, folder: Path, tmp_path: Path) -> None:
        other = tmp_path / "other"
        (other / "notes").mkdir(parents=True)
        (other / "readme.txt").write_text("nothing to see")
        (other / "frames.csv").mkdir()  # a folder where a file is expected
        assert self.make().recognises(folder)
        assert not self.make().recognises(other)

    def test_opens_frames_in_order_of_time(self, folder: Path) -> None:
        sequence = self.make().open(folder, None)
        assert sequence.kind == self.make().kind and len(sequence) > 0
        assert sequence.stamps_ns.dtype == np.int64 and (np.diff(sequence.stamps_ns) > 0).all()
        camera = sequence.rig.camera
        for index, frame in enumerate(sequence.frames()):
            assert (frame.index, frame.stamp_ns) == (index, sequence.stamps_ns[index])
            assert frame.image.shape == (camera.height, camera.width) and frame.image.dtype == np.uint8
            assert (frame.right is not None) == (sequence.rig.kind is maslam.RigKind.STEREO)
            assert (frame.depth_m is not None) == (sequence.rig.kind is maslam.RigKind.RGBD)

    def test_frames_read_again_are_the_same(self, folder: Path) -> None:
        sequence = self.make().open(folder, None)
        np.testing.assert_array_equal(sequence.read(0).image, self.make().open(folder, None).read(0).image)

    def test_goes_to_a_worker_process(self, folder: Path) -> None:
        sequence = self.make().open(folder, None)
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(sequence)).read(0).image, sequence.read(0).image)  # noqa: S301 - our own

    def test_a_rig_that_the_files_do_not_allow_is_an_error(self, folder: Path) -> None:
        allowed = 0
        for rig in maslam.RigKind:
            try:
                allowed += self.make().open(folder, rig).rig.kind is rig
            except maslam.MaslamError:
                continue
        assert 0 < allowed < len(maslam.RigKind)

    def test_the_face_reads_with_it(self, folder: Path) -> None:
        dataset = maslam.open_dataset(folder, readers=[self.make()])
        assert dataset.kind == self.make().kind == maslam.open_dataset(folder, readers=[self.make]).kind


def picture(seed: int, shift_px: int = 0) -> np.ndarray:
    """Blobs of several sizes, ``(120, 160)`` grey."""
    import cv2

    rng = np.random.default_rng(seed)
    image = sum(
        cv2.resize(rng.uniform(0, 90, (n, 2 * n)).astype(np.float32), (240, 120), interpolation=cv2.INTER_CUBIC)
        for n in (4, 12, 40)
    )
    return np.clip(image[:, 40 + shift_px : 200 + shift_px], 0, 255).astype(np.uint8)


class DescriptorContract:
    """``make()`` gives a descriptor."""

    def make(self) -> maslam.Descriptor:
        raise NotImplementedError

    def test_makes_unit_vectors_of_any_images(self) -> None:
        model = self.make()
        images = [picture(1), picture(2)[:80], np.stack([picture(3)] * 3, axis=2), np.zeros((60, 80), np.uint8)]
        vectors, textured = model.look(images)
        assert vectors.shape == (4, model.dim) and vectors.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-3)
        assert textured.tolist() == [True, True, True, False]
        assert model.describe([]).shape == (0, model.dim)

    def test_an_image_gives_the_same_bytes_alone_and_among_others(self) -> None:
        model = self.make()
        together = model.describe([picture(1), picture(2), picture(3)])
        assert (
            model.describe([picture(2)])[0].tobytes()
            == together[1].tobytes()
            == self.make().describe([picture(2)])[0].tobytes()
        )

    def test_a_view_from_nearby_is_nearer_than_another_place(self) -> None:
        here, beside, elsewhere = self.make().describe([picture(1), picture(1, 3), picture(2)])
        assert np.linalg.norm(here - beside) < np.linalg.norm(here - elsewhere)

    def test_says_what_it_is(self) -> None:
        model, again = self.make(), self.make()
        assert model.name and model.sha256 == again.sha256
        assert len(model.sha256) == 64 and set(model.sha256) <= set("0123456789abcdef")
        assert 0 < model.threshold <= model.candidate_threshold <= 2 and model.min_std >= 0


class TransportContract:
    """``make()`` gives a transport without messages in it."""

    def make(self) -> maslam.Transport:
        raise NotImplementedError

    def begun(self, max_message_bytes: int = 2**20, record: Any = None) -> maslam.Transport:
        transport = self.make()
        transport.begin(max_message_bytes, record)
        return transport

    def test_each_message_arrives_once_in_order(self) -> None:
        transport = self.begun()
        for message in examples():
            transport.send(message, 0)
        got = [transport.receive() for _ in examples()]
        assert got == examples()
        assert transport.receive() is None and not transport.waiting

    def test_wire_bytes_are_the_encoded_lengths(self) -> None:
        seen: list[Sent] = []
        transport = self.begun(record=seen.append)
        for message in examples():
            transport.send(message, 3)
        assert [s.wire_bytes for s in seen] == [len(encode(m)) for m in examples()]
        total = sum(len(encode(m)) for m in examples())
        assert sum(c.wire_bytes for c in transport.by_operation.values()) == total
        assert sum(c.wire_bytes for c in transport.by_pair.values()) == total
        assert sum(c.messages for c in transport.by_operation.values()) == len(examples())

    def test_a_run_begins_with_nothing_counted(self) -> None:
        transport = self.begun()
        transport.send(examples()[0], 0)
        transport.receive()
        transport.begin(2**20)
        assert not transport.by_pair and not transport.refused
        assert sum(c.messages for c in transport.by_operation.values()) == 0

    def test_a_message_in_anothers_name_is_not_delivered(self) -> None:
        transport = self.begun()
        transport.send(examples()[0], 0, handed_by=3)
        transport.send(examples()[1], 0, handed_by=0)
        refused = transport.receive()
        assert isinstance(refused, RefusedMessage) and (refused.sender, refused.recipient) == (3, 1)
        assert transport.receive() == examples()[1] and transport.receive() is None
        assert transport.by_pair[3, 1].messages == 1, "what it sends counts for who sends it"

    def test_a_sender_cannot_send_what_nobody_would_take(self) -> None:
        with pytest.raises(MessageError, match="at most 20 travel"):
            self.begun(20).send(examples()[3], 0)

    def test_carries_a_run_as_within_one_process(self, tmp_path: Path) -> None:
        manifest, sequences = town(AGENTS, 14, spacing_m=7.0)
        run(manifest, sequences, preset("maslam"), tmp_path / "ours")
        run(manifest, sequences, preset("maslam"), tmp_path / "theirs", transport=self.make)
        for name in ("traffic.csv", "matches.csv", "events.jsonl"):
            assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes(), name
        ours, theirs = (maslam.evaluate(tmp_path / name) for name in ("ours", "theirs"))
        assert ours == theirs.model_copy(update={"faults": None})
