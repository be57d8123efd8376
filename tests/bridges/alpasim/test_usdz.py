"""The layout of USDZ packages to the byte, and archives that are refused."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast_bridges.alpasim.bundle import read_usdz, write_usdz

LIMITS = {"a.txt": 100, "b": 100}
SEVENTY = bytes(range(70))


def test_the_package_to_the_byte(tmp_path: Path) -> None:
    """Headers written out by hand after the ZIP format's description (APPNOTE)."""
    write_usdz(tmp_path / "x.usdz", {"a.txt": SEVENTY, "b": b""})
    both = ((b"a.txt", SEVENTY, 0, 64), (b"b", b"", 134, 192))
    expected, directory = b"", b""
    for name, data, at, begins in both:
        gap = begins - at - 30 - len(name) - 4
        extra = struct.pack("<HH", 0x1986, gap) + b"\0" * gap
        # 1980-01-01 00:00:00 in MS-DOS's words
        common = struct.pack("<HHHHH", 20, 0, 0, 0, 1 << 5 | 1)
        common += struct.pack("<IIIHH", zlib.crc32(data), len(data), len(data), len(name), 0)
        local = common[:-2] + struct.pack("<H", len(extra))
        expected += b"PK\3\4" + local + name + extra
        assert len(expected) == begins
        expected += data
        made_by = struct.pack("<BB", 20, 3)
        rest = struct.pack("<HHHII", 0, 0, 0, 0o100644 << 16, at)
        directory += b"PK\1\2" + made_by + local + rest + name + extra
    size, start = len(directory), len(expected)
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 2, 2, size, start, 0)
    assert (tmp_path / "x.usdz").read_bytes() == expected + directory + end
    assert read_usdz(tmp_path / "x.usdz", LIMITS) == {"a.txt": SEVENTY, "b": b""}


def test_only_what_is_asked_for_is_read(tmp_path: Path) -> None:
    write_usdz(tmp_path / "x.usdz", {"other": bytes(1000), "b": b"here"})
    assert read_usdz(tmp_path / "x.usdz", LIMITS) == {"b": b"here"}


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_usdz(path, LIMITS)
    return str(caught.value)


@pytest.mark.parametrize(
    "name", ["../a", "/a", "a/../../b", "..", "C:\\a", "a\\..\\b", "folder/../../", "a\0b"]
)
def test_members_that_lead_elsewhere_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "x.usdz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.txt", b"good")
        info = zipfile.ZipInfo("q" * len(name))
        archive.writestr(info, b"bad")
    data = path.read_bytes().replace(b"q" * len(name), name.encode())
    path.write_bytes(data)
    assert "not a file inside of" in refused(path)


def test_compressed_encrypted_large_and_doubled_members_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.usdz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb", bytes(1 << 20))
    assert "member bomb: is compressed" in refused(path)
    write_usdz(path, {"a.txt": bytes(101)})
    assert "has 101 bytes, more than 100" in refused(path)
    write_usdz(path, {"a.txt": b"x"})
    data = bytearray(path.read_bytes())
    for at in (data.index(b"PK\3\4") + 6, data.index(b"PK\1\2") + 8):
        data[at] |= 1
    path.write_bytes(data)
    assert "member a.txt: is encrypted" in refused(path)
    write_usdz(path, {"a.txt": b"x", "c.txt": b"y"})
    path.write_bytes(path.read_bytes().replace(b"c.txt", b"a.txt"))
    assert "member a.txt: appears twice" in refused(path)


def test_sizes_that_lie_and_damage_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.usdz"
    write_usdz(path, {"a.txt": b"content", "b": b"more"})
    whole = path.read_bytes()
    for cut in (0, 10, 70, len(whole) - 30, len(whole) - 1):
        path.write_bytes(whole[:cut])
        assert "archive: cannot be read" in refused(path)
    path.write_bytes(whole.replace(b"content", b"cOntent"))
    assert "Bad CRC-32" in refused(path)
    end = whole.rindex(b"PK\5\6")
    [start] = struct.unpack("<I", whole[end + 16 : end + 20])
    # The directory seems to lie further on than it does, and so the first member before the file.
    path.write_bytes(whole[: end + 16] + struct.pack("<I", start + 1000) + whole[end + 20 :])
    assert "archive: cannot be read" in refused(path)
    # The end record says that the directory has 16 MiB, and the file is as long.
    lying = whole[:end] + bytes(1 << 24) + whole[end : end + 12]
    path.write_bytes(lying + struct.pack("<I", 1 << 24) + whole[end + 16 :])
    assert "its directory has 16777216 bytes" in refused(path)
    assert "is missing" in refused(tmp_path / "none.usdz")
    assert "is missing" in refused(tmp_path)
