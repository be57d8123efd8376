"""How good the planner is on samples it was not trained on, by true scores; in pictures too."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.arrays import Float32Array, Image
from recast.core.errors import InputError
from recast.core.images import draw_text
from recast.dynamics.tracker import comfortable_plans
from recast.planning.gtrs import ScoreWeights, final_score, training_loss
from recast.planning.gtrs.expert import SCORED
from recast_tools.planner_training.samples import SampleStore
from recast_tools.planner_training.targets import unpacked
from recast_tools.planner_training.task import GtrsTask, sum_of

FIRST_SPEED = np.zeros(1, np.int64)
"""The speed at which samples are judged: one at which the ego usually comes there."""
_BATCH = 16

_SIDE = 128
_AHEAD, _BEHIND = 45.0, 5.0
_SCALE = _SIDE / (_AHEAD + _BEHIND)
_BEST, _CHOSEN, _VEHICLE, _EGO = (60, 170, 60), (220, 60, 40), (40, 80, 220), (120, 120, 120)


@dataclass(frozen=True)
class SampleScores:
    """Means over held-out samples; shares and scores in [0, 1].

    Attributes:
        samples: number of samples, each at one speed.
        loss: loss of the heads.
        gap: how much the loss grows with another sample's picture: 0 means that it is ignored.
        score: true score NC DAC DDC (5 TTC + 5 EP + 2 LK) / 12 of the chosen trajectory.
        regret: the best trajectory's score less that.
        comfortable: share of chosen trajectories that are comfortable as COM counts it.
        safe: share of chosen trajectories without collision, where a vehicle is in sight.
        safe_blind: the same with the picture in which the vehicle is erased, over twins alone.
        safe_twins: over the same twins, with the true picture.
        slower: metres that the chosen trajectory is shorter with the vehicle than without it, over
            twins.
    """

    samples: int
    loss: float
    gap: float
    score: float
    regret: float
    comfortable: float
    safe: float
    safe_blind: float
    safe_twins: float
    slower: float

    def means(self) -> dict[str, float]:
        """What the training's log shows."""
        found = {name: float(value) for name, value in asdict(self).items() if name != "samples"}
        return {"held_out": found.pop("loss"), **found}


def true_scores(scores: NDArray[np.uint8]) -> Float32Array:
    """Product scores (..., L) of stored sub-scores (..., 6, L)."""
    part = dict(zip(SCORED, np.moveaxis(unpacked(scores), -2, 0), strict=True))
    average = (
        5 * part["time_to_collision_within_bound"]
        + 5 * part["ego_progress"]
        + 2 * part["lane_keeping"]
    ) / 12
    found: Float32Array = (
        part["no_at_fault_collisions"]
        * part["drivable_area_compliance"]
        * part["driving_direction_compliance"]
        * average
    )
    return found


