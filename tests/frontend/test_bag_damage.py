"""Damaged bags: one line that names the file, whatever is wrong with it; what can be read of them is right."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from test_bags import FORMATS, SCENE, pair_of, write

from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError

pytest.importorskip("rosbags", reason="the extra `bags` is not installed")

TRIES = 25


def file_of(path: Path) -> Path:
    """The file of messages of a bag."""
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap", ".zstd"))


def read_all(path: Path) -> None:
    for sequence in open_dataset(path, strict=False).sequences:
        for i in range(len(sequence)):
            sequence.read(i)


@pytest.mark.parametrize("name", FORMATS)
def test_a_bag_that_is_cut_off_is_one_line(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name, pair_of())
    file = file_of(path)
    data = file.read_bytes()
    for share in (0.0, 0.01, 0.5, 0.99):
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(FrontendError) as caught:
            read_all(path)
        assert str(caught.value).startswith(str(file)) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FORMATS)
def test_wrong_bytes_are_an_error_or_nothing(tmp_path: Path, name: str) -> None:
    """Whatever stands in the file: no other exception than ours."""
    path = write(tmp_path / name, pair_of())
    file, rng = file_of(path), np.random.default_rng(5)
    data, said = file.read_bytes(), []
    for k in range(TRIES):
        broken = bytearray(data)
        ends = 4000 if k % 2 else len(data)  # half of them where the index is
        for at in rng.integers(max(0, len(data) - ends), len(data), 8):
            broken[at] = rng.integers(256)
        file.write_bytes(bytes(broken))
        try:
            read_all(path)
        except FrontendError as error:
            said.append(str(error))
    assert said and all("\n" not in line for line in said)


def test_a_bag_that_was_not_closed_is_named_with_its_cure(tmp_path: Path) -> None:
    path = write(tmp_path / "run.bag", pair_of())
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = struct.pack("<Q", 0)
    path.write_bytes(bytes(data))
    with pytest.raises(FrontendError, match=r"run.bag: no bag that can be read \(`rosbag reindex` mends .*not indexed"):
        open_dataset(path)


def test_an_mcap_that_was_not_closed_is_named_with_its_cure(tmp_path: Path) -> None:
    path = write(tmp_path / "mcap", pair_of())
    file = file_of(path)
    file.write_bytes(file.read_bytes()[:-8])
    with pytest.raises(FrontendError, match=r"no MCAP that can be read \(`mcap recover` mends"):
        open_dataset(path)


def test_an_mcap_without_an_index_of_messages_is_gone_through(tmp_path: Path) -> None:
    """A summary is optional: without one, the messages are found in their chunks."""
    path = write(tmp_path / "mcap", pair_of())
    file = file_of(path)
    data = bytearray(file.read_bytes())
    footer = len(data) - 37
    (summary,) = struct.unpack_from("<Q", data, footer + 9)
    struct.pack_into("<QQ", data, footer + 9, 0, 0)
    file.write_bytes(bytes(data[:summary] + data[footer:]))
    (sequence,) = open_dataset(path).sequences
    np.testing.assert_array_equal(sequence.read(5).right, SCENE.rights[5])


def test_a_database_with_messages_outside_is_refused(tmp_path: Path) -> None:
    file = file_of(write(tmp_path / "sqlite3", pair_of()))
    file.with_name(file.name + "-wal").write_bytes(b"messages that were not yet moved into the file")
    with pytest.raises(FrontendError, match=r"it was not closed: .*-wal holds messages"):
        open_dataset(tmp_path / "sqlite3")


class TestMetadata:
    @pytest.fixture
    def metadata(self, tmp_path: Path) -> Path:
        return write(tmp_path / "sqlite3", pair_of()) / "metadata.yaml"

    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("sqlite3.db3", "other.db3", "other.db3: the file is missing, which metadata.yaml lists"),
            (
                "compression_mode: ''",
                "compression_mode: file",
                "metadata.yaml: files compressed by '', which is not read",
            ),
            ("relative_file_paths:", "relative_files:", "relative_file_paths: a list of files expected, found 'None'"),
            ("rosbag2_bagfile_information", "information", "rosbag2_bagfile_information: a group of keys expected"),
        ],
    )
    def test_what_is_wrong_is_named(self, metadata: Path, old: str, new: str, said: str) -> None:
        text = metadata.read_text()
        assert old in text, text
        metadata.write_text(text.replace(old, new))
        with pytest.raises(FrontendError, match=said):
            open_dataset(metadata.parent)

    def test_what_is_no_yaml_is_named(self, metadata: Path) -> None:
        metadata.write_text("a: [")
        with pytest.raises(FrontendError, match=r"metadata.yaml: not YAML"):
            open_dataset(metadata.parent)


@pytest.mark.parametrize(("encoding", "schema"), [("protobuf", "protobuf"), ("json", "jsonschema")])
def test_messages_that_are_none_of_ros_are_named(tmp_path: Path, encoding: str, schema: str) -> None:
    writer_of = pytest.importorskip("mcap.writer").Writer
    with open(tmp_path / "run.mcap", "wb") as file:
        writer = writer_of(file)
        writer.start()
        number = writer.register_schema("foxglove.CompressedImage", schema, b"")
        channel = writer.register_channel("/camera", encoding, number)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(
        FrontendError, match=r"run.mcap: an MCAP of profile '': messages of ROS 2 are read .* convert it"
    ):
        open_dataset(tmp_path / "run.mcap")
