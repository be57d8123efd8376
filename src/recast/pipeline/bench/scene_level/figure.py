"""figure_MOTION.png: moments x arms, as the paper's qualitative figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from PIL import ImageDraw

from recast import storage
from recast.errors import printable
from recast.evaluation.scene_level.frames import RolloutFrame
from recast.names import folder_name

Image = NDArray[np.uint8]

MOST_ROWS = 8
_WIDTH, _HEAD, _GAP = 360, 18, 4


def write_figures(
    frames: Mapping[str, Sequence[RolloutFrame]],
    arms: Sequence[str],
    pictures: Callable[[str, str], Mapping[int, Path]],
    out: Path,
) -> None:
    """Write a figure for each motion: a row for each scene and setting, a column for each arm.

    Args:
        frames: images by scene.
        arms: names.
        pictures: from scene and arm to pictures by number of the image.
    """
    motions = dict.fromkeys(frame.motion for scene in frames.values() for frame in scene)
    shown = {scene: {arm: pictures(scene, arm) for arm in arms} for scene in frames}
    for motion in motions:
        rows = [
            (f"{scene}, {frames[scene][index].setting}, step {frames[scene][index].step}",
             [of_arm.get(index) for of_arm in by_arm.values()])
            for scene, by_arm in shown.items()
            for index in next(iter(by_arm.values()), {})
            if frames[scene][index].motion == motion
        ]  # fmt: skip
        if rows:
            figure = _figure(rows[:MOST_ROWS], arms)
            with storage.atomic_file(out / f"figure_{folder_name(motion)}.png") as partial:
                figure.save(partial, format="PNG")


def _figure(
    rows: Sequence[tuple[str, Sequence[Path | None]]], arms: Sequence[str]
) -> PilImage.Image:
    cells = [[_cell(path) for path in paths] for _, paths in rows]
    heights = [_HEAD + max(len(cell) for cell in row) for row in cells]
    size = ((_WIDTH + _GAP) * len(arms) - _GAP, _HEAD + sum(heights) + _GAP * len(rows))
    figure = PilImage.new("RGB", size, "white")
    draw = ImageDraw.Draw(figure)
    for column, arm in enumerate(arms):
        draw.text((column * (_WIDTH + _GAP) + 2, 3), printable(arm), fill="black")
    top = _HEAD
    for (title, _), row, height in zip(rows, cells, heights, strict=True):
        draw.text((2, top + 3), printable(title), fill="black")
        for column, cell in enumerate(row):
            place = (column * (_WIDTH + _GAP), top + _HEAD)
            figure.paste(PilImage.fromarray(cell), place)
        top += height + _GAP
    return figure


def _cell(path: Path | None) -> Image:
    if path is None:
        return np.full((_WIDTH * 2 // 3, _WIDTH, 3), 200, np.uint8)
    image = np.asarray(PilImage.open(path).convert("RGB"))
    height = round(image.shape[0] * _WIDTH / image.shape[1])
    return np.asarray(cv2.resize(image, (_WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)