@torch.no_grad()
def evaluate(task: GtrsTask, indices: NDArray[np.int64], weights: ScoreWeights) -> SampleScores:
    """Judge the model of a task, in its present mode of training, on unaltered samples.

    The model is put into evaluation mode meanwhile.

    Args:
        indices: indices of the samples, at least two; the first speed of each is taken.
        weights: score weights by which it chooses.
    """
    model, store = task.model, task.store
    was_training = model.training
    model.eval()
    try:
        twin = store.twin[indices]
        with_twin = (twin >= 0) & (store.clues[indices, 0] > 0)
        chosen, driven, loss = _choose(task, weights, indices, indices)
        shuffled = _choose(task, weights, indices, np.roll(indices, len(indices) // 2))[2]
        paired = indices[with_twin]
        erased, alone = chosen[:0], driven[:0]
        if len(paired):
            erased, alone, _ = _choose(task, weights, paired, twin[with_twin])
    finally:
        model.train(was_training)
    scores = store.scores[indices, 0]
    true = true_scores(scores)
    rows = np.arange(len(indices))
    got = true[rows, chosen]
    safe = scores[:, 0] == 255
    in_sight = store.clues[indices, 0] > 0
    return SampleScores(
        samples=len(indices),
        loss=loss,
        gap=shuffled - loss,
        score=float(got.mean()),
        regret=float((true.max(axis=1) - got).mean()),
        comfortable=float(comfortable_plans(driven).mean()),
        safe=_mean(safe[rows, chosen][in_sight]),
        safe_blind=_mean(safe[rows[with_twin], erased]),
        safe_twins=_mean(safe[rows, chosen][with_twin]),
        slower=_mean(alone[:, -1, 0] - driven[with_twin, -1, 0]),
    )


def _choose(
    task: GtrsTask, weights: ScoreWeights, indices: NDArray[np.int64], pictures: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Float32Array, float]:
    """Chosen primitive of each sample, seen with another's picture, its trajectory (N, 40, 3), and
    the mean loss."""
    chosen, driven, losses = [], [], []
    for first in range(0, len(indices), _BATCH):
        part, seen = indices[first : first + _BATCH], pictures[first : first + _BATCH]
        images = [task.picture(index) for index in seen]
        ages = np.array([task.age(index) for index in seen])
        batch = task.gather(part, FIRST_SPEED, np.zeros(len(part), np.bool_), images, ages)
        logits = task.logits(task.look(batch), batch)
        terms = training_loss(logits, batch.targets, batch.trajectories, batch.demonstration)
        scored = final_score(logits, weights, batch.calm)
        best = scored.argmax(dim=1)
        chosen.append(best.numpy())
        driven.append(batch.trajectories[torch.arange(len(best)), best].numpy())
        losses.append(float(sum_of(terms)) * len(part))
    mean = float(np.sum(losses) / len(indices))
    return np.concatenate(chosen), np.concatenate(driven), mean


def _mean(values: np.ndarray) -> float:
    """NaN where there are none; the log leaves it out."""
    return float(np.mean(values)) if len(values) else float("nan")


@torch.no_grad()
def decision_sheet(task: GtrsTask, indices: NDArray[np.int64], weights: ScoreWeights) -> Image:
    """(H, W, 3) uint8: what the network chooses, red, on what `truth_sheet` shows.

    Args:
        indices: indices of the samples; the first speed of each is taken.
        weights: score weights by which it chooses.
    """
    was_training = task.model.training
    task.model.eval()
    batch = task.gather(indices, FIRST_SPEED, np.zeros(len(indices), np.bool_))
    logits = task.logits(task.look(batch), batch)
    task.model.train(was_training)
    chosen = final_score(logits, weights, batch.calm).argmax(dim=1).tolist()
    rows = [_row(task.store, i, choice) for i, choice in zip(indices, chosen, strict=True)]
    return np.vstack(rows)


def truth_sheet(store: SampleStore, first: int, count: int) -> Image:
    """A row for each sample: the picture, and from above (50 m) the ten best trajectories, green,
    by their true scores at the first speed, and the vehicle placed, blue.

    Raises:
        InputError: there are no such samples.
    """
    if not 0 <= first < first + count <= len(store):
        problem = f"{first} to {first + count - 1} do not exist"
        raise InputError(store.folder, "samples", problem, f"choose from the {len(store)} samples")
    return np.vstack([_row(store, index, None) for index in range(first, first + count)])


def _row(store: SampleStore, index: int, choice: int | None) -> Image:
    true = true_scores(store.scores[index, 0])
    view = _from_above(store, index, np.argsort(-true, kind="stable")[:10], choice)
    caption = f"{index}: v {store.status[index, 0, 4]:.1f}  best {true.max():.2f}"
    caption += "" if choice is None else f"  chosen {true[choice]:.2f}"
    draw_text(view, (2, 10), caption, size=10, anchor="ls")
    return np.hstack([store.image(index), view])


def _from_above(
    store: SampleStore, index: int, best: NDArray[np.int64], choice: int | None
) -> Image:
    canvas = np.full((_SIDE, 2 * _SIDE, 3), 245, np.uint8)
    _box(canvas, 1.461, 0.0, 0.0, (5.176, 2.297), _EGO)
    present, x, y, cos, sin = store.clues[index, :5]
    if present:
        _box(canvas, x, y, float(np.arctan2(sin, cos)), (4.6, 1.9), _VEHICLE)
    possible = store.record.primitives.trajectories(store.status[index, :1])[0]
    for entry in best:
        _line(canvas, possible[entry], _BEST)
    if choice is not None:
        _line(canvas, possible[choice], _CHOSEN)
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
    canvas: Image,
    x: float,
    y: float,
    heading: float,
    size: tuple[float, float],
    colour: tuple[int, int, int],
) -> None:
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2 * size
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    cv2.fillPoly(canvas, [_pixels(corners @ turn + [x, y])], colour)
