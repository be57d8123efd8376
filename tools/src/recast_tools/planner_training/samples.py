"""Samples on disk, a folder of PNG files and a parquet table for each world, and changes of their
pictures for the training.

Pictures are read when they are looked at, worlds are there whole or not at all. The changes leave
what a picture shows: rendered scenes look worse than traced ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.files import atomic_folder, read_bytes, write_bytes
from recast.core.records import Record, read_record
from recast.core.table_files import read_parquet, write_parquet
from recast.logs.images import decode, encode
from recast.planning.gtrs import PRIMITIVES, MotionPrimitives
from recast.planning.gtrs.expert import SCORED
from recast_tools.planner_training.targets import COLUMN_VALUES

RECORD_FILE, DRIVER_FOLDER = "dataset.json", "driver"
VERSION: Literal[7] = 7
"""Version of the format; until version 3, samples were drawn and not driven, until version 4 a
vocabulary was scored that was the same for all, until version 5 nothing told what the columns of a
picture show, until version 6 they showed no road user between the columns' middles."""
MEND = "name another folder, or make the samples again"
CLUES = (
    "present",
    "x",
    "y",
    "cos",
    "sin",
    "lateral",
    "turn",
    "route_10",
    "route_20",
    "route_30",
)
"""What a picture tells, beside the scores: whether the vehicle placed is in sight, where its middle
is and how it is turned (ego frame); how far the ego is off the route, to the left, and turned
against it; how far to the left the route is 10, 20 and 30 m on. Metres and radians."""
EVERY = 0.5
"""Seconds between the samples of a drive."""
_LONGEST = 6.0
"""Seconds: no planner looks further back."""
COLUMNS = 32
"""Columns of a picture of which is told what they show, 16 pixels wide each."""
HELD_OUT_EVERY = 10
"""Worlds; nine scenes take turns, so each is held out in turn."""

Renderer = Literal["oracle", "native", "replaced", "refined"]
RENDERERS: tuple[Renderer, ...] = get_args(Renderer)
"""What an image shows: the truth; or a reconstructed street with the target as reconstructed, with
a generated vehicle in its place, or with that vehicle refined."""

_GOLDEN = (5**0.5 - 1) / 2
SAMPLES_FILE = "samples.parquet"
_SIZE, _LARGEST = (128, 512), 1 << 20
"""Pixels of a picture, and bytes of its file at most."""
_LINKS = ("twin", "before")
_FLOATS = pa.list_(pa.float32())
_SCHEMA = pa.schema(
    {
        "image": pa.string(),
        "status": _FLOATS,
        "expert": _FLOATS,
        "scores": pa.list_(pa.uint8()),
        "best": pa.list_(pa.int32()),
        "clues": _FLOATS,
        "columns": _FLOATS,
        "renderer": pa.string(),
        "twin": pa.int32(),
        "before": pa.int32(),
    }
)
"""Columns of `samples.parquet`, a row for each sample; see `Sample` and `SampleStore`. `image` is a
file beside it, `expert` the best trajectory at each speed (K, 40, 3); arrays are flat."""

_CLEAN = 0.15
_ONE_CAMERA, _UNSEEN = 0.2, (0.14, 0.27)
"""Share of pictures with black sides, as logs of one camera have them, and how much of the width is
black at each side."""
_MIRRORED_VALUES = np.array([-1.0 if name in ("sin", "vy") else 1.0 for name in COLUMN_VALUES])
_MIRRORED_CLUES = np.array([-1.0 if name not in ("present", "x", "cos") else 1.0 for name in CLUES])


DriveKind = Literal[
    "ordinary",
    "leading",
    "stationary",
    "oncoming",
    "through",
    "cut-in",
    "advancing",
    "crossing",
    "along",
]
"""What happens in a drive of samples."""
DRIVE_KINDS: tuple[DriveKind, ...] = get_args(DriveKind)


