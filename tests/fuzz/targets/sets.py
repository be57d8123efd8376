"""Vehicle sets, photographs, pseudo-targets and the assets they are trained from."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from fuzz.target import Target
from recast.core.files import write_json
from recast.core.images import decode_image, rgba
from recast.recar.ingest import ingest_photographs
from recast.recar.ingest_table import read_table
from recast.recar.perturb import PerturbationConfig, read_perturbations, write_perturbations
from recast.recar.screening import read_decisions, screened_vehicles, write_screening
from recast.recar.target_cache import TargetCache
from recast.recar.training_conditions import TrainingAsset, read_asset, write_asset
from recast.recar.training_config import read_stage_config
from recast.recar.vehicle_set import read_set
from recast.recar.views import read_real_crops
from support import target_caches
from support.crops import write_crops
from support.tiny_stage import tiny_config
from support.vehicle_photographs import SETTINGS, photograph, write_photos
from support.vehicle_sets import write_set


def _read_set(folder: Path, out: Path) -> object:
    found = read_set(folder / "cars")
    return [(one.record, one.view(0)) for one in found.identities.values()]


def _write_screening(folder: Path) -> None:
    cars = write_set(folder / "cars", 3)
    write_screening(cars.folder, cars.identities, screened_vehicles(cars))


def _read_cache(folder: Path, out: Path) -> object:
    cache = TargetCache.open(folder / "cache")
    return cache.record, [cache.target(one) for one in cache.ids(accepted_only=False)]


def _write_asset(folder: Path) -> None:
    rng = np.random.default_rng(0)
    coords = np.array([[1, 2, 3], [1, 2, 4], [5, 0, 0]], np.uint8)
    features = np.clip(rng.normal(0, 0.3, (3, 17)), -1, 1).astype(np.float16)
    features[:, 9:] = 1
    poses = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    poses[:, 2, 3] = 2.0
    pictures = rng.integers(0, 255, (2, 8, 8, 4)).astype(np.uint8)
    size, focal = np.array([1.0, 0.4, 0.4], np.float32), np.full(2, 9.0, np.float32)
    asset = TrainingAsset("sedan", size, coords, features, pictures, poses, focal, 1)
    write_asset(folder / "asset.npz", asset)


def _write_images(folder: Path) -> None:
    """Photographs as cameras and programs store them."""
    picture = Image.fromarray(photograph(3))
    turned = picture.getexif()
    turned[0x0112] = 6  # orientation
    picture.convert("RGB").save(folder / "a.jpg", exif=turned)
    picture.save(folder / "b.tif", exif=turned)
    picture.convert("P").save(folder / "c.png")
    picture.save(folder / "d.webp")
    picture.convert("RGB").save(folder / "e.bmp")
    deep = np.asarray(picture, np.uint16)[..., :3] * 257
    for name in ("f.png", "g.tif"):
        cv2.imwrite(str(folder / name), deep)


TARGETS = (
    Target("vehicle-set", lambda f: write_set(f / "cars", 3), _read_set, weight=6.0),
    Target("vehicle-set-record", lambda f: write_set(f / "cars", 3), _read_set, ("*.json",), 6.0),
    Target(
        "screening",
        _write_screening,
        lambda f, out: read_decisions(f / "cars", ("car-0", "car-1", "car-2")),
        ("*.csv",),
        8.0,
    ),
    Target(
        "vehicle-table",
        lambda f: write_photos(f, 3),
        lambda f, out: read_table(f / "vehicles.csv"),
        ("*.csv",),
        10.0,
    ),
    Target(
        "photographs",
        lambda f: write_photos(f, 2),
        lambda f, out: ingest_photographs(f, out, SETTINGS, None),
        ("*.png",),
        2.0,
        True,
    ),
    Target(
        "image-formats",
        _write_images,
        lambda f, out: [rgba(decode_image(path, path)) for path in sorted(f.iterdir())],
        weight=6.0,
    ),
    Target(
        "real-crops",
        lambda f: write_crops(f / "crops"),
        lambda f, out: [(v, [w.rgba() for w in v.inputs]) for v in read_real_crops(f / "crops")],
        weight=4.0,
    ),
    Target(
        "target-cache", lambda f: target_caches.write_cache(f / "cache"), _read_cache, weight=4.0
    ),
    Target(
        "perturbations",
        lambda f: write_perturbations(f / "p.json", PerturbationConfig()),
        lambda f, out: read_perturbations(f / "p.json"),
        weight=8.0,
    ),
    Target(
        "stage",
        lambda f: write_json(f / "stage.json", tiny_config().model_dump(mode="json")),
        lambda f, out: read_stage_config(f / "stage.json"),
        weight=8.0,
    ),
    Target("training-asset", _write_asset, lambda f, out: read_asset(f / "asset.npz"), weight=6.0),
)
