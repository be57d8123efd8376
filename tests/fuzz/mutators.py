"""Damage to files: bytes of any kind, and the values inside of each format that we read.

A mutator takes the bytes of a good file and a generator, and returns damaged ones. Half of the
inputs are damaged inside of their structure, with lengths and checksums put right again, or a
reader's first check would see nearly all of them.
"""

from __future__ import annotations

import gzip
import io
import json
import pickle
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import torch

Rng = np.random.Generator
Mutator = Callable[[bytes, Rng], bytes]

WORDS = (
    b"nan",
    b"inf",
    b"-inf",
    b"NaT",
    b"1e400",
    b"-1",
    b"0",
    b"-0",
    b"1e308",
    b"-1e30",
    b"",
    b"x",
    b"9" * 400,
    b"9" * 5000,
    b"4294967296",
    b"18446744073709551616",
    b"0.5",
    b"\xc2\xb2",
    b"\xff\xfe",
    b"../../x",
    b"/etc/passwd",
    b"\0",
    b"None",
    b"true",
    b"\xe2\x80\xae",
    b"A" * 300,
    b"\n",
    b"1e-320",
)
"""In the place of a word or a number of a text."""

VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1,
    2**31,
    2**63,
    -(2**64),
    10**30,
    0.5,
    -0.0,
    1e308,
    -1e30,
    1e-320,
    float("nan"),
    float("inf"),
    float("-inf"),
    "",
    "x",
    "../../x",
    "/etc/passwd",
    "a\0b",
    "\u202e",
    "A" * 300,
    "nan",
    "<script>",
    "\ud800",
    [],
    {},
    [[]],
    [None],
    {"": None},
    [0] * 50,
    {"x": {"x": {}}},
)
"""In the place of a value of a tree."""

FLOATS = (np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-30, 0.0, -1.0, 3e38)
INTEGERS = (0, 1, -1, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1)


def choose(rng: Rng, options: Any) -> Any:
    """One of a sequence, of values of any type."""
    return options[int(rng.integers(len(options)))]