class DatasetRecord(Record):
    """What all samples of a folder share, as written to `dataset.json`.

    Attributes:
        seed: seed of everything random; a world's samples depend on it and on the world's number
            alone.
        per_world: number of samples of each world.
        every: seconds between the samples of a drive.
        speeds: number of ego states of each sample.
        seconds: length of each world's drive in seconds.
        scenes: names of scenes, which the worlds take in turn.
        reconstructed: share of the worlds whose images are those of a reconstructed street.
        street_steps: training steps of each of these streets.
        renderers: what a drive in one of them is shown by, in turn; the oracle shows the same drive
            as it truly is, without the vehicles that the street has no model of.
        kinds: what happens in the drives, by the shares of `recast_tools.planner_data.drive`.
        driver: SHA-256 of the weights of the planner that drives every second drive; "" without.
        primitives: what is scored.
    """

    format: Literal["recast-planner-dataset"] = "recast-planner-dataset"
    version: Literal[7] = VERSION
    seed: int = Field(default=0, ge=0)
    per_world: int = Field(default=48, ge=2)
    every: float = Field(default=EVERY, gt=0.0, le=2.0)
    speeds: int = Field(default=2, ge=1)
    seconds: float = Field(default=16.0, ge=14.0, le=20.0)
    scenes: tuple[str, ...] = Field(min_length=1)
    reconstructed: float = Field(default=0.0, ge=0.0, le=1.0)
    street_steps: int = Field(default=1000, ge=1)
    renderers: tuple[Renderer, ...] = Field(default=RENDERERS[1:], min_length=1)
    kinds: tuple[DriveKind, ...] = Field(default=DRIVE_KINDS, min_length=1)
    driver: str = ""
    primitives: MotionPrimitives = PRIMITIVES

    def scene_of(self, number: int) -> str:
        """The scene of a world."""
        return self.scenes[number % len(self.scenes)]

    def is_reconstructed(self, number: int) -> bool:
        """Whether the images of a world show a reconstruction.

        Multiples of the golden ratio are spread evenly, as are those of every n-th world: each
        scene, and the held-out worlds, get about the same share.
        """
        return (number * _GOLDEN) % 1.0 < self.reconstructed


@dataclass(frozen=True)
class Sample:
    """One picture, K speeds of the ego, L trajectories at each.

    Attributes:
        image: (128, 512, 3) uint8 RGB.
        status: (K, 8) float32, see `ego_status`.
        scores: (K, 6, L) uint8, see `Targets`.
        best: (K,) int32, the best trajectory.
        clues: (10,) float32, see `CLUES`.
        columns: (32, 6) float32, what each column of the picture shows, see `COLUMN_VALUES`.
        renderer: renderer of the image, see `RENDERERS`.
    """

    image: NDArray[np.uint8]
    status: NDArray[np.float32]
    scores: NDArray[np.uint8]
    best: NDArray[np.int32]
    clues: NDArray[np.float32]
    columns: NDArray[np.float32]
    renderer: Renderer = "oracle"


def world_folder(folder: Path, number: int) -> Path:
    """Where the samples of a world lie."""
    return folder / f"world-{number:05d}"


def write_world(
    folder: Path,
    samples: Sequence[Sample],
    twins: Sequence[int],
    before: Sequence[int],
    primitives: MotionPrimitives,
) -> None:
    """Write the samples of a world, whole or not at all.

    Args:
        twins: number, for each sample, of the one that differs in the vehicle alone, or -1.
        before: number, for each sample, of the one before it in the drive, or -1.
    """
    rows = []
    with atomic_folder(folder) as partial:
        for index, one in enumerate(samples):
            name = f"{index:03d}.png"
            write_bytes(partial / name, encode(one.image))
            possible = primitives.trajectories(one.status)
            rows.append(
                {
                    "image": name,
                    "status": one.status.ravel(),
                    "expert": possible[np.arange(len(possible)), one.best].ravel(),
                    "scores": one.scores.ravel(),
                    "best": one.best,
                    "clues": one.clues,
                    "columns": one.columns.ravel(),
                    "renderer": one.renderer,
                    "twin": int(twins[index]),
                    "before": int(before[index]),
                }
            )
        write_parquet(partial / SAMPLES_FILE, pa.Table.from_pylist(rows, schema=_SCHEMA))


