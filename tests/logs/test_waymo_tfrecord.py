"""TFRecord framing, its checksum, and messages of the dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.logs.importers.waymo import load_waymo
from recast.logs.importers.waymo_proto import FieldError, decode
from recast.logs.importers.waymo_tfrecord import TfRecord, _find, masked_crc, read_records
from support import proto_writer as write


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        (b"123456789", 0xE3069283),
        (bytes(32), 0x8A9136AA),  # the vectors of RFC 3720, appendix B.4
        (b"\xff" * 32, 0x62A8AB43),
        (bytes(range(32)), 0x46DD794E),
        (b"", 0),
    ],
)
def test_the_checksum_is_the_one_of_the_standard(data: bytes, crc: int) -> None:
    unmasked = (masked_crc(data) - 0xA282EAD8) % (1 << 32)
    assert (unmasked << 15 | unmasked >> 17) % (1 << 32) == crc


def test_records_come_back_bit_by_bit(tmp_path: Path) -> None:
    records = [np.random.default_rng(i).bytes(n) for i, n in enumerate((0, 1, 50_000, 7))]
    path = tmp_path / "own.tfrecord"
    write.write_records(path, records)
    read = list(read_records(path))
    assert [record.data for record in read] == records
    assert [record.number for record in read] == [0, 1, 2, 3]
    stored = path.read_bytes()
    for record in read:
        assert stored[record.offset : record.offset + len(record.data)] == record.data
    assert b"".join(write.frame_record(record.data) for record in read) == stored


def test_a_part_of_a_record_is_found_though_others_end_alike() -> None:
    end = bytes(100)
    parts = [b"one" + end, b"other" + end, b"short", b""]
    record = TfRecord(0, 500, b"head" + parts[0] + parts[1] + parts[2] + b"tail")
    for part in parts:
        at = _find(part, record)
        assert record.data[at : at + len(part)] == part
    assert [_find(part, record) for part in parts[:2]] == [4, 4 + len(parts[0])]


def _flip(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: _flip(d, 0), "record 0, length: the file is not an uncompressed TFRecord"),
        (
            lambda d: b"\x89PNG and other things that are longer",
            "record 0, length: the file is not",
        ),
        (lambda d: _flip(d, 14), "record 0, data: do not match their checksum"),
        (lambda d: _flip(d, 12 + 100), "record 0, data: do not match their checksum"),
        (lambda d: _flip(d, 116), "record 1, length: does not match its checksum"),
        (lambda d: d[:-10], "record 1, data: are cut off, 10 bytes are missing"),
        (lambda d: d[:-2], "record 1, data: are cut off, 2 bytes are missing"),
        (lambda d: d[: 116 + 5], "record 1, length: is cut off"),
        (lambda d: b"", "record 0: is missing: the file is empty"),
    ],
)
def test_damaged_files_are_one_clear_line(tmp_path: Path, damage: object, message: str) -> None:
    path = tmp_path / "broken.tfrecord"
    write.write_records(path, [bytes(range(100)), bytes(50)])
    assert callable(damage)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError) as raised:
        list(read_records(path))
    assert str(raised.value).startswith(f"{path}: {message}")


@given(
    frame=st.integers(-(2**63), 2**63 - 1),
    numbers=st.lists(st.floats(allow_nan=False), max_size=4),
    ids=st.lists(st.integers(0, 2**40), max_size=4),
    packed=st.booleans(),
)
def test_messages_are_read_packed_or_not(
    frame: int, numbers: list[float], ids: list[int], packed: bool
) -> None:
    unknown = write.blob(99, "unknown") + write.single(98, 1.0)
    if packed:
        pose, exits = write.packed_doubles(1, numbers), write.packed_integers(10, ids)
    else:
        pose, exits = write.doubles(1, numbers), b"".join(write.integer(10, i) for i in ids)
    message = decode("Frame", write.integer(2, frame) + unknown + write.blob(3, pose))
    assert message["timestamp_micros"] == frame
    assert message["pose"]["transform"].tolist() == numbers
    assert decode("LaneCenter", exits + unknown)["exit_lanes"].tolist() == ids
    assert message.get("context") is None


def test_parts_of_a_message() -> None:
    raw = b"\x00\x01 picture"
    image = write.integer(1, 2) + write.blob(2, raw)
    data = write.blob(1, write.blob(1, "Straße")) + write.blob(4, image) + write.blob(4, b"")
    message = decode("Frame", data)
    assert message["context"]["name"] == "Straße"
    assert (message["images"][0]["name"], message["images"][0]["image"]) == ("FRONT_LEFT", raw)
    assert decode("ObjectState", write.single(5, 0.5))["length"] == 0.5
    with pytest.raises(FieldError, match=r"^images\[1\].image: is missing"):
        message["images"][1]["image"]


@pytest.mark.parametrize(
    ("data", "field", "message"),
    [
        (write.integer(1, 7), "name", r"^name: is 7, not a LaserName \(1 TOP, 2 FRONT, "),
        (write.integer(1, -1), "name", "^name: is -1, not a LaserName"),
        (write.blob(1, "TOP"), "name", "^name: is missing"),  # of another wire type: unknown
        (write.blob(2, "image")[:-1], "return1", "^Laser: is not a protocol buffer, or is cut off"),
        (write.blob(2, write.blob(2, "image")[:-1]), "return1", "^Laser: is not a protocol buffer"),
        (b"\x0c", "name", "^Laser: is not a protocol buffer"),
        (b"\x08" + b"\xff" * 11, "name", "^Laser: is not a protocol buffer"),
        (b"\x08", "name", "^Laser: is not a protocol buffer"),
    ],
)
def test_bytes_that_are_no_such_message_are_told(data: bytes, field: str, message: str) -> None:
    with pytest.raises(FieldError, match=message):
        decode("Laser", data)[field]


def test_bytes_that_are_no_text_are_told() -> None:
    with pytest.raises(FieldError, match=r"^id: is not text"):
        decode("Label", write.blob(4, b"\xff\xfe"))["id"]
    with pytest.raises(FieldError, match=r"^Transform: is not a protocol buffer"):
        decode("Transform", write.blob(1, b"1234567"))


def _field(number: int, data: bytes) -> bytes:
    size, length = len(data), b""
    while size > 127:
        length, size = length + bytes([size & 127 | 128]), size >> 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + data


@pytest.mark.parametrize("floats", [1, 100])
def test_a_tf_example_is_named(tmp_path: Path, floats: int) -> None:
    feature = _field(2, _field(1, np.zeros(floats, "<f4").tobytes()))
    entries = [_field(1, _field(1, name) + _field(2, feature)) for name in (b"state/id", b"b")]
    write.write_records(tmp_path / "a.tfrecord", [_field(1, b"".join(entries))])
    wanted = "record 0: is a tf.Example of features such as state/id, not a frame or scenario"
    with pytest.raises(InputError, match=wanted):
        load_waymo(tmp_path, "a.tfrecord")


def test_an_archive_in_place_of_records_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.tfrecord").write_bytes(b"\x1f\x8b\x08" + bytes(30))
    with pytest.raises(InputError, match="not an uncompressed TFRecord but a gzip archive"):
        load_waymo(tmp_path, "a.tfrecord")
