"""The decoder of foreign images: depths, orientation, alpha, claims of memory; and masks."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from recast.core.errors import InputError
from recast.core.images import FORMATS, decode_image, decode_mask, eight_bits, opened, rgb, rgba

RNG = np.random.default_rng(0)
DEEP = RNG.integers(0, 65536, (6, 8, 4)).astype(np.uint16)
COLOUR = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)


def saved(image: Image.Image, kind: str, **options: Any) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def png(
    rows: np.ndarray, depth: int, colours: int, *more: bytes, claim: int | None = None
) -> bytes:
    """A PNG of rows (H, bytes); `claim` is what its pixels' chunk says of its length."""
    width = rows.shape[1] * 8 // (depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colours])
    head = struct.pack(">IIBBBBB", width, len(rows), depth, colours, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows)))
    if claim is not None:
        pixels = struct.pack(">I", claim) + pixels[4:]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        [chunk(b"IHDR", head), *more, pixels, chunk(b"IEND", b"")]
    )


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


@pytest.mark.parametrize("ending", [".png", ".tiff"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_sixteen_bits_are_scaled(ending: str, channels: int) -> None:
    levels = DEEP[..., 0] if channels == 1 else DEEP[..., :channels]
    order = levels if channels == 1 else levels[..., [2, 1, 0, 3][:channels]]
    data = cv2.imencode(ending, order)[1].tobytes()
    np.testing.assert_array_equal(decode_image(data, "a"), levels)
    scaled = np.rint(levels / 257).astype(np.uint8)
    np.testing.assert_array_equal(eight_bits(decode_image(data, "a")), scaled)


def test_sixteen_bits_of_grey_with_alpha_and_with_one_clear_level() -> None:
    pairs = DEEP[..., :2].astype(">u2")
    grey = png(pairs.reshape(6, -1).view(np.uint8), 16, 4)
    np.testing.assert_array_equal(decode_image(grey, "a")[..., [0, 3]], DEEP[..., :2])
    key = chunk(b"tRNS", struct.pack(">H", int(DEEP[2, 3, 0])))
    one = png(np.ascontiguousarray(pairs[..., 0]).view(np.uint8), 16, 0, key)
    clear = decode_image(one, "a")[..., 3] == 0
    np.testing.assert_array_equal(clear, DEEP[..., 0] == DEEP[2, 3, 0])


@pytest.mark.parametrize("depth", [1, 2, 4])
def test_few_bits_with_one_clear_level(depth: int) -> None:
    key = chunk(b"tRNS", struct.pack(">H", 1))
    row = np.array([[0b01000000 if depth == 1 else 1 << (8 - depth)]], np.uint8)
    first = decode_image(png(row, depth, 0, key), "a")[0]
    lit = 1 if depth == 1 else 0
    assert first[lit].tolist() == [255 // (2**depth - 1)] * 3 + [0]
    assert first[1 - lit, 3] == 255


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "WEBP"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_are_turned_once(kind: str, orientation: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    ramp = np.zeros((16, 24, 3), np.uint8)
    ramp[:8, :8] = 255  # one corner is white
    options = {"lossless": True} if kind == "WEBP" else {}
    with opened(saved(Image.fromarray(ramp), kind, exif=exif, **options), "a") as image:
        width, height = image.size
        levels = rgb(image.levels())
    assert (width, height) == ((16, 24) if orientation >= 5 else (24, 16))
    assert levels.shape == (height, width, 3)
    white = levels[..., 0] > 127
    right = orientation in (2, 3, 6, 7)
    low = orientation in (3, 4, 7, 8)
    assert white.sum() == 64
    assert white[-1 if low else 0, -1 if right else 0]


@pytest.mark.parametrize(
    ("mode", "kind", "off"),
    [("CMYK", "TIFF", 0), ("CMYK", "JPEG", 6), ("P", "PNG", 4), ("P", "BMP", 4), ("L", "PNG", 0)],
)
def test_kinds_of_colours(mode: str, kind: str, off: float) -> None:
    flat = Image.new("RGB", (16, 16), (204, 204, 204)).convert(mode)
    assert np.abs(rgb(decode_image(saved(flat, kind), "a")).astype(int) - 204).max() <= off


def test_alpha_is_there_only_if_the_file_has_it() -> None:
    clear = Image.fromarray(np.dstack([COLOUR, COLOUR[..., :1]]))
    for kind in ("PNG", "TIFF"):
        np.testing.assert_array_equal(decode_image(saved(clear, kind), "a"), np.asarray(clear))
    levels = decode_image(saved(Image.fromarray(COLOUR), "PNG"), "a")
    assert levels.shape == (6, 8, 3)
    assert (rgba(levels)[..., 3] == 255).all()
    palette = Image.fromarray(COLOUR).convert("P")
    assert decode_image(saved(palette, "PNG", transparency=0), "a").shape == (6, 8, 4)


def test_the_first_of_many_is_taken() -> None:
    reds = [Image.new("RGB", (8, 8), (red, 0, 0)) for red in (90, 180)]
    for kind in ("GIF", "PNG", "WEBP", "TIFF"):
        data = saved(reds[0], kind, save_all=True, append_images=reds[1:])
        levels = rgb(decode_image(data, "a", (*FORMATS, "GIF")))
        assert abs(int(levels[0, 0, 0]) - 90) <= 2


def tiles(width: int) -> bytes:
    """A TIFF of 8 x 6 pixels in tiles of `width`."""
    data = bytearray(saved(Image.fromarray(COLOUR), "TIFF"))
    at = struct.unpack_from("<I", data, 4)[0]
    count = struct.unpack_from("<H", data, at)[0]
    entries = [bytes(data[at + 2 + 12 * i : at + 14 + 12 * i]) for i in range(count)]
    entries = [
        entry for entry in entries if struct.unpack_from("<H", entry)[0] not in (273, 278, 279)
    ]
    more = {322: width, 323: width, 324: 8, 325: 100}
    entries += [struct.pack("<HHII", tag, 4, 1, value) for tag, value in more.items()]
    body = struct.pack("<H", len(entries)) + b"".join(sorted(entries)) + bytes(4)
    return bytes(data[:4]) + struct.pack("<I", len(data)) + bytes(data[8:]) + body


ROWS = np.zeros((6, 8), np.uint8)
WEBP = b"RIFF\x1a\0\0\0WEBPVP8X\x0a\0\0\0" + bytes(4) + b"\xff\xff\x01\xff\xff\x01" + bytes(8)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (png(ROWS, 8, 0, claim=0xFFFFFFF0), "a chunk claims 4294967280 bytes"),
        (png(ROWS, 8, 0, struct.pack(">I", 0xFFFFFFF0) + b"tEXt"), "claims 4294967280 bytes"),
        (png(np.zeros((20, 1 << 20), np.uint8), 1, 0), "is 8388608x20, more than 134 megapixels"),
        (WEBP, "is 131072x131072, more than 134 megapixels"),
        (tiles(60_000), "is 60000x60000, more than 134 megapixels"),
        (
            saved(Image.fromarray(COLOUR), "JPEG").replace(b"\0\x06\0\x08", b"\xff\xf0\xff\xf0"),
            "is 655",
        ),
        (saved(Image.fromarray(COLOUR), "JPEG")[:-30], "cut|truncated"),
        (saved(Image.fromarray(COLOUR), "TIFF")[:-30], "cut|truncated"),
        (saved(Image.fromarray(COLOUR), "PNG")[:-30], "cut short"),
        (saved(Image.fromarray(np.zeros((4, 4), np.float32)), "TIFF"), "its pixels are floats"),
        (b"\0\0\0\x18ftypheic" + bytes(30), "it begins like HEIC or AVIF"),
        (b"v/1\x01" + bytes(30), "it begins like OpenEXR"),
        (b"version https://git-lfs.github.com/spec/v1", "it begins like a Git LFS pointer"),
        (b"", "it is not one of BMP, JPEG"),
    ],
)
def test_what_is_refused_takes_no_memory(data: bytes, problem: str) -> None:
    tracemalloc.start()
    with pytest.raises(InputError, match=problem):
        decode_image(data, "a.png")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20


INSIDE = np.zeros((6, 8), bool)
INSIDE[:3] = True
_LABELS = Image.fromarray(INSIDE.astype(np.uint8))
_COLOURED = _LABELS.copy()
_COLOURED.putpalette([0, 0, 0, 128, 0, 0])
_WHITE = np.full((6, 8, 3), 255, np.uint8)


@pytest.mark.parametrize(
    "image",
    [
        _LABELS,
        Image.fromarray(INSIDE),
        Image.fromarray(INSIDE.astype(np.uint8) * 255),
        Image.fromarray(INSIDE.astype(np.uint16) * 65535),
        Image.fromarray(INSIDE.astype(np.uint16) * 255),
        Image.fromarray(INSIDE.astype(np.uint16)),
        _COLOURED,
        Image.fromarray(np.dstack([_WHITE, INSIDE * np.uint8(255)])),
        Image.fromarray(np.dstack([COLOUR, INSIDE * np.uint8(255)])),
        Image.fromarray(np.dstack([_WHITE * INSIDE[..., None], _WHITE[..., 0]])),
        Image.fromarray(_WHITE * INSIDE[..., None]),
    ],
    ids=range(11),
)
def test_masks_of_all_kinds(image: Image.Image) -> None:
    mask = decode_mask(saved(image, "PNG"), "a.png", (8, 6))
    np.testing.assert_array_equal(mask, INSIDE * np.uint8(255))


def test_masks_keep_soft_edges_and_labels_are_refused() -> None:
    soft = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
    np.testing.assert_array_equal(
        decode_mask(saved(Image.fromarray(soft), "PNG"), "a", (8, 6)), soft
    )
    faint = decode_mask(saved(Image.fromarray(soft // 4), "PNG"), "a", (8, 6))
    assert faint.max() < 127  # surely nothing, and no labels
    labels = Image.fromarray((np.arange(48) % 4).astype(np.uint8).reshape(6, 8))
    with pytest.raises(InputError, match=r"mask: holds labels \(0, 1, 2, 3\)"):
        decode_mask(saved(labels, "PNG"), "a", (8, 6))
    for level, value in ((0, 0), (1, 255), (255, 255)):
        flat = Image.new("L", (8, 6), level)
        assert (decode_mask(saved(flat, "PNG"), "a", (8, 6)) == value).all()
    with pytest.raises(InputError, match="size: is 8x6, the image 9x6"):
        decode_mask(saved(labels, "PNG"), "a", (9, 6))