class SampleStore:
    """All samples of dataset folders; pictures stay on disk until they are looked at.

    Args:
        folders: folders that `recast planner dataset` wrote for the same primitives.

    Raises:
        InputError: one has no samples, its record or a world's files are wrong, or its primitives
            or its number of speeds are not those of the first.

    Attributes:
        folder, record: the first folder and its record.
        worlds: (N,) number of each sample's world.
        status, scores, best, clues, columns: values of all samples, see `Sample`.
        renderer: (N,) index in `RENDERERS` of what rendered each image.
        twin: (N,) index of the sample that differs in the vehicle alone, or -1.
        before: (N,) index of the sample before it in the drive, or -1.
        every: (N,) seconds between it and the one before.
    """

    def __init__(self, *folders: Path) -> None:
        self.folder = folders[0]
        self.record = read_dataset(self.folder)
        paths, every = [], []
        for folder in folders:
            record = read_dataset(folder)
            for name in ("speeds", "primitives"):
                if getattr(record, name) != getattr(self.record, name):
                    problem = f"differs from that of {self.folder}"
                    raise InputError(folder / RECORD_FILE, name, problem, MEND)
            found = sorted(folder.glob("world-*"))
            if not found:
                mend = "make them with `recast planner dataset`"
                raise InputError(folder, "samples", "are missing", mend)
            paths += found
            every += [record.every] * len(found)
        speeds, each = self.record.speeds, len(self.record.primitives)
        self._images: list[Path] = []
        parts: dict[str, list[np.ndarray]] = {name: [] for name in _SCHEMA.names}
        worlds: list[int] = []
        apart: list[float] = []
        for path, seconds in zip(paths, every, strict=True):
            first = len(worlds)
            for name, values in _read_world(path, speeds, each).items():
                linked = np.where(values < 0, -1, values + first) if name in _LINKS else values
                parts[name].append(linked)
            self._images += [path / name for name in parts["image"][-1]]
            count = len(parts["image"][-1])
            worlds += [int(path.name.removeprefix("world-"))] * count
            apart += [seconds] * count
        self.worlds, self.every = np.array(worlds), np.array(apart)
        whole = {name: np.concatenate(values) for name, values in parts.items() if values}
        self.status, self.scores, self.best = whole["status"], whole["scores"], whole["best"]
        self.clues, self.columns, self.renderer = (
            whole["clues"],
            whole["columns"],
            whole["renderer"],
        )
        self.twin, self.before = (whole[name] for name in _LINKS)

    def __len__(self) -> int:
        return len(self.worlds)

    def image(self, index: int) -> NDArray[np.uint8]:
        """(128, 512, 3) uint8. Raises InputError: its file is missing or broken."""
        path = self._images[index]
        says = f"{SAMPLES_FILE} beside it"
        return decode(read_bytes(path, _LARGEST), "png", (_SIZE[1], _SIZE[0]), path, says)

    def earlier(self, index: int) -> dict[float, int]:
        """The samples before one in its drive, by how many seconds."""
        found, age, one = {}, 0.0, index
        while self.before[one] >= 0 and age < _LONGEST:
            age, one = age + float(self.every[one]), int(self.before[one])
            found[round(age, 3)] = one
        return found

    def by_renderer(self) -> dict[str, int]:
        """Number of samples of each renderer."""
        counts = np.bincount(self.renderer, minlength=len(RENDERERS)).tolist()
        return dict(zip(RENDERERS, counts, strict=True))

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(N,) samples of the worlds that are not trained on."""
        return self.worlds % HELD_OUT_EVERY == HELD_OUT_EVERY - 1


def read_dataset(folder: Path) -> DatasetRecord:
    """Record of a folder. Raises InputError: it is none of `recast planner dataset`."""
    name = folder / RECORD_FILE
    return read_record(name, DatasetRecord, VERSION, MEND, "recast-planner-dataset")


def _read_world(path: Path, speeds: int, each: int) -> dict[str, np.ndarray]:
    """The columns of a world but for the expert's: arrays of a row for each sample."""
    mend = f"remove {path}, and make it again with `recast planner dataset`"
    used = [name for name in _SCHEMA.names if name != "expert"]
    table = read_parquet(path / SAMPLES_FILE, used, mend)
    renderer = table.words("renderer")
    images = table.words("image")
    for name, values, good in (
        ("renderer", renderer, [one in RENDERERS for one in renderer]),
        ("image", images, [one == Path(one).name for one in images]),
    ):
        for row in np.flatnonzero(~np.array(good)):
            problem = f"row {row} is {values[row]!r}"
            raise InputError(path / SAMPLES_FILE, f"column {name}", problem, mend)
    return {
        "image": images,
        "status": table.lists("status", speeds * 8).astype(np.float32).reshape(-1, speeds, 8),
        "scores": table.lists("scores", speeds * len(SCORED) * each)
        .astype(np.uint8)
        .reshape(-1, speeds, len(SCORED), each),
        "best": table.lists("best", speeds).astype(np.int32),
        "clues": table.lists("clues", len(CLUES)).astype(np.float32),
        "columns": table.lists("columns", COLUMNS * len(COLUMN_VALUES))
        .astype(np.float32)
        .reshape(-1, COLUMNS, len(COLUMN_VALUES)),
        "renderer": np.array([RENDERERS.index(one) for one in renderer], np.uint8),
        **{name: table.numbers(name).astype(np.int32) for name in _LINKS},
    }