def mutate_bytes(data: bytes, rng: Rng) -> bytes:
    """Flips, overwritten numbers, cuts, repetitions and moves, up to four of them."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not out:
            return bytes(rng.bytes(int(rng.integers(0, 64))))
        at, size = int(rng.integers(len(out))), int(2 ** rng.integers(0, 8))
        match int(rng.integers(9)):
            case 0:
                out[at] ^= 1 << int(rng.integers(8))
            case 1:
                out[at : at + size] = rng.bytes(size)
            case 2:
                del out[at:]
            case 3:
                del out[at : at + size]
            case 4:
                out[at:at] = rng.bytes(size)
            case 5:
                out[at:at] = out[at : at + size]
            case 6:
                out[at : at + size] = bytes(len(out[at : at + size]))
            case 7:
                width, order = choose(rng, (1, 2, 4, 8)), choose(rng, ("little", "big"))
                value = choose(rng, INTEGERS) % 256**width
                out[at : at + width] = value.to_bytes(width, order)
            case 8:
                other = int(rng.integers(len(out)))
                out[at : at + size] = out[other : other + size]
    return bytes(out)


def mutate_text(data: bytes, rng: Rng) -> bytes:
    """Words and lines: replaced, dropped, repeated, exchanged."""
    for _ in range(int(rng.integers(1, 4))):
        words = list(re.finditer(rb"[^\s,;:<>=\"'\[\]{}]+", data))
        lines = data.split(b"\n")
        at = int(rng.integers(len(lines)))
        match int(rng.integers(5)):
            case 0 | 1 if words:
                word = choose(rng, words)
                data = data[: word.start()] + choose(rng, WORDS) + data[word.end() :]
            case 2:
                data = b"\n".join(lines[:at] + lines[at + 1 :])
            case 3:
                data = b"\n".join(lines[:at] + [lines[at]] * 2 + lines[at + 1 :])
            case _:
                other = int(rng.integers(len(lines)))
                lines[at], lines[other] = lines[other], lines[at]
                data = b"\n".join(lines)
    return data


def mutate_tree(value: Any, rng: Rng) -> Any:
    """A JSON-able tree with one of its members changed, dropped, added or nested."""
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        pairs = node.items() if isinstance(node, dict) else enumerate(node)
        for key, inner in list(pairs):
            places.append((node, key))
            if isinstance(inner, dict | list) and len(places) < 20_000:
                walk(inner)

    if isinstance(value, dict | list):
        walk(value)
    if not places:
        return choose(rng, VALUES)
    node, key = choose(rng, places)
    match int(rng.integers(8)):
        case 0:
            del node[key]
        case 1:
            node[key] = [node[key]]
        case 2:
            node[key] = str(node[key])
        case 3:
            other, place = choose(rng, places)
            node[key] = json.loads(json.dumps(other[place])) if _has(other, place) else None
        case 4 if isinstance(node, dict):
            node[str(choose(rng, VALUES))] = node.pop(key)
        case 5 if isinstance(node[key], int | float) and not isinstance(node[key], bool):
            node[key] = node[key] * choose(rng, (-1, 0, 2, 1e6, 10**12)) + choose(rng, (0, 1, 0.5))
        case _:
            node[key] = choose(rng, VALUES)
    return value


def _has(node: Any, key: Any) -> bool:
    return key in node if isinstance(node, dict) else key < len(node)


def mutate_json(data: bytes, rng: Rng) -> bytes:
    """Values of a JSON file; now and then nesting, numbers or keys that only text can have."""
    match int(rng.integers(12)):
        case 0:
            depth = choose(rng, (100, 1_000, 100_000))
            return choose(rng, (b"[", b'{"a":')) * depth
        case 1:
            return mutate_text(data, rng)
    tree = json.loads(data)
    for _ in range(int(rng.integers(1, 3))):
        tree = mutate_tree(tree, rng)
    return json.dumps(tree).encode()


def mutate_yaml(data: bytes, rng: Rng) -> bytes:
    """Words of a YAML file; aliases that grow without end, tags, deep nesting."""
    match int(rng.integers(8)):
        case 0:
            rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
            count = int(rng.integers(2, 40))
            rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, count)]
            return ("\n".join(rows) + "\n").encode() + data
        case 1:
            depth = choose(rng, (50, 500, 5_000))
            return data + b"\ndeep: " + choose(rng, (b"[", b"{a: ")) * depth
        case 2:
            count = int(rng.integers(2, 3000))
            rows = ["c0: &c0 1", *(f"c{i}: &c{i} [*c{i - 1}]" for i in range(1, count))]
            return data + ("\n" + "\n".join(rows)).encode()
        case 3:
            tag = choose(rng, (b"!!python/object/apply:os.system [x]", b"!x y", b"!!set {a}"))
            return data + b"\ntag: " + tag
    return mutate_text(data, rng)


def mutate_array(data: bytes, rng: Rng, dtype: Any) -> bytes:
    """Numbers of a raw array."""
    out = np.frombuffer(
        data[: len(data) // np.dtype(dtype).itemsize * np.dtype(dtype).itemsize], dtype
    )
    out = out.copy()
    if out.size == 0:
        return data
    kind = FLOATS if out.dtype.kind == "f" else INTEGERS
    where = rng.integers(out.size, size=int(rng.integers(1, 5)))
    with np.errstate(all="ignore"):
        values = [np.array(choose(rng, kind)).astype(out.dtype) for _ in where]
    out[where] = values
    return out.tobytes() + data[out.nbytes :]


def mutate_npy(data: bytes, rng: Rng) -> bytes:
    """Header or numbers of a .npy file."""
    size = struct.unpack("<H", data[8:10])[0]
    header, body = data[10 : 10 + size], data[10 + size :]
    if rng.random() < 0.5:
        text = mutate_text(header, rng).rstrip() + b"\n"
        return data[:8] + struct.pack("<H", len(text) % 65536) + text + body
    found = re.search(rb"'descr': '([^']+)'", header)
    return data[: 10 + size] + mutate_array(body, rng, found[1].decode() if found else "u1")


def mutate_safetensors(data: bytes, rng: Rng) -> bytes:
    """Header or numbers of a safetensors file."""
    size = int.from_bytes(data[:8], "little")
    header, body = data[8 : 8 + size], data[8 + size :]
    if rng.random() < 0.4:
        return data[: 8 + size] + mutate_array(body, rng, choose(rng, ("<f4", "<f2", "<i4", "<i8")))
    tree = json.loads(header)
    meta = tree.get("__metadata__")
    if meta and rng.random() < 0.6:
        key = choose(rng, sorted(meta))
        try:
            meta[key] = mutate_json(meta[key].encode(), rng).decode(errors="replace")
        except ValueError:
            meta[key] = choose(rng, WORDS).decode(errors="replace")
    else:
        tree = mutate_tree(tree, rng)
    text = json.dumps(tree).encode()
    return len(text).to_bytes(8, "little") + text + body


def mutate_ply(data: bytes, rng: Rng) -> bytes:
    """Header or numbers of a PLY file."""
    end = data.find(b"end_header\n") + len(b"end_header\n")
    if rng.random() < 0.5:
        return mutate_text(data[:end], rng) + data[end:]
    return data[:end] + mutate_array(data[end:], rng, "<f4")


def mutate_table(data: bytes, rng: Rng) -> bytes:
    """Columns and values of a feather or parquet file, written anew."""
    parquet = data[:4] == b"PAR1"
    source = pa.BufferReader(data)
    table = pa.parquet.read_table(source) if parquet else pa.feather.read_table(source)
    at = int(rng.integers(max(table.num_columns, 1)))
    name, column = table.column_names[at], table.column(at)
    match int(rng.integers(7)):
        case 0:
            table = table.drop_columns([name])
        case 1:
            table = table.set_column(at, choose(rng, ("x", "", name.upper())), column)
        case 2:
            table = table.slice(0, int(rng.integers(table.num_rows + 1)))
        case 3:
            table = pa.concat_tables([table, table])
        case 4:
            kind = choose(
                rng, (pa.string(), pa.int8(), pa.float16(), pa.list_(pa.int32()), pa.null())
            )
            empty = pa.nulls(table.num_rows, kind)
            table = table.set_column(at, name, empty)
        case _:
            values = column.to_pylist()
            if values:
                values[int(rng.integers(len(values)))] = choose(
                    rng, (*FLOATS, *INTEGERS, None, "x")
                )
            try:
                table = table.set_column(at, name, pa.array(values, column.type))
            except (pa.ArrowException, TypeError, ValueError, OverflowError):
                table = table.append_column("more", column)
    out = io.BytesIO()
    (pa.parquet.write_table if parquet else pa.feather.write_feather)(table, out)
    return out.getvalue()


def mutate_png(data: bytes, rng: Rng) -> bytes:
    """Width, height or type of a PNG, its checksum put right."""
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        return mutate_bytes(data, rng)
    head = bytearray(data[16:29])
    at = choose(rng, (0, 4))
    if rng.random() < 0.7:
        head[at : at + 4] = struct.pack(
            ">I", choose(rng, (0, 1, 9, 1000, 60_000, 2**31 - 1, 2**32 - 1))
        )
    else:
        head[int(rng.integers(8, 13))] = int(rng.integers(256))
    body = b"IHDR" + bytes(head)
    return data[:12] + body + struct.pack(">I", zlib.crc32(body)) + data[33:]


def mutate_glb(data: bytes, rng: Rng) -> bytes:
    """Values of a GLB's JSON or numbers of its binary chunk, lengths put right."""
    size = int.from_bytes(data[12:16], "little")
    tree, binary = data[20 : 20 + size], data[28 + size :]
    if rng.random() < 0.7:
        tree = mutate_json(tree, rng)
    else:
        binary = mutate_array(binary, rng, choose(rng, ("<f4", "<u2", "<u1")))
    body = struct.pack("<I4s", len(tree), b"JSON") + tree
    body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return data[:8] + (12 + len(body)).to_bytes(4, "little") + body


