"""Log folders from elsewhere run no code, take no more memory than they hold, are read whole."""

from __future__ import annotations

import json
import lzma
import os
import pickle
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cbor2
import numcodecs
import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog, read_log, write_log
from support.small_log import small_log

MAIN, CAMERA, LIDAR = (f"log.ncore4{part}.zarr.itar" for part in ("", "-front", "-top"))
Meta = dict[str, Any]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_log(small_log(np.random.default_rng(7)), tmp_path / "log")
    return tmp_path / "log"


def _members(path: Path) -> dict[str, bytes]:
    data = path.read_bytes()
    _, _, offset, size = struct.unpack("<4sIQI", data[-512:][:20])
    table = cbor2.loads(lzma.decompress(data[offset : offset + size]))
    places = zip(table["items"], table["offset_datas"], table["sizes"], strict=True)
    return {name: data[begin : begin + length] for name, begin, length in places}


def _store(path: Path, members: dict[str, bytes], table: Meta | None = None) -> None:
    """A store file of these members, with an index of its own if one is given."""
    data, offsets = b"", []
    for member in members.values():
        offsets.append(len(data))
        data += member
    sizes = [len(member) for member in members.values()]
    table = {"items": [*members], "offset_datas": offsets, "sizes": sizes} | (table or {})
    index = lzma.compress(cbor2.dumps(table))
    header = struct.pack("<4sIQI", b"itar", 1, len(data), len(index))
    path.write_bytes(data + index + header.ljust(512, b"\0"))


def _edited(path: Path, change: Callable[[Meta], object]) -> None:
    """Change the metadata of a store, as its author could."""
    members = _members(path)
    document = cbor2.loads(lzma.decompress(members[".zmetadata.cbor.xz"]))
    change(document["metadata"])
    _store(path, {**members, ".zmetadata.cbor.xz": lzma.compress(cbor2.dumps(document))})


def _read_all(folder: Path) -> DrivingLog:
    log = read_log(folder)
    for camera in log.cameras.values():
        for index in range(len(camera.images)):
            camera.images[index]
    for lidar in log.lidars.values():
        for index in range(len(lidar.sweeps)):
            lidar.sweeps[index]
    return log


def _refused(folder: Path, message: str) -> None:
    with pytest.raises(InputError) as error:
        _read_all(folder)
    whole = f"{error.value.where}: {error.value.field}: {error.value.problem}"  # not shortened
    assert message in whole
    assert len(str(error.value)) <= 300 and "\n" not in str(error.value)


def _array(meta: Meta, part: str) -> str:
    return next(key for key in meta if key.endswith(f"{part}/.zarray"))


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], object], tuple[str]]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("allowed", [False, True])
def test_stores_cannot_name_pickle_as_their_codec(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, allowed: bool
) -> None:
    """numcodecs knows "pickle", and zarr runs what an array's bytes say where that is allowed, as
    it always was before numcodecs had this switch."""
    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", allowed, raising=False)
    members = _members(folder / LIDAR)
    document = cbor2.loads(lzma.decompress(members[".zmetadata.cbor.xz"]))
    key = _array(document["metadata"], "intensity")
    document["metadata"][key]["compressor"] = {"id": "pickle", "protocol": 5}
    members[key.replace(".zarray", "0.0")] = pickle.dumps(Payload(tmp_path / "ran"))
    members[".zmetadata.cbor.xz"] = lzma.compress(cbor2.dumps(document))
    _store(folder / LIDAR, members)
    _refused(folder, "is encoded as {'id': 'pickle'")
    assert not (tmp_path / "ran").exists()


def _shape(meta: Meta) -> None:
    array = meta[_array(meta, "direction")]
    array["shape"] = array["chunks"] = [10**9, 3]


def _many_chunks(meta: Meta) -> None:
    meta[_array(meta, "direction")]["shape"] = [10**9, 3]


def _infinite_shape(meta: Meta) -> None:
    array = meta[_array(meta, "direction")]
    array["shape"] = array["chunks"] = [float("inf"), 3]


