"""TFRecord framing, its checksum, and protocol buffers by tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.logs.importers.waymo_tfrecord import LANES, crc32c, crc32c_reference, read_records
from recast.logs.importers.waymo_wire import (
    Choice,
    FieldError,
    Kind,
    Schema,
    decode,
    many,
    one,
)
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
    assert crc32c_reference(data) == crc
    assert crc32c(data) == crc


@pytest.mark.parametrize("length", [8 * LANES - 1, 8 * LANES, 8 * LANES + 1, 100_003])
def test_the_fast_checksum_is_the_slow_one(length: int) -> None:
    data = np.random.default_rng(length).bytes(length)
    assert crc32c(data) == crc32c(memoryview(data)) == crc32c_reference(data)


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


def _flip(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: _flip(d, 0), "record 0, length: this is no (uncompressed) TFRecord"),
        (lambda d: b"\x89PNG and other things that are longer", "record 0, length: this is no"),
        (lambda d: _flip(d, 14), "record 0, data: do not fit their checksum"),
        (lambda d: _flip(d, 12 + 100), "record 0, data: do not fit their checksum"),
        (lambda d: _flip(d, 116), "record 1, length: does not fit its checksum"),
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


INNER = Schema("Inner", {1: one("x", Kind.DOUBLE)})
OUTER = Schema(
    "Outer",
    {
        1: one("count", Kind.INT),
        2: many("numbers", Kind.DOUBLE),
        3: many("ids", Kind.INT),
        4: one("name", Kind.STRING),
        5: many("inner", INNER),
        6: one("colour", Choice("Colour", {1: "RED", 2: "BLUE"})),
        7: one("raw", Kind.SPAN),
        8: one("small", Kind.FLOAT),
    },
)


@given(
    count=st.integers(-(2**63), 2**63 - 1),
    numbers=st.lists(st.floats(allow_nan=False), max_size=4),
    ids=st.lists(st.integers(0, 2**40), max_size=4),
    packed=st.booleans(),
)
def test_messages_are_read_packed_or_not(
    count: int, numbers: list[float], ids: list[int], packed: bool
) -> None:
    data = write.integer(1, count) + write.blob(99, "unknown") + write.single(98, 1.0)
    if packed:
        data += write.packed_doubles(2, numbers) + write.packed_integers(3, ids)
    else:
        data += write.doubles(2, numbers) + b"".join(write.integer(3, i) for i in ids)
    message = decode(OUTER, data)
    assert message["count"] == count
    assert message["numbers"].tolist() == numbers
    assert message["ids"] == ids
    assert message.get("name") is None


def test_parts_of_a_message() -> None:
    raw = b"\x00\x01 picture"
    data = write.blob(4, "Straße") + write.blob(5, write.double(1, 2.5)) + write.blob(5, b"")
    data += write.integer(6, 2) + write.single(8, 0.5) + write.blob(7, raw)
    message = decode(OUTER, data)
    assert message["name"] == "Straße" and message["colour"] == "BLUE" and message["small"] == 0.5
    assert message["inner"][0]["x"] == 2.5
    assert data[message["raw"]] == raw
    with pytest.raises(FieldError, match=r"^inner\[1\].x: is missing"):
        message["inner"][1]["x"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (write.integer(6, 7), r"^colour: is 7, no Colour \(1 RED, 2 BLUE\)"),
        (write.blob(4, b"\xff\xfe"), "^name: is no text"),
        (write.integer(4, 1), "^name: has wire type 0, not 2"),
        (write.blob(4, "name")[:-1], "^Outer: field 4 is cut off"),
        (write.blob(5, write.double(1, 2.0)[:-1]), r"^inner\[0\]: field 1 is cut off"),
        (write.blob(2, b"1234567"), "^numbers: is cut off"),
        (b"\x0b\x0c", "^Outer: is no protocol buffer: field 1 has wire type 3"),
        (b"\x08" + b"\xff" * 11, "^Outer: is no protocol buffer: a number is cut off"),
        (b"\x08", "^Outer: is no protocol buffer: a number is cut off"),
    ],
)
def test_bytes_that_are_no_such_message_are_told(data: bytes, message: str) -> None:
    with pytest.raises(FieldError, match=message):
        decode(OUTER, data)
