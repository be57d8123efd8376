"""Folders of small photographs, no two alike."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from recast.recar.ingest_table import IngestSettings

VIEWS, WIDTH, HEIGHT = 4, 60, 40
SETTINGS = IngestSettings("CC-BY-4.0", "drawn by the tests", VIEWS, WIDTH, HEIGHT)


def photograph(seed: int, width: int = WIDTH, height: int = HEIGHT, cells: int = 9) -> np.ndarray:
    """RGBA (H, W, 4): coarse noise in a rectangle, transparent about it."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (2 * cells // 3, cells, 3)).astype(np.uint8)
    picture = np.zeros((height, width, 4), np.uint8)
    inner = picture[height // 5 : -height // 5, width // 6 : -width // 6]
    inner[..., :3] = cv2.resize(coarse, inner.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    inner[..., 3] = 255
    return picture


def over_wall(rgba: np.ndarray) -> np.ndarray:
    """RGB (H, W, 3) before an even wall."""
    wall = np.array([40, 200, 60], np.uint8)
    return np.where(rgba[..., 3:] > 0, rgba[..., :3], wall).astype(np.uint8)


def write_photos(folder: Path, vehicles: int = 3, **columns: object) -> Path:
    """vehicles.csv and PNGs with alpha of car-0, car-1, ..."""
    rows = []
    for index in range(vehicles):
        name = f"car-{index}"
        (folder / name).mkdir(parents=True)
        for view in range(VIEWS):
            path = folder / name / f"{view + 7}.png"  # 10.png comes after 9.png
            Image.fromarray(photograph(100 * index + view)).save(path)
        rows.append({"id": name, "kind": "sedan", "colour": "red", **columns})
    write_rows(folder, rows)
    return folder


def write_rows(folder: Path, rows: list[dict[str, object]]) -> None:
    with (folder / "vehicles.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def car_before_a_wall() -> tuple[np.ndarray, np.ndarray]:
    """A dark car with windows before a light wall that shades off; and where it is."""
    height, width = 200, 300
    mask = np.zeros((height, width), np.uint8)
    cv2.rectangle(mask, (60, 95), (240, 140), 1, -1)
    cv2.fillPoly(mask, [np.array([(95, 96), (120, 65), (190, 65), (215, 96)])], 1)
    for x in (100, 200):
        cv2.circle(mask, (x, 140), 16, 1, -1)
    rng = np.random.default_rng(0)
    rows = np.linspace(230, 180, height)[:, None, None]
    image = np.broadcast_to(rows, (height, width, 3)) + rng.normal(0, 3, (height, width, 3))
    image[mask > 0] = np.array([150, 30, 40]) + rng.normal(0, 6, (int(mask.sum()), 3))
    image[70:92, 125:185] = (200, 200, 205)  # a window like the wall
    return np.clip(image, 0, 255).astype(np.uint8), mask > 0
