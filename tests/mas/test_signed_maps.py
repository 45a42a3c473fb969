"""Who sells on another's map cannot change it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from memory_links import MemoryNetwork
from test_agent_process import Clock, Team

from maslam.mas.live import process as process_module
from maslam.mas.live.authority import make_team
from maslam.mas.live.credentials import Credentials
from maslam.mas.live.durations import departing
from maslam.mas.live.journal import EntryKind, read_journal
from maslam.mas.live.process import AgentProcess
from maslam.mas.live.recorded_agent import signatures_in
from maslam.mas.live.signed_maps import SIGNED, MapSignature, MapSignatures, digest_of_map, split_signed
from maslam.mas.map_exchange.coding.map_delta import encode as encode_map
from maslam.mas.map_exchange.coding.pose_corrections import Bound
from maslam.mas.map_exchange.coding.quantised_map import QuantisedMap
from maslam.mas.map_exchange.versions import make_patch
from maslam.mas.protocol.ids import ContractId
from maslam.mas.protocol.map_messages import MapDelivery, MapOrder, Parcel
from maslam.mas.protocol.messages import Message, Result, decode, encode
from maslam.mas.protocol.tensors import MessageError

pytest.importorskip("cryptography", reason="the extra 'network' is not installed")


@dataclass
class Traders:
    """Three agents after their run, in which each bought the others' maps. ``processes``: as they were at their end."""

    team: Team
    processes: dict[int, AgentProcess]

    def delivery(self) -> Message:
        """What agent 1 sells to agent 2, who has nothing yet: agent 0's map and its own."""
        agent = self.processes[1].agent.agent
        sold = agent.maps.seller.delivery(2, MapOrder((0, 1)), agent.maps.copies, closing=True)
        return Message(1, 2, ContractId(2, 1), Result(sold))

    def signatures(self, me: int) -> MapSignatures:
        """Of an agent that is started again from its journal."""
        kept = signatures_in(self.team.journal(me))
        return MapSignatures(self.team.credentials[me], self.processes[me].agent.agent, kept)

    def buyer(self) -> MapSignatures:
        """Agent 2's, which has no copies yet."""
        buyer = self.signatures(2)
        buyer._made = lambda parcel: MapSignatures._made(_WithoutCopies(), parcel)  # type: ignore[method-assign, arg-type]
        return buyer


class _WithoutCopies:
    """A buyer's signatures, of an agent that has bought nothing."""

    _agent = SimpleNamespace(maps=SimpleNamespace(copies={}))


@pytest.fixture(scope="module")
def traders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Traders]:
    with pytest.MonkeyPatch.context() as patched:
        clock = Clock()
        patched.setattr(process_module, "time", clock)
        patched.setattr("maslam.mas.live.neighbours.time", clock)
        team = Team(tmp_path_factory.mktemp("traders"), MemoryNetwork(), clock)
        for me in range(3):
            team.start(me)
        processes = dict(team.processes)
        team.go_on(120)
        assert sorted(team.ended) == [0, 1, 2]
        yield Traders(team, processes)


def test_maps_are_signed_and_counted(traders: Traders) -> None:
    """Each has the others' last versions, number for number; nothing was refused."""
    agents = {me: one.agent.agent for me, one in traders.processes.items()}
    for me, agent in agents.items():
        assert sorted(agent.maps.copies) == sorted({0, 1, 2} - {me})
        for owner, copy in agent.maps.copies.items():
            assert copy.map_version is not None
            original = agents[owner].maps.seller.sold[copy.version]
            assert digest_of_map(copy.map_version.map) == digest_of_map(original)
    entries = [entry for me in range(3) for entry in read_journal(traders.team.journal(me))]
    assert not [entry for entry in entries if entry.kind is EntryKind.REFUSE]
    sales = sum(entry.kind is EntryKind.SIGNED for entry in entries)
    sent = sum(one.signatures.sent_bytes for one in traders.processes.values())
    carried = [decode(entry.data, 2**24).body for entry in entries if entry.kind is EntryKind.MESSAGE]
    deliveries = [one.outcome for one in carried if isinstance(one, Result) and isinstance(one.outcome, MapDelivery)]
    assert sales == sum(bool(one.parcels) for one in deliveries) >= 6, "every delivery came with its signature"
    assert 75 * sales < sent < 90 * sales  # a signature of 71 bytes, and no certificate


def test_a_resold_map_is_taken_after_a_restart_of_its_seller(traders: Traders) -> None:
    """The owner's certificate comes with it: the buyer need not have met the owner."""
    message = traders.delivery()
    sealed = split_signed(traders.signatures(1).seal(message, encode(message)))
    assert sealed.message == encode(message) and [one.owner for one in sealed.signatures] == [0, 1]
    kept = traders.buyer().check(message, sealed.signatures, _certificate(traders, 1))
    assert [one.owner for one in msgspec.msgpack.decode(kept, type=list[MapSignature])] == [0, 1]


def _certificate(traders: Traders, me: int) -> bytes:
    other = 1 if me != 1 else 0
    greeting = traders.processes[me].neighbours._greeting
    return traders.team.credentials[other].check(greeting).certificate


def changed_map(traders: Traders, parcel: Parcel, change: Callable[[QuantisedMap], QuantisedMap]) -> Parcel:
    """The whole map of a parcel, changed, with a checksum that fits."""
    copy = traders.processes[1].agent.agent.maps.copies[0].map_version
    assert copy is not None
    made = change(copy.map)
    return msgspec.structs.replace(parcel, patches=(make_patch(None, made, encode_map(None, made, Bound())[0]),))


