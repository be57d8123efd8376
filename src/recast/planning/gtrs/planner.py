"""GTRS-Dense as a planner, and what it thought: a score for every trajectory, not only the best."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from recast.arrays import Float32Array
from recast.cameras import CameraMount
from recast.cameras.mounts import choose_views, directions
from recast.core.errors import InputError
from recast.dynamics.tracker import comfortable_plans
from recast.planning.cameras import require_cameras
from recast.planning.gtrs.config import ViewLayout, network_input
from recast.planning.gtrs.head import IMITATION
from recast.planning.gtrs.model import GtrsModel
from recast.planning.gtrs.scores import (
    COMBINED,
    VOCABULARY_ONLY,
    ScoreWeights,
    Trajectories,
    check_vocabulary,
    final_score,
)
from recast.planning.types import (
    BasePlanner,
    Candidates,
    Plan,
    PlannerInput,
    PlanningContext,
    ego_status,
)

_DT = 0.1


@dataclass(frozen=True)
class GtrsDecision:
    """Scores of all trajectories at one moment.

    Attributes:
        trajectories: (N, 40, 3) x, y, heading of the rear axle in the present ego frame; the
            vocabulary, and behind it the external proposals, where there were any.
        scores: (N,) log scores, see `final_score`.
        sub_scores: (N,) expected sub-scores in [0, 1], by head; of "imi", the probability that a
            human drives the trajectory.
        first: index from which on trajectories may be chosen; those before are only scored.
    """

    trajectories: Float32Array
    scores: Float32Array
    sub_scores: Mapping[str, Float32Array]
    first: int = 0

    def order(self) -> NDArray[np.int64]:
        """Indices that may be chosen, best first; equal scores in the vocabulary's order."""
        return np.argsort(-self.scores[self.first :], kind="stable") + self.first

    @property
    def best(self) -> int:
        """Index of the chosen trajectory."""
        return int(np.argmax(self.scores[self.first :])) + self.first

    def top(self, count: int) -> Candidates:
        """The best trajectories, best first; fewer than `count` where there are no more."""
        chosen = self.order()[:count]
        return Candidates(
            waypoints=self.trajectories[chosen].astype(np.float64),
            scores=self.scores[chosen].astype(np.float64),
        )


