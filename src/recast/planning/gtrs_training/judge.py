"""How good the planner is on samples it was not trained on, by their true scores."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from recast.planning.gtrs import ScoreWeights, final_score, training_loss
from recast.planning.gtrs_training.targets import SCORED, unpacked
from recast.planning.gtrs_training.task import GtrsTask, sum_of

Float32 = NDArray[np.float32]

FIRST_SPEED = np.zeros(1, np.int64)
"""The speed at which samples are judged: one at which the ego usually comes there."""
_BATCH = 16


@dataclass(frozen=True)
class Judgement:
    """Means over held-out samples; shares and scores in [0, 1].

    Attributes:
        samples: how many, each at one speed.
        loss: of the heads.
        gap: how much the loss grows with another sample's picture: 0 means that it is ignored.
        score: true score NC DAC DDC (5 TTC + 5 EP + 2 LK) / 12 of the chosen trajectory.
        regret: the best trajectory's score less that.
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
    safe: float
    safe_blind: float
    safe_twins: float
    slower: float

    def means(self) -> dict[str, float]:
        """What the training's log shows."""
        found = {name: float(value) for name, value in asdict(self).items() if name != "samples"}
        return {"held_out": found.pop("loss"), **found}


def true_scores(scores: NDArray[np.uint8]) -> Float32:
    """Product scores (..., L) of stored sub-scores (..., 6, L)."""
    part = dict(zip(SCORED, np.moveaxis(unpacked(scores), -2, 0), strict=True))
    average = (
        5 * part["time_to_collision_within_bound"] + 5 * part["ego_progress"]
        + 2 * part["lane_keeping"]
    ) / 12  # fmt: skip
    found: Float32 = (
        part["no_at_fault_collisions"] * part["drivable_area_compliance"]
        * part["driving_direction_compliance"] * average
    )  # fmt: skip
    return found


@torch.no_grad()
def judge(task: GtrsTask, indices: NDArray[np.int64], weights: ScoreWeights) -> Judgement:
    """Judge the model of a task, in its present mode of training, on unaltered samples.

    The model is put into evaluation mode meanwhile.

    Args:
        indices: of the samples, at least two; the first speed of each is taken.
        weights: by which it chooses.
    """
    model, store = task.model, task.store
    was_training = model.training
    model.eval()
    try:
        twin = store.twin[indices]
        with_twin = (twin >= 0) & (store.clues[indices, 0] > 0)
        chosen, loss = _choose(task, weights, indices, indices)
        _, shuffled = _choose(task, weights, indices, np.roll(indices, len(indices) // 2))
        paired = indices[with_twin]
        erased = _choose(task, weights, paired, twin[with_twin])[0] if len(paired) else chosen[:0]
    finally:
        model.train(was_training)
    scores = store.scores[indices, 0]
    true = true_scores(scores)
    rows = np.arange(len(indices))
    got = true[rows, chosen]
    safe = scores[:, 0] > 127
    in_sight = store.clues[indices, 0] > 0
    length = store.vocabulary[:, -1, 0]
    return Judgement(
        samples=len(indices),
        loss=loss,
        gap=shuffled - loss,
        score=float(got.mean()),
        regret=float((true.max(axis=1) - got).mean()),
        safe=_mean(safe[rows, chosen][in_sight]),
        safe_blind=_mean(safe[rows[with_twin], erased]),
        safe_twins=_mean(safe[rows, chosen][with_twin]),
        slower=_mean(length[erased] - length[chosen[with_twin]]),
    )


def _choose(
    task: GtrsTask, weights: ScoreWeights, indices: NDArray[np.int64], pictures: NDArray[np.int64]
) -> tuple[NDArray[np.int64], float]:
    """Chosen trajectory of each sample, seen with another's picture, and the mean loss."""
    chosen, losses = [], []
    for first in range(0, len(indices), _BATCH):
        part, seen = indices[first : first + _BATCH], pictures[first : first + _BATCH]
        images = [task.store.image(index) for index in seen]
        batch = task.gather(part, FIRST_SPEED, np.zeros(len(part), np.bool_), images)
        logits = task.model(batch.images, batch.status, batch.trajectories)
        terms = training_loss(logits, batch.targets, batch.trajectories, batch.demonstration)
        chosen.append(final_score(logits, weights).argmax(dim=1).numpy())
        losses.append(float(sum_of(terms)) * len(part))
    return np.concatenate(chosen), float(np.sum(losses) / len(indices))


def _mean(values: np.ndarray) -> float:
    """NaN where there are none; the log leaves it out."""
    return float(np.mean(values)) if len(values) else float("nan")