Tampered = tuple[Message, tuple[MapSignature, ...]]


def with_map(message: Message, parcel: Parcel) -> Message:
    outcome = message.body.outcome  # type: ignore[union-attr]
    assert isinstance(outcome, MapDelivery)
    parcels = (parcel, *outcome.parcels[1:])
    return msgspec.structs.replace(message, body=Result(msgspec.structs.replace(outcome, parcels=parcels)))


def a_point_nearer(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    parcel = message.body.outcome.parcels[0]  # type: ignore[union-attr]
    nearer = changed_map(traders, parcel, lambda m: replace(m, depths=m.depths - 1))
    return with_map(message, nearer), signatures


def a_pose_moved(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    parcel = message.body.outcome.parcels[0]  # type: ignore[union-attr]
    moved = changed_map(traders, parcel, lambda m: replace(m, poses=m.poses + 1))
    return with_map(message, moved), signatures


def a_later_version(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    """The owner's numbers under a later version, so that they take the place of the real one."""
    parcel = message.body.outcome.parcels[0]  # type: ignore[union-attr]
    later = changed_map(traders, parcel, lambda m: replace(m, version=m.version + 5))
    renamed = msgspec.structs.replace(signatures[0], version=signatures[0].version + 5)
    return with_map(message, later), (renamed, *signatures[1:])


def other_coordinates(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    parcel = message.body.outcome.parcels[0]  # type: ignore[union-attr]
    frame = msgspec.structs.replace(parcel.patches[0].frame, agent=1)
    return with_map(message, changed_map(traders, parcel, lambda m: replace(m, frame=frame))), signatures


def no_signature(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    return message, signatures[1:]


def signed_by_the_seller(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    changed, _ = a_point_nearer(traders, message, signatures)
    made = MapSignatures._made(_WithoutCopies(), changed.body.outcome.parcels[0])  # type: ignore[arg-type, union-attr]
    assert made is not None
    own = traders.team.credentials[1].sign(digest_of_map(made))
    forged = msgspec.structs.replace(signatures[0], signature=own)
    return changed, (forged, *signatures[1:])


def with_the_sellers_certificate(traders: Traders, message: Message, signatures: tuple[MapSignature, ...]) -> Tampered:
    changed, (forged, *rest) = signed_by_the_seller(traders, message, signatures)
    return changed, (msgspec.structs.replace(forged, certificate=_certificate(traders, 1)), *rest)


def with_a_certificate_of_its_own_making(
    traders: Traders, message: Message, signatures: tuple[MapSignature, ...]
) -> Tampered:
    other = traders.team.folder / "other"
    folder = other / "agent_00" if other.exists() else make_team(other, "ours", [0])[0]
    forger = Credentials(folder)
    from cryptography.hazmat.primitives.serialization import Encoding

    certificate = forger._certificate.public_bytes(Encoding.DER)
    changed, (forged, *rest) = signed_by_the_seller(traders, message, signatures)
    made = MapSignatures._made(_WithoutCopies(), changed.body.outcome.parcels[0])  # type: ignore[arg-type, union-attr]
    assert made is not None
    signature = forger.sign(digest_of_map(made))
    return changed, (msgspec.structs.replace(forged, certificate=certificate, signature=signature), *rest)


ATTACKS = [
    a_point_nearer,
    a_pose_moved,
    a_later_version,
    other_coordinates,
    no_signature,
    signed_by_the_seller,
    with_the_sellers_certificate,
    with_a_certificate_of_its_own_making,
]


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_what_a_reseller_changes_is_refused(traders: Traders, attack: Callable[..., Tampered]) -> None:
    honest = traders.delivery()
    signatures = split_signed(traders.signatures(1).seal(honest, b"")).signatures
    message, shown = attack(traders, honest, signatures)
    with pytest.raises(MessageError, match="a map of agent 0"):
        traders.buyer().check(message, shown, _certificate(traders, 1))


def test_a_changed_map_counts_against_its_seller(traders: Traders) -> None:
    """The buyer's process refuses the message before its agent sees it, writes so down, and keeps what it has."""
    process = traders.processes[2]
    process.agent.journal.__enter__()
    message = traders.delivery()
    signatures = split_signed(traders.signatures(1).seal(message, b"")).signatures
    changed, shown = a_point_nearer(traders, message, signatures)
    before = process.agent.agent.maps.copies[0]
    front = msgspec.msgpack.encode(shown)
    data = SIGNED + len(front).to_bytes(4, "little") + front + encode(departing(changed, 0))
    process._take(process_module.Received(1, data))
    process.agent.journal.__exit__(None, None, None)
    last = list(read_journal(traders.team.journal(2)))[-1]
    assert last.kind is EntryKind.REFUSE and b"that it did not make" in last.data
    assert process.agent.agent.maps.copies[0] is before


@pytest.mark.parametrize(
    "data",
    [SIGNED, SIGNED + b"\xff\xff\xff\xff", SIGNED + b"\1\0\0\0\xc1", SIGNED + b"\2\0\0\0\x91\x01abc"],
    ids=["nothing", "too long", "no MessagePack", "no signature"],
)
def test_signatures_that_cannot_be_read_are_refused(data: bytes) -> None:
    with pytest.raises(MessageError):
        split_signed(data)


def test_other_messages_are_as_they_were() -> None:
    assert split_signed(b"\x95abc").message == b"\x95abc" and split_signed(b"").message == b""


def test_the_folder_of_a_team_has_no_signatures_before_it_sells(tmp_path: Path) -> None:
    assert signatures_in(tmp_path / "none.bin") == []