def augment(image: Image, rng: np.random.Generator) -> Image:
    """Colour, exposure, blur, speckle, floaters, noise, JPEG, a shift of some pixels, black sides.

    As of reconstructed scenes: blurred patches, blobs of wrong colour in thin air, haze; as of
    cameras: exposure, white balance, noise, and what one camera does not see of three pictures. One
    in seven stays as it is.

    Args:
        image: (H, W, 3) uint8.
    """
    if rng.uniform() < _CLEAN:
        return image
    picture = image
    if rng.uniform() < 0.5:
        picture = _shifted(picture, int(rng.integers(-3, 4)), int(rng.integers(-2, 3)))
    if rng.uniform() < 0.5:
        picture = _blurred(picture, float(rng.uniform(0.4, 1.5)))
    if rng.uniform() < 0.35:
        picture = _blurred_patches(picture, rng)
    if rng.uniform() < 0.3:
        picture = _floaters(picture, rng)
    found = np.asarray(cv2.transform(picture.astype(np.float32), _colours(rng)), np.float32)
    if rng.uniform() < 0.5:
        noise = rng.standard_normal(picture.shape, np.float32)
        found += np.float32(rng.uniform(1.0, 8.0)) * noise
    picture = np.clip(found, 0, 255).astype(np.uint8)
    if rng.uniform() < 0.3:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 90))]
        _, coded = cv2.imencode(".jpg", picture, quality)
        picture = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    picture = np.ascontiguousarray(picture)
    if rng.uniform() < _ONE_CAMERA:
        side = np.rint(rng.uniform(*_UNSEEN, 2) * picture.shape[1]).astype(int)
        picture[:, : side[0]] = picture[:, -side[1] :] = 0
    return picture


def mirror_image(image: Image) -> Image:
    """The stitched picture (H, W, 3) of the mirrored street: right becomes left, cameras too."""
    return np.ascontiguousarray(image[:, ::-1])


def mirror_clues(clues: NDArray[np.float32]) -> NDArray[np.float32]:
    """Clues (..., 10) of the mirrored street."""
    return (clues * _MIRRORED_CLUES).astype(np.float32)


def mirror_columns(columns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values of the columns (..., 32, 6) of the mirrored street."""
    return (columns[..., ::-1, :] * _MIRRORED_VALUES).astype(np.float32)


def mirror_status(status: NDArray[np.float32]) -> NDArray[np.float32]:
    """Status (..., 8) of the mirrored street: left and right change places, vy and ay sign."""
    found = status[..., [2, 1, 0, 3, 4, 5, 6, 7]].copy()
    found[..., [5, 7]] *= -1.0
    return found


def _shifted(picture: Image, across: int, down: int) -> Image:
    """Moved by some pixels; the edge fills what comes in."""
    height, width = picture.shape[:2]
    rows = np.clip(np.arange(height) - down, 0, height - 1)
    columns = np.clip(np.arange(width) - across, 0, width - 1)
    return picture[rows][:, columns]


def _blurred(picture: Image, sigma: float) -> Image:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), np.uint8)


def _colours(rng: np.random.Generator) -> NDArray[np.float64]:
    """(3, 4): saturation, white balance, exposure, contrast around a middle grey, brightness."""
    saturation, contrast = rng.uniform(0.6, 1.3), rng.uniform(0.8, 1.2)
    gain = rng.uniform(0.75, 1.25) * rng.uniform(0.93, 1.07, 3)
    mixed = saturation * np.eye(3) + (1.0 - saturation) / 3
    brightness = 110.0 * (1.0 - contrast) + rng.uniform(-12.0, 12.0)
    return np.concatenate([contrast * gain[:, None] * mixed, np.full((3, 1), brightness)], axis=1)


def _blurred_patches(picture: Image, rng: np.random.Generator) -> Image:
    height, width = picture.shape[:2]
    soft = _blurred(picture, float(rng.uniform(2.0, 4.0)))
    mask = np.zeros((height, width), np.uint8)
    for _ in range(int(rng.integers(1, 5))):
        centre = int(rng.integers(width)), int(rng.integers(height))
        axes = int(rng.integers(8, 60)), int(rng.integers(5, 25))
        cv2.ellipse(mask, centre, axes, 0.0, 0.0, 360.0, 255, -1)
    return np.where(mask[..., None] > 0, soft, picture)


def _floaters(picture: Image, rng: np.random.Generator) -> Image:
    """Small translucent blobs, smaller than any vehicle that matters."""
    height, width = picture.shape[:2]
    drawn = picture.copy()
    for _ in range(int(rng.integers(1, 10))):
        centre = int(rng.integers(width)), int(rng.integers(height))
        axes = int(rng.integers(1, 10)), int(rng.integers(1, 5))
        colour = rng.integers(0, 256, 3).tolist()
        cv2.ellipse(drawn, centre, axes, float(rng.uniform(0, 180)), 0.0, 360.0, colour, -1)
    weight = float(rng.uniform(0.3, 0.9))
    return np.asarray(cv2.addWeighted(drawn, weight, picture, 1.0 - weight, 0.0), np.uint8)