def mutate_tfrecord(data: bytes, rng: Rng) -> bytes:
    """Messages of a TFRecord, sealed again."""
    from recast.logs.importers.waymo_tfrecord import masked_crc

    records, at = [], 0
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 8], "little")
        records.append(data[at + 12 : at + 12 + size])
        at += 16 + size
    which = int(rng.integers(len(records)))
    records[which] = mutate_bytes(records[which], rng)
    out = b""
    for record in records:
        length = len(record).to_bytes(8, "little")
        out += length + struct.pack("<I", masked_crc(length))
        out += record + struct.pack("<I", masked_crc(record))
    return out


def _lists(node: Any) -> Any:
    """The tree with lists for tuples, whose members can be changed."""
    if isinstance(node, dict):
        return {key: _lists(inner) for key, inner in node.items()}
    return [_lists(inner) for inner in node] if isinstance(node, list | tuple) else node


def mutate_checkpoint(data: bytes, rng: Rng) -> bytes:
    """Tensors and names of a file of torch.save."""
    tree = _lists(torch.load(io.BytesIO(data), map_location="cpu", weights_only=True))
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key, inner in list(node.items() if isinstance(node, dict) else enumerate(node)):
            places.append((node, key))
            if isinstance(inner, dict | list):
                walk(inner)

    walk(tree)
    node, key = choose(rng, places)
    value = node[key]
    match int(rng.integers(8)):
        case 0:
            del node[key]
        case 1:
            node[key] = choose(rng, VALUES)
        case 2 if isinstance(node, dict):
            node[f"{key}x"] = node.pop(key)
        case 3:
            node[key] = torch.zeros(1).expand(choose(rng, ((10**8, 40, 3), (10**12,), (7, 3))))
        case 4 if isinstance(value, torch.Tensor):
            node[key] = value.to(choose(rng, (torch.float16, torch.int64, torch.bool)))
        case 5 if isinstance(value, torch.Tensor):
            node[key] = choose(rng, (value.flatten(), value[:0], value[..., :1], value[None]))
        case _ if isinstance(value, torch.Tensor) and value.is_floating_point() and value.numel():
            changed = value.detach().clone()
            changed.view(-1)[int(rng.integers(value.numel()))] = choose(rng, FLOATS)
            node[key] = changed
        case _:
            node[key] = {"x": value}
    out = io.BytesIO()
    torch.save(tree, out)
    return out.getvalue()