def _set(part: str, field: str, value: object) -> Callable[[Meta], object]:
    return lambda meta: meta[_array(meta, part)].update({field: value})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_shape, "does not match its"),
        (_many_chunks, "is not stored in one piece"),
        (_infinite_shape, "has shape"),
        (_set("intensity", "dtype", "|O"), "has type '|O'"),
        (_set("intensity", "dtype", [["a", "<f4"]]), "has type"),
        (_set("intensity", "dtype", "|S999999999999"), "has type"),
        (_set("intensity", "dtype", "|S4000000000"), "NCore store: cannot be read"),
        (_set("intensity", "filters", [{"id": "pickle"}]), "is encoded as"),
        (_set("intensity", "compressor", {"id": "zlib", "level": 1}), "is encoded as"),
        (_set("intensity", "compressor", None), "does not match its"),
        (_set("intensity", "chunks", [1, 1]), "is not stored in one piece"),
        (lambda meta: meta.pop(".zgroup"), "cannot be read"),
        (lambda meta: meta.update({"a/.zarray": 3}), "is not an object of objects"),
        (lambda meta: meta.update({"a/.zarray": {}}), "cannot be read ('dtype')"),
    ],
)
def test_metadata_that_would_take_memory_or_run_code(
    folder: Path, change: Callable[[Meta], object], message: str
) -> None:
    _edited(folder / LIDAR, change)
    _refused(folder, message)


def test_what_an_index_may_not_say(folder: Path) -> None:
    path, members = folder / LIDAR, _members(folder / LIDAR)
    name = [*members][-1]
    for table, message in (
        ({"sizes": [1 << 50] * len(members)}, "leads beyond its end"),
        ({"sizes": [-1] * len(members)}, "is inconsistent"),
        ({"sizes": []}, "is inconsistent"),
        ({"items": [name] * len(members)}, "is inconsistent"),
        ({"items": 3}, "cannot be read"),
    ):
        _store(path, members, table)
        _refused(folder, message)
    missing = {key: data for key, data in members.items() if not key.endswith("intensity/0.0")}
    _store(path, missing)
    _refused(folder, "does not match its 0 stored ones")  # zarr would fill in zeros


def test_what_unpacks_to_gigabytes_is_refused(folder: Path) -> None:
    packer = lzma.LZMACompressor(preset=0)
    zeros = bytes(1 << 20)
    packed = b"".join(packer.compress(zeros) for _ in range(300)) + packer.flush()
    assert len(packed) < 100_000
    members = _members(folder / LIDAR)
    _store(folder / LIDAR, {**members, ".zmetadata.cbor.xz": packed})
    _refused(folder, "unpacks to more than 268435456 bytes")


@pytest.mark.parametrize(
    ("stores", "message"),
    [
        (3, "component_stores: cannot be read"),
        ([], "lists no files"),
        ([{"path": [MAIN]}], "lists no files"),
        ([{"path": MAIN}, {"path": MAIN}], "lists a store twice"),
        ([{"path": MAIN}, {"path": f"./{MAIN}"}], "NCore stores: cannot be read"),
        ([{"path": "../other.zarr.itar"}], "not a file inside of log/"),
        ([{"path": "/etc/passwd"}], "not a file inside of log/"),
        ([{"path": "a\0b"}], "not a file inside of log/"),
        ([{"path": "log.json"}], "is too short"),
        ([{"path": "none.zarr.itar"}], "file: is missing"),
        ([{"path": "."}], "not a file inside of log/"),
    ],
)
def test_a_listing_names_files_of_its_own_folder_once(
    folder: Path, stores: object, message: str
) -> None:
    listing = json.loads((folder / "ncore.json").read_text())
    (folder / "ncore.json").write_text(json.dumps({**listing, "component_stores": stores}))
    _refused(folder, message)


def _image(folder: Path, data: bytes, **attributes: object) -> None:
    path = folder / CAMERA
    members = _members(path)
    document = cbor2.loads(lzma.decompress(members[".zmetadata.cbor.xz"]))
    meta = document["metadata"]
    key = _array(meta, "image")
    meta[key]["dtype"] = f"|S{len(data)}"
    meta[key.replace(".zarray", ".zattrs")] |= attributes
    members[key.replace(".zarray", "0")] = data
    members[".zmetadata.cbor.xz"] = lzma.compress(cbor2.dumps(document))
    _store(path, members)
    (folder / "ncore.json").touch()  # which tells that the folder is another


