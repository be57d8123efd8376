"""Pictures of decisions: what the network saw, what it would drive, and what would be best."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.errors import InputError
from recast.planning.gtrs import ScoreWeights, final_score
from recast.planning.gtrs_training.judge import FIRST_SPEED, true_scores
from recast.planning.gtrs_training.store import SampleStore
from recast.planning.gtrs_training.task import GtrsTask
from recast.storage import write_bytes

Image = NDArray[np.uint8]

_SIDE = 128
_AHEAD, _BEHIND = 45.0, 5.0
_SCALE = _SIDE / (_AHEAD + _BEHIND)
_BEST, _CHOSEN, _VEHICLE, _EGO = (60, 170, 60), (220, 60, 40), (40, 80, 220), (120, 120, 120)


@dataclass(frozen=True)
class Sheet:
    """A picture (H, W, 3) uint8 RGB."""

    image: Image

    def write(self, path: Path) -> None:
        """As PNG, whole or not at all."""
        done, coded = cv2.imencode(".png", self.image[..., ::-1])
        assert done
        write_bytes(path, coded.tobytes())


@torch.no_grad()
def decision_sheet(task: GtrsTask, indices: NDArray[np.int64], weights: ScoreWeights) -> Sheet:
    """What the network chooses, red, on what `truth_sheet` shows.

    Args:
        indices: of the samples; the first speed of each.
        weights: by which it chooses.
    """
    was_training = task.model.training
    task.model.eval()
    batch = task.gather(indices, FIRST_SPEED, np.zeros(len(indices), np.bool_))
    logits = task.model(batch.images, batch.status, batch.trajectories)
    task.model.train(was_training)
    chosen = final_score(logits, weights).argmax(dim=1).tolist()
    rows = [_row(task.store, i, choice) for i, choice in zip(indices, chosen, strict=True)]
    return Sheet(np.vstack(rows))


def truth_sheet(store: SampleStore, first: int, count: int) -> Sheet:
    """A row for each sample: the picture, and from above (50 m) the ten best trajectories, green,
    by their true scores at the first speed, and the vehicle placed, blue.

    Raises:
        InputError: there are no such samples.
    """
    if not 0 <= first < first + count <= len(store):
        problem = f"{first} to {first + count - 1} are not there"
        raise InputError(store.folder, "samples", problem, f"there are {len(store)}")
    return Sheet(np.vstack([_row(store, index, None) for index in range(first, first + count)]))


def _row(store: SampleStore, index: int, choice: int | None) -> Image:
    true = true_scores(store.scores[index, 0])
    view = _from_above(store, index, np.argsort(-true, kind="stable")[:10], choice)
    caption = f"{index}: v {store.status[index, 0, 4]:.1f}  best {true.max():.2f}"
    caption += "" if choice is None else f"  chosen {true[choice]:.2f}"
    cv2.putText(view, caption, (2, 10), cv2.FONT_HERSHEY_SIMPLEX, 0.3, (0, 0, 0), 1)
    return np.hstack([store.image(index), view])


def _from_above(
    store: SampleStore, index: int, best: NDArray[np.int64], choice: int | None
) -> Image:
    canvas = np.full((_SIDE, 2 * _SIDE, 3), 245, np.uint8)
    _box(canvas, 1.461, 0.0, 0.0, (5.176, 2.297), _EGO)
    present, x, y, cos, sin = store.clues[index, :5]
    if present:
        _box(canvas, x, y, float(np.arctan2(sin, cos)), (4.6, 1.9), _VEHICLE)
    for entry in best:
        _line(canvas, store.vocabulary[entry], _BEST)
    if choice is not None:
        _line(canvas, store.vocabulary[choice], _CHOSEN)
    return canvas


def _pixels(points: NDArray[np.floating]) -> NDArray[np.int32]:
    """Ego-frame points (N, 2), x up and y to the left, in the canvas."""
    columns = _SIDE - points[:, 1] * _SCALE
    rows = (_AHEAD - points[:, 0]) * _SCALE
    return np.rint(np.stack([columns, rows], axis=1)).astype(np.int32)


def _line(canvas: Image, trajectory: NDArray[np.float32], colour: tuple[int, int, int]) -> None:
    points = np.concatenate([np.zeros((1, 2), np.float32), trajectory[:, :2]])
    cv2.polylines(canvas, [_pixels(points)], False, colour, 1, cv2.LINE_AA)
    cv2.circle(canvas, _pixels(points[-1:])[0].tolist(), 2, colour, -1)


def _box(
    canvas: Image, x: float, y: float, heading: float, size: tuple[float, float],
    colour: tuple[int, int, int],
) -> None:  # fmt: skip
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2 * size
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    cv2.fillPoly(canvas, [_pixels(corners @ turn + [x, y])], colour)