def mutate_pickle(data: bytes, rng: Rng) -> bytes:
    """Values and names of a pickle that a sample's writer made, in any protocol."""
    tree = _lists(pickle.loads(data))
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key, inner in list(node.items() if isinstance(node, dict) else enumerate(node)):
            places.append((node, key))
            if isinstance(inner, dict | list):
                walk(inner)

    walk(tree)
    node, key = choose(rng, places)
    match int(rng.integers(5)):
        case 0:
            del node[key]
        case 1 if isinstance(node, dict):
            node[f"{key}x"] = node.pop(key)
        case 2 if isinstance(node[key], np.ndarray) and node[key].dtype.kind == "f":
            array = node[key].copy()
            array.flat[int(rng.integers(array.size))] = choose(rng, FLOATS)
            node[key] = array
        case 3 if isinstance(node[key], np.ndarray):
            array = node[key]
            node[key] = choose(rng, (array.astype(str), array[:0], array[None], list(array)))
        case _:
            node[key] = choose(rng, VALUES)
    return pickle.dumps(tree, int(rng.integers(6)))


def mutate_jpeg(data: bytes, rng: Rng) -> bytes:
    """One segment before the pixels of a JPEG, such as sizes, tables and EXIF."""
    at, segments = 2, []
    while data[at + 1] != 0xDA:  # start of scan
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        segments.append(data[at:end])
        at = end
    which = int(rng.integers(len(segments)))
    body = mutate_bytes(segments[which][4:], rng)[:65_000]
    segments[which] = segments[which][:2] + (len(body) + 2).to_bytes(2, "big") + body
    return data[:2] + b"".join(segments) + data[at:]


