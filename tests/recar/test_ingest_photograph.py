"""Photographs: sizes, masks, hashes, and doubts about outlines."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from recast.actors.cutout import GrabCutRemover, central_detection, mask_doubts
from recast.actors.grounded_segmenter import Detection
from recast.core import files
from recast.core.errors import InputError
from recast.recar import read_set
from recast.recar.ingest import ingest_photographs
from recast.recar.ingest_photograph import (
    SeenPictures,
    distances,
    fit,
    natural_order,
    outline_doubts,
    perceptual_hash,
    photograph_size,
    read_photograph,
)
from recast.recar.ingest_table import DUPLICATE_BITS, IngestSettings
from support.vehicle_outlines import turntable_alphas
from support.vehicle_photographs import (
    SETTINGS,
    car_before_a_wall,
    over_wall,
    photograph,
    write_photos,
)
from support.vehicle_sets import write_set


def test_exif_turns_a_photograph_upright(tmp_path: Path) -> None:
    picture = Image.fromarray(photograph(1)[..., :3])
    exif = Image.Exif()
    exif[0x0112] = 6
    picture.save(tmp_path / "a.jpg", exif=exif, quality=95)
    assert photograph_size(tmp_path / "a.jpg") == (40, 60)
    rgb, alpha = read_photograph(tmp_path / "a.jpg")
    assert rgb.shape == (60, 40, 3) and alpha is None
    turned = np.rot90(photograph(1)[..., :3], -1)
    assert np.abs(rgb.astype(int) - turned).mean() < 15


@pytest.mark.parametrize("told", ["exif", "text", "xmp"])
@pytest.mark.parametrize("late", [False, True])
def test_the_size_is_that_of_the_pixels_wherever_a_png_tells_the_orientation(
    tmp_path: Path, told: str, late: bool
) -> None:
    """exiftool writes it behind the pixels."""
    exif = Image.Exif()
    exif[0x0112] = 6
    if told == "exif":
        kind, body = b"eXIf", exif.tobytes()[6:]
    elif told == "text":
        data = exif.tobytes()
        kind, body = b"tEXt", b"Raw profile type exif\0\nexif\n      %d\n" % len(data)
        body += data.hex().encode() + b"\n"
    else:
        kind, body = b"iTXt", b'XML:com.adobe.xmp\0\0\0\0\0<x tiff:Orientation="6"/>'
    buffer = io.BytesIO()
    Image.fromarray(photograph(1)[..., :3]).save(buffer, "PNG")
    data = buffer.getvalue()
    place = len(data) - 12 if late else 33  # before IEND, or behind IHDR
    path = tmp_path / "a.png"
    path.write_bytes(data[:place] + chunk(kind, body) + data[place:])
    assert photograph_size(path) == (40, 60)
    rgb, _ = read_photograph(path)
    assert rgb.shape == (60, 40, 3)
    np.testing.assert_array_equal(rgb, np.rot90(photograph(1)[..., :3], -1))


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(width: int, height: int) -> bytes:
    """A header that says so, and one row of pixels that packs to nothing."""
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    pixels = zlib.compress(bytes(1 + 4 * width))
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", pixels), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(("width", "height"), [(8193, 8192), (12_000, 12_000), (40_000, 20_000)])
def test_a_photograph_of_too_many_pixels_is_refused_by_its_header(
    tmp_path: Path, width: int, height: int
) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png_of(width, height))
    for read in (photograph_size, read_photograph):
        tracemalloc.start()
        with pytest.raises(InputError) as caught:
            read(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert str(width) in caught.value.problem or "exceeds limit" in caught.value.problem
        assert peak < 4 << 20  # the file is read, no pixel is decoded


def test_a_set_names_no_size_that_takes_gigabytes(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set").folder
    record = files.read_json(folder / "set.json")
    files.write_json(folder / "set.json", record | {"width": 32768, "height": 32768})
    for identity in ("car-0", "car-1", "car-2"):
        for view in (folder / identity).glob("*.png"):
            view.write_bytes(png_of(32768, 32768))
    with pytest.raises(InputError, match="width: Input should be less than or equal to 8192"):
        read_set(folder)


def test_other_formats_are_refused_whatever_their_name(tmp_path: Path) -> None:
    """Readers of some run programs, such as Ghostscript."""
    path = tmp_path / "a.jpg"
    Image.fromarray(photograph(1)[..., :3]).save(path, "EPS")
    with pytest.raises(InputError, match="is not one of BMP, JPEG, PNG, TIFF, WEBP"):
        photograph_size(path)


def test_numbers_in_names_count() -> None:
    names = ["IMG_10.jpg", "IMG_9.jpg", "IMG_1.jpg", "a2.png", "1.png"]
    ordered = sorted(map(Path, names), key=natural_order)
    assert [p.name for p in ordered] == ["1.png", "a2.png", "IMG_1.jpg", "IMG_9.jpg", "IMG_10.jpg"]


def test_no_background_bleeds_into_the_edge() -> None:
    rgba = photograph(0, 240, 160)
    rgba[..., :3] = np.where(rgba[..., 3:] > 0, 100, 255)
    small = fit(np.ascontiguousarray(rgba[..., :3]), rgba[..., 3].copy(), 70, 47)
    solid = small[..., 3] > 8
    assert np.abs(small[solid][:, :3].astype(int) - 100).max() <= 1
    assert (small[..., 3] % 255 != 0).any()


def test_nearly_all_copies_are_found_and_no_other_picture() -> None:
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        scale, quality = rng.uniform(0.5, 1.5), int(rng.integers(85, 96))
        rgba = photograph(seed, 240, 160, 32)
        size = (round(240 * scale), round(160 * scale))
        colour = np.asarray(cv2.resize(rgba[..., :3], size, interpolation=cv2.INTER_AREA))
        _, data = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, quality])
        copy = np.dstack([cv2.imdecode(data, 1), cv2.resize(rgba[..., 3], size)])
        hashes = np.stack([perceptual_hash(rgba), perceptual_hash(copy)])
        found.append(int(distances(hashes[0], hashes[1:])[0]))
        other = perceptual_hash(photograph(seed + 1, 240, 160, 32))
        assert distances(other, hashes).min() > 60
    assert np.mean(np.array(found) <= DUPLICATE_BITS) >= 0.9
    assert max(found) < 40  # between copies and others there is room


@given(st.integers(0, 2**32), st.integers(0, 255))
@settings(max_examples=30, deadline=None)
def test_seen_pictures_are_those_that_comparing_all_finds(seed: int, bits: int) -> None:
    rng = np.random.default_rng(seed)
    known = rng.integers(0, 2**64, (6, 3, 4), np.uint64)
    asked = rng.integers(0, 2**64, (3, 4), np.uint64)
    asked[0] = known[4, 1] ^ np.uint64(1)
    seen = SeenPictures(bits)
    for index, hashes in enumerate(known):
        seen.add(str(index), hashes)
    slow = {}
    for index, hashes in enumerate(known):
        count = sum(
            any(sum(bin(int(x)).count("1") for x in a ^ b) <= bits for b in hashes) for a in asked
        )
        if count:
            slow[str(index)] = count
    assert seen.matches(asked) == slow


@pytest.mark.parametrize("scale", [1, 3])
def test_grabcut_finds_a_car_before_a_wall(scale: int) -> None:
    image, mask = car_before_a_wall()
    size = (300 * scale, 200 * scale)
    image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
    truth = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    found = GrabCutRemover().remove(image, "car")
    solid = found.alpha > 127
    assert (solid & truth).sum() / (solid | truth).sum() > 0.95
    assert found.doubts == ()
    assert np.array_equal(found.alpha, GrabCutRemover().remove(image, "car").alpha)


def test_distances_count_bits() -> None:
    one, *others = np.random.default_rng(0).integers(0, 2**64, (50, 4), np.uint64)
    bits = [[(int(a) ^ int(b)).bit_count() for a, b in zip(one, x, strict=True)] for x in others]
    assert distances(one, np.array(others)).tolist() == [sum(row) for row in bits]


def test_grabcut_says_where_it_does_not_know() -> None:
    rng = np.random.default_rng(0)
    busy = rng.integers(0, 255, (100, 150, 3)).astype(np.uint8)
    assert GrabCutRemover().remove(busy).doubts
    assert GrabCutRemover().remove(np.full((100, 150, 3), 128, np.uint8)).doubts
    everything = np.ones((10, 10), bool)
    assert len(mask_doubts(everything)) == 2
    assert len(mask_doubts(~everything)) == 1


def test_the_detection_in_the_middle_is_taken() -> None:
    def found(score: float, *box: float) -> Detection:
        return Detection(np.array(box, np.float64), score, "a car.")

    small, large = found(0.9, 40, 40, 60, 60), found(0.5, 10, 10, 90, 90)
    beside = found(0.99, 0, 0, 45, 100)
    assert central_detection([small, beside, large], 100, 100) is large
    assert central_detection([beside], 100, 100) is None


def test_backgrounds_are_removed_where_nothing_is_transparent(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    for path in (photos / "car-0").iterdir():
        with Image.open(path) as picture:
            opaque = over_wall(np.asarray(picture))
        Image.fromarray(opaque).save(path)
    made = ingest_photographs(photos, tmp_path / "set", SETTINGS, GrabCutRemover()).vehicle_set
    for view in range(4):
        solid = made.identities["car-0"].view(view)[..., 3] > 127
        truth = photograph(view)[..., 3] > 0
        assert (solid & truth).sum() / (solid | truth).sum() > 0.8


VIEWS = 24
NAMES = [f"{view}.png" for view in range(VIEWS)]


@pytest.fixture(scope="module")
def alphas() -> list[np.ndarray]:
    return turntable_alphas(np.arange(VIEWS) * 360 / VIEWS)


def without(alpha: np.ndarray, first: float, last: float) -> np.ndarray:
    """The mask without the columns between two shares of its width."""
    columns = np.flatnonzero(alpha.any(axis=0))
    left, right = np.quantile(columns, [first, last]).astype(int)
    broken = alpha.copy()
    broken[:, left : right + 1] = 0
    return broken


def test_whole_masks_raise_no_doubt(alphas: list[np.ndarray]) -> None:
    assert outline_doubts(alphas, NAMES) == ()
    for few in (1, 2, 3, 4, 8):
        assert outline_doubts(alphas[:: VIEWS // few][:few], NAMES) == ()


@pytest.mark.parametrize("part", [(0, 1 / 3), (1 / 3, 2 / 3), (2 / 3, 1)])
@pytest.mark.parametrize("view", [4, 6, 9, 18])
def test_a_third_of_a_side_missing_names_the_photograph(
    alphas: list[np.ndarray], view: int, part: tuple[float, float]
) -> None:
    broken = [*alphas[:view], without(alphas[view], *part), *alphas[view + 1 :]]
    (doubt,) = outline_doubts(broken, NAMES)
    assert doubt.startswith(f"{view}.png: the mask ")


@pytest.mark.parametrize("off", [-12.0, -3.5, 2.0, 7.5])
def test_a_front_that_is_off_raises_no_flood(off: float) -> None:
    turned = turntable_alphas(np.arange(VIEWS) * 360 / VIEWS + off)
    assert outline_doubts(turned, NAMES) == ()


def test_irregular_azimuths_raise_no_flood() -> None:
    jitter = np.random.default_rng(0).uniform(-5, 5, VIEWS)
    assert len(outline_doubts(turntable_alphas(np.arange(VIEWS) * 360 / VIEWS + jitter), NAMES)) < 2


def test_many_broken_masks_are_one_line(alphas: list[np.ndarray]) -> None:
    broken = [without(alpha, 0.3, 0.7) for alpha in alphas]
    (doubt,) = outline_doubts(broken, NAMES)
    assert doubt.startswith("24 of 24 masks have holes") and doubt.endswith("23.png")


def test_the_report_names_the_photograph(tmp_path: Path, alphas: list[np.ndarray]) -> None:
    folder = tmp_path / "photos" / "car"
    folder.mkdir(parents=True)
    (tmp_path / "photos" / "vehicles.csv").write_text("id,kind\ncar,sedan\n")
    rng = np.random.default_rng(0)
    for view, alpha in enumerate([*alphas[:6], without(alphas[6], 0, 1 / 3), *alphas[7:]]):
        grain = rng.integers(0, 255, (*alpha.shape, 3)).astype(np.uint8)
        Image.fromarray(np.dstack([grain, alpha])).save(folder / f"{view}.png")
    height, width = alphas[0].shape
    settings = IngestSettings("CC0-1.0", "test", VIEWS, width, height, duplicate_bits=0)
    ingest_photographs(tmp_path / "photos", tmp_path / "set", settings, None)
    (doubt,) = json.loads((tmp_path / "set" / "ingest.json").read_text())["doubts"]["car"]
    assert doubt.startswith("6.png: the mask differs from the mirrored mask of 18.png")