def _png(width: int, height: int) -> bytes:
    """A small file that says it is large; Pillow refuses, or warns of, some of them by itself."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + checksum

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = (chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(bytes(20))), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.filterwarnings("error")
def test_damaged_images_are_one_line(folder: Path) -> None:
    whole = _members(folder / CAMERA)
    key = next(name for name in whole if name.endswith("image/0"))
    for data, message in (
        (whole[key][:-30], "image: cannot be decoded"),
        (b"no image", "image: cannot be decoded"),
        (_png(30_000, 30_000), "is 30000x30000, more than 134 megapixels"),
        (_png(9_500, 9_500), "is 9500x9500, but log.json says 7x5"),
        (_png(7, 5), "image: cannot be decoded"),
    ):
        _image(folder, data)
        _refused(folder, message)
    _image(folder, whole[key], format="eps")  # for which Pillow calls Ghostscript
    _refused(folder, "is 'eps', not png or jpeg")
    _image(folder, whole[key], format=["png"])
    _refused(folder, "not png or jpeg")


def test_a_damaged_mask_is_one_line(folder: Path) -> None:
    def shorten(meta: Meta) -> None:
        meta[_array(meta, "unusable")]["dtype"] = "|S40"

    members = _members(folder / MAIN)
    key = next(name for name in members if name.endswith("unusable/0"))
    _store(folder / MAIN, {**members, key: members[key][:40]})
    _edited(folder / MAIN, shorten)
    _refused(folder, "mask: cannot be decoded")


BOX = {"track_id": "1", "class_id": "car", "timestamp_us": 1_700_000_000_100_000}


@pytest.mark.parametrize(
    ("boxes", "message"),
    [
        ([{}], "tracks: cannot be read ('track_id')"),
        ([{**BOX, "track_id": ["a"]}], "tracks: cannot be read"),
        ([{**BOX, "bbox3": {"centroid": [0, 0, 0], "dim": [1, 1], "rot": [0, 0, 0]}}], "size"),
        (
            [
                {
                    **BOX,
                    "bbox3": {"centroid": [0, 0, 0], "dim": [1, 1, float("inf")], "rot": [0] * 3},
                }
            ],
            "size: expected three sides",
        ),
        (
            [{**BOX, "bbox3": {"centroid": [0, 1e300, 0], "dim": [1] * 3, "rot": [0] * 3}}],
            "1e+300 is not within",
        ),
        (
            [{**BOX, "bbox3": {"centroid": [0] * 3, "dim": [1] * 3, "rot": [float("nan")] * 3}}],
            "nan is not within",
        ),
        (
            [
                {
                    **BOX,
                    "timestamp_us": 10**30,
                    "bbox3": {"centroid": [0] * 3, "dim": [1] * 3, "rot": [0] * 3},
                }
            ],
            "tracks: cannot be read",
        ),
    ],
)
def test_damaged_tracks_are_one_line(folder: Path, boxes: list, message: str) -> None:
    def change(meta: Meta) -> None:
        meta["cuboids/default/cuboids/.zattrs"]["cuboid_track_observations"] = boxes

    _edited(folder / MAIN, change)
    _refused(folder, message)


def _poses(value: object) -> Callable[[Meta], object]:
    def change(meta: Meta) -> None:
        poses = meta["poses/default/dynamic_poses/.zattrs"]
        poses["('rig', 'world')"]["poses"] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_poses([]), "world_from_rig.poses: expected (6, 4, 4)"),
        (_poses("none"), "ego trajectory: cannot be read"),
        (_poses([np.diag([1, 1, -1, 1.0]).tolist()] * 6), "mirror image"),
        (lambda meta: meta["poses/default/dynamic_poses/.zattrs"].clear(), "ego trajectory"),
        (lambda meta: meta["poses/default/static_poses/.zattrs"].clear(), "camera 'front'"),
    ],
)
def test_damaged_poses_are_one_line(
    folder: Path, change: Callable[[Meta], object], message: str
) -> None:
    _edited(folder / MAIN, change)
    _refused(folder, message)


def test_a_log_that_was_not_touched_is_read(folder: Path) -> None:
    for name in (MAIN, CAMERA, LIDAR):
        _edited(folder / name, lambda meta: None)
    assert list(_read_all(folder).tracks) == ["car 7"]