class GtrsPlanner(BasePlanner):
    """Scores a vocabulary of trajectories against three camera images and drives the best.

    The chosen entry is returned as it is: not smoothed, not blended. Nothing is remembered from one
    cycle to the next, but for what depends on the vocabulary alone, which is computed once.

    Args:
        model: model in evaluation mode, on the device it shall run on.
        vocabulary: (L, 40, 3) trajectories, see `read_vocabulary`.
        views: layout of the pictures: which ones, and how they are stitched; of another size in the
            same proportion, they are stitched alike.
        name: name of the planner, for tables and messages.
        weights: weights of the final score, where only the vocabulary is scored.
        top_k: how many candidates a plan carries beside the best.

    Raises:
        InputError: the vocabulary is no vocabulary.
    """

    needs_images = True

    def __init__(
        self,
        model: GtrsModel,
        vocabulary: Trajectories,
        views: ViewLayout,
        *,
        name: str = "gtrs",
        weights: ScoreWeights = VOCABULARY_ONLY,
        top_k: int = 10,
    ) -> None:
        self.name = name
        self.model = model
        self.vocabulary = check_vocabulary(name, vocabulary)
        self.views = views
        self._fitted = views
        self.weights = weights
        self.top_k = top_k
        self.device = str(model.device)
        # Left, front and right picture of any rig; of nuPlan's, its cameras of these names.
        self.wanted_views = views.views
        self.camera_names = None if views.views else views.cameras

    def __deepcopy__(self, memo: dict[int, Any]) -> GtrsPlanner:
        """An independent planner with the same network, which no rollout changes."""
        return copy(self)

    @property
    def _who(self) -> str:
        return f"planner {self.name}"

    def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
        """The cameras, real or virtual, that show the left, the front and the right picture.

        Raises:
            InputError: no camera shows one of them, or see `ViewLayout.fitted`.
        """
        return dict(zip(self.views.cameras, self._fit(mounts).cameras, strict=True))

    def reset(self, context: PlanningContext) -> None:
        """Check that the rollout gives what the planner needs, and leave training mode.

        Raises:
            InputError: see `choose_cameras`; or waypoints are not 0.1 s apart.
        """
        self._fitted = self._fit(context.cameras)
        if abs(context.dt - _DT) > 1e-9:
            raise InputError(
                self._who,
                "dt",
                f"is {context.dt:g} s, but the planner's trajectories have a pose every {_DT} s",
                "simulate with dt 0.1",
            )
        self.model.eval()

    def plan(self, observation: PlannerInput) -> Plan:
        """The best trajectory, with the next best as `candidates` and its sub-scores as `info`.

        Raises:
            InputError: see `decide`.
        """
        decision = self.decide(observation)
        best = decision.best
        return Plan(
            waypoints=decision.trajectories[best].astype(np.float64),
            info={
                "index": float(best),
                "score": float(decision.scores[best]),
                "command": str(observation.command),
                **{name: float(values[best]) for name, values in decision.sub_scores.items()},
            },
            candidates=decision.top(self.top_k),
        )

    def decide(
        self,
        observation: PlannerInput,
        proposals: ArrayLike | None = None,
        *,
        proposals_only: bool = False,
    ) -> GtrsDecision:
        """Score every trajectory.

        Args:
            observation: planner input; its images, command and ego state are used.
            proposals: (N, 40, 3) trajectories of another planner in the present ego frame. They are
                scored together with the vocabulary, with the weights of the combined mode.
            proposals_only: choose among the proposals; the vocabulary is still scored with them.

        Raises:
            InputError: a camera is missing, an image has another size, the ego state is not finite,
                the proposals are no trajectories, or the network's answer is not finite.
        """
        stitched = self._fitted.stitch(observation.images, self._who)
        status = ego_status(observation.command, observation.ego)
        if not np.isfinite(status).all():
            raise InputError(
                self._who, "ego state", "holds NaN or infinite values", "check the ego controller"
            )
        trajectories, weights = self.vocabulary, self.weights
        if proposals is not None:
            extra = check_vocabulary(f"{self._who}, proposals", np.asarray(proposals))
            trajectories, weights = np.concatenate([trajectories, extra]), COMBINED
        elif proposals_only:
            raise ValueError("GtrsPlanner.decide: proposals_only needs proposals")
        decision = self._score(stitched, status, trajectories, weights)
        return replace(decision, first=len(self.vocabulary)) if proposals_only else decision

    def _fit(self, mounts: Mapping[str, CameraMount]) -> ViewLayout:
        """The layout with the rig's names and sizes."""
        chosen = choose_views(self.wanted_views, mounts)
        for view in self.wanted_views:
            if view.name not in chosen:
                raise InputError(
                    self._who,
                    f"view {view.name}",
                    f"is {view.look} at {view.camera.width}:{view.camera.height}, but no camera "
                    "shows it",
                    f"add recast.planning.virtual_mounts; there are {directions(mounts)}",
                )
        names = tuple(chosen.get(name, name) for name in self.views.cameras)
        require_cameras(names, mounts, self._who)
        cameras = {
            view: mounts[name].camera for view, name in zip(self.views.cameras, names, strict=True)
        }
        sizes = {view: (camera.width, camera.height) for view, camera in cameras.items()}
        return self.views.fitted(sizes, self._who).model_copy(update={"cameras": names})

    @torch.no_grad()
    def _score(
        self,
        stitched: np.ndarray,
        status: np.ndarray,
        trajectories: Trajectories,
        weights: ScoreWeights,
    ) -> GtrsDecision:
        device = self.model.device
        logits = self.model(
            network_input(stitched)[None].to(device),
            torch.from_numpy(status)[None].to(device),
            torch.from_numpy(trajectories).to(device),
        )
        comfortable = None
        if weights.comfort > 0:
            comfortable = torch.from_numpy(comfortable_plans(trajectories)).to(device)
        scores = final_score(logits, weights, comfortable)
        sub_scores = {
            name: _numpy(value.softmax(-1) if name == IMITATION else value.sigmoid())
            for name, value in logits.items()
        }
        decision = GtrsDecision(trajectories, _numpy(scores), sub_scores)
        if not np.isfinite(decision.scores).all():
            bad = ~np.isfinite(decision.scores)
            raise InputError(
                self._who,
                "scores",
                f"are NaN or infinite ({int(bad.sum())} of {len(bad)})",
                "check the weights: the images and the ego state are finite",
            )
        return decision


def _numpy(batch_of_one: Tensor) -> np.ndarray:
    return batch_of_one[0].float().cpu().numpy()