def mutate_tiff(data: bytes, rng: Rng) -> bytes:
    """Type, count or value of one entry in the first directory of a TIFF."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, at)
    kind, place = choose(rng, (("H", 2), ("I", 4), ("H", 8), ("I", 8)))
    out, value = bytearray(data), choose(rng, (*INTEGERS, *range(2, 10)))
    entry = at + 2 + 12 * int(rng.integers(count))
    struct.pack_into(order + kind, out, entry + place, value % 256 ** struct.calcsize(kind))
    return bytes(out)


def mutate_spz(data: bytes, rng: Rng) -> bytes:
    """Bytes inside of the streams of an SPZ, packed again: one of gzip, or several of zstd."""
    if data[:2] == b"\x1f\x8b":
        return gzip.compress(mutate_bytes(gzip.decompress(data), rng))
    (at,) = struct.unpack_from("<I", data, 16)
    table = [list(entry) for entry in struct.iter_unpack("<2Q", data[at : at + 16 * data[15]])]
    end = at + 16 * len(table)
    streams = []
    for length, _ in table:
        streams.append(data[end : end + length])
        end += length
    which = int(rng.integers(len(table)))
    plain = pa.decompress(streams[which], table[which][1], "zstd", asbytes=True)
    plain = mutate_array(plain, rng, "u1") if rng.random() < 0.7 else mutate_bytes(plain, rng)
    streams[which] = pa.compress(plain, "zstd", asbytes=True)
    size = table[which][1] if rng.random() < 0.5 else len(plain)
    table[which] = [len(streams[which]), size]
    return data[:at] + b"".join(struct.pack("<2Q", *entry) for entry in table) + b"".join(streams)


def mutate_zip(data: bytes, rng: Rng) -> bytes:
    """One member of an archive, damaged as a file of its name; checksums are put right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = choose(rng, sorted(members))
    members[name] = mutate(name, members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return out.getvalue()


def mutate_message(data: bytes, rng: Rng) -> bytes:
    """A field of a message AggregatedRenderRequest, or of one in it: changed, dropped, repeated."""
    from recast_bridges.alpasim.messages import parse

    whole = parse("AggregatedRenderRequest", data)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for field in node.DESCRIPTOR.fields:
            places.append((node, field))
            if field.message_type is not None:
                value = getattr(node, field.name)
                for inner in value if hasattr(value, "add") else [value]:
                    if hasattr(value, "add") or node.HasField(field.name):
                        walk(inner)

    walk(whole)
    node, field = choose(rng, places)
    value = getattr(node, field.name)
    if rng.random() < 0.2:
        node.ClearField(field.name)
    elif hasattr(value, "extend") and len(value) and rng.random() < 0.5:
        value.append(choose(rng, value))
    elif field.message_type is not None:
        (value.add() if hasattr(value, "add") else value).SetInParent()
    else:
        bits = {field.CPPTYPE_UINT64: 64, field.CPPTYPE_UINT32: 32, field.CPPTYPE_BOOL: 1}
        number: Any = choose(rng, INTEGERS) % 2 ** bits.get(field.cpp_type, 31)
        if field.cpp_type in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT):
            number = choose(rng, FLOATS)
        elif field.cpp_type == field.CPPTYPE_STRING:
            word = choose(rng, WORDS)
            number = word if field.type == field.TYPE_BYTES else word.decode(errors="replace")
        if hasattr(value, "extend"):
            value[:] = [*value[:-1], number]
        else:
            setattr(node, field.name, number)
    return bytes(whole.SerializeToString())


BY_SUFFIX: dict[str, Mutator] = {
    ".json": mutate_json,
    ".yaml": mutate_yaml,
    ".txt": mutate_text,
    ".csv": mutate_text,
    ".xml": mutate_text,
    ".xosc": mutate_text,
    ".xodr": mutate_text,
    ".usda": mutate_text,
    ".npy": mutate_npy,
    ".safetensors": mutate_safetensors,
    ".ply": mutate_ply,
    ".feather": mutate_table,
    ".parquet": mutate_table,
    ".png": mutate_png,
    ".jpg": mutate_jpeg,
    ".tif": mutate_tiff,
    ".spz": mutate_spz,
    ".npz": mutate_zip,
    ".pb": mutate_message,
    ".pth": mutate_checkpoint,
    ".ckpt": mutate_checkpoint,
    ".pkl": mutate_pickle,
    ".tfrecord": mutate_tfrecord,
    ".jsonl": mutate_text,
    ".obj": mutate_text,
    ".mtl": mutate_text,
    ".glb": mutate_glb,
    ".bin": lambda data, rng: mutate_array(data, rng, "<f4"),
}


def mutate(name: str, data: bytes, rng: Rng) -> bytes:
    """Damage to a file of that name: inside of its structure or not, half of the time each."""
    inside = BY_SUFFIX.get("." + name.rpartition(".")[2].lower())
    if inside is not None and rng.random() < 0.5:
        try:
            return inside(data, rng)
        except (
            ValueError,
            KeyError,
            IndexError,
            TypeError,
            RuntimeError,
            struct.error,
            pa.ArrowException,
            zipfile.BadZipFile,
        ):
            pass  # a file that is not of the kind its name says
    return mutate_bytes(data, rng)
