"""GTRS-Dense as a planner, what it thought of every trajectory, and its folder.

Released Lightning checkpoints are read too; weights are loaded strictly.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from safetensors.torch import save
from torch import Tensor

from recast.arrays import Array, BoolArray, Float32Array, Image
from recast.cameras import CameraMount
from recast.cameras.mounts import choose_views, directions
from recast.core.errors import InputError
from recast.core.files import atomic_folder, disk_errors, write_bytes, write_json
from recast.core.records import Record, read_record
from recast.core.torch_file import read_safetensors, read_torch_file, require_state
from recast.planning.cameras import require_cameras
from recast.planning.gtrs.config import (
    WAYMO_NATIVE,
    GtrsConfig,
    MotionPrimitives,
    ViewLayout,
    network_input,
)
from recast.planning.gtrs.model import GtrsModel, empty_model
from recast.planning.gtrs.scores import (
    COMBINED,
    IMITATION,
    VOCABULARY_ONLY,
    ScoreWeights,
    Trajectories,
    check_vocabulary,
    comfortable,
    final_score,
    read_vocabulary,
    write_vocabulary,
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

_SHORT = 3.0
"""Length of a plan, metres, below which its end does not tell the road's direction: x is taken."""
_BESIDE = 0.25
"""Distance beside the road as a share of that along it: paces are blended, swerves are not."""


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
        calm: (N,) which are `comfortable`; None where the weights do not ask for it.
    """

    trajectories: Float32Array
    scores: Float32Array
    sub_scores: Mapping[str, Float32Array]
    first: int = 0
    calm: BoolArray | None = None

    def order(self) -> NDArray[np.int64]:
        """Indices that may be chosen, best first; equal scores in the vocabulary's order."""
        return np.argsort(-self.scores[self.first :], kind="stable") + self.first

    @property
    def best(self) -> int:
        """Index of the chosen trajectory."""
        return int(np.argmax(self.scores[self.first :])) + self.first

    def driven(self, blended: float) -> Array:
        """(40, 3) the best trajectory, or the mean of those near it, see `ScoreWeights`."""
        best = self.best
        ends = self.trajectories[:, -1, :2].astype(np.float64)
        length = float(np.linalg.norm(ends[best]))
        ahead = ends[best] / length if length > _SHORT else np.array([1.0, 0.0])
        along = (ends - ends[best]) @ ahead
        beside = (ends - ends[best]) @ np.array([-ahead[1], ahead[0]])
        near = (np.abs(along) < blended) & (np.abs(beside) < _BESIDE * blended)
        near[: self.first] = False
        if self.calm is not None and self.calm[best]:
            near &= self.calm  # a little of what jolts would jolt
        near[best] = True  # alone where nothing is blended, whatever else ends there
        weights = np.exp(self.scores[near].astype(np.float64) - float(self.scores[best]))
        return np.einsum("n,ntc->tc", weights / weights.sum(), self.trajectories[near])

    def top(self, count: int) -> Candidates:
        """The best trajectories, best first; fewer than `count` where there are no more."""
        chosen = self.order()[:count]
        return Candidates(
            waypoints=self.trajectories[chosen].astype(np.float64),
            scores=self.scores[chosen].astype(np.float64),
        )


class GtrsPlanner(BasePlanner):
    """Scores a vocabulary of trajectories against three camera images and drives the best.

    The chosen entry is returned as it is, unless the weights say that those near it are blended in.
    A model with a `history` remembers what it saw of the images of a rollout, and looks again at
    the one that is nearest to so many seconds ago, if it is at most half of that off. Nothing
    else is remembered from one cycle to the next, but for what depends on a vocabulary alone, which
    is computed once.

    Args:
        model: model in evaluation mode, on the device it shall run on.
        vocabulary: (L, 40, 3) trajectories, see `read_vocabulary`, or primitives that go with the
            ego's state.
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
        vocabulary: Trajectories | MotionPrimitives,
        views: ViewLayout,
        *,
        name: str = "gtrs",
        weights: ScoreWeights = VOCABULARY_ONLY,
        top_k: int = 10,
    ) -> None:
        self.name = name
        self.model = model
        self.vocabulary = (
            vocabulary
            if isinstance(vocabulary, MotionPrimitives)
            else check_vocabulary(name, vocabulary)
        )
        self.views = views
        self._fitted = views
        self.weights = weights
        self.top_k = top_k
        self.device = str(model.device)
        self._seen: dict[int, Tensor] = {}  # features by log time
        # Left, front and right picture of any rig; of nuPlan's, its cameras of these names.
        self.wanted_views = views.views
        self.camera_names = None if views.views else views.cameras

    def __deepcopy__(self, memo: dict[int, Any]) -> GtrsPlanner:
        """An independent planner with the same network, which no rollout changes."""
        other = copy(self)
        other._seen = dict(self._seen)
        return other

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
        self._seen = {}
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
            waypoints=decision.driven(self.weights.blended),
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
        trajectories, weights = self._possible(status), self.weights
        if proposals is not None:
            extra = check_vocabulary(f"{self._who}, proposals", np.asarray(proposals))
            trajectories, weights = np.concatenate([trajectories, extra]), COMBINED
        elif proposals_only:
            raise ValueError("GtrsPlanner.decide: proposals_only needs proposals")
        features = self._features([stitched])
        earlier = self._remembered(features, observation.timestamp_us)
        decision = self._scored(features, status, trajectories, weights, earlier)
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

    def _remembered(self, features: Tensor, time: int) -> tuple[Tensor, float] | None:
        """The features of the earlier image and its age in seconds, if there was one; those of a
        time are kept."""
        history = self.model.config.history
        if history is None:
            return None
        ages = {1e-6 * (time - one): kept for one, kept in self._seen.items()}
        looked_at = self.model.config.ages(ages)
        # A second look at a moment, such as at a disturbed image, changes no memory of it.
        self._seen.setdefault(time, features)
        self._seen = {one: kept for one, kept in self._seen.items() if one > time - 1.6e6 * history}
        return (ages[looked_at[0]], looked_at[0]) if looked_at else None

    @torch.no_grad()
    def judge(
        self, seen: Sequence[Image], status: Float32Array, every: float = 0.5
    ) -> GtrsDecision:
        """Score the vocabulary against pictures, without a rollout.

        Args:
            seen: (H, W, 3) uint8 pictures, see `ViewLayout.stitch`, the present one last; earlier
                ones matter to a model with a history alone.
            status: (8,), see `ego_status`.
            every: seconds between the pictures.

        Raises:
            InputError: the network's answer is not finite.
        """
        ages = {every * back: one for back, one in enumerate(reversed(seen)) if back}
        looked_at = self.model.config.ages(ages)[:1]
        now, *before = self._features([seen[-1], *(ages[age] for age in looked_at)]).split(1)
        earlier = (before[0], looked_at[0]) if looked_at else None
        return self._scored(now, status, self._possible(status), self.weights, earlier)

    def _possible(self, status: Float32Array) -> Trajectories:
        if isinstance(self.vocabulary, MotionPrimitives):
            return self.vocabulary.trajectories(status[None])[0]
        return self.vocabulary

    @torch.no_grad()
    def _features(self, pictures: Sequence[Image]) -> Tensor:
        # Channels last, as the pictures come: the small model takes a fifth less on a CPU.
        images = torch.stack([network_input(one) for one in pictures])
        images = images.contiguous(memory_format=torch.channels_last)
        return self.model.backbone(images.to(self.model.device))

    @torch.no_grad()
    def _scored(
        self,
        features: Tensor,
        status: Float32Array,
        trajectories: Trajectories,
        weights: ScoreWeights,
        earlier: tuple[Tensor, float] | None,
    ) -> GtrsDecision:
        device = self.model.device
        before = () if earlier is None else (earlier[0], torch.tensor([earlier[1]], device=device))
        logits = self.model.score(
            self.model.look(features, *before),
            torch.from_numpy(status)[None].to(device),
            torch.from_numpy(trajectories).to(device),
        )
        calm = comfortable(trajectories, status) if weights.comfort > 0 else None
        known = None if calm is None else torch.from_numpy(calm).to(device)
        scores = final_score(logits, weights, known)
        sub_scores = {
            name: _numpy(value.softmax(-1) if name == IMITATION else value.sigmoid())
            for name, value in logits.items()
        }
        decision = GtrsDecision(trajectories, _numpy(scores), sub_scores, calm=calm)
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


PREFIX = "agent.model."
"""Before every name in a released Lightning checkpoint."""

VOCABULARY = "_trajectory_head.vocab"
"""The training vocabulary inside a checkpoint; it is not part of the model."""

UNUSED = ("_query_embedding.", "_tf_decoder.", "_agent_head.")
"""Beginnings of names that released checkpoints hold and the model never uses."""

_PICKLES = (b"PK\x03\x04", b"\x80")
_MEND = "download or write the file again, or give the network sizes that it was made with"
CONFIG_FILE = "config.json"
WEIGHTS_FILE = "weights.safetensors"
VOCABULARY_FILE = "vocabulary.npy"

_MEND_FOLDER = "write the folder again with save_gtrs"
CHECKPOINT, VOCABULARY_OF_RELEASE, PLANNER = "gtrs_dense_vov.ckpt", "8192.npy", "planner"


class _Config(Record):
    """`config.json`."""

    format: Literal["recast-gtrs"]
    version: Literal[1]
    name: str = Field(pattern=r"^[\w.+~-]+$")  # stands in file names
    model: GtrsConfig
    views: ViewLayout
    scoring: ScoreWeights
    primitives: MotionPrimitives | None = None  # in place of vocabulary.npy


def save_gtrs(folder: str | Path, planner: GtrsPlanner, dtype: torch.dtype = torch.float32) -> None:
    """Write a planner as a folder, whole or not at all. The same weights give the same bytes.

    Args:
        dtype: floating-point type of the stored weights; float16 halves the file and rounds.

    Raises:
        InputError: the folder exists, or the disk is full.
    """
    own = planner.vocabulary
    config = _Config(
        format="recast-gtrs",
        version=1,
        name=planner.name,
        model=planner.model.config,
        views=planner.views,
        scoring=planner.weights,
        primitives=own if isinstance(own, MotionPrimitives) else None,
    )
    tensors = {
        name: (tensor.to(dtype) if tensor.is_floating_point() else tensor).detach().cpu()
        for name, tensor in planner.model.state_dict().items()
    }
    with atomic_folder(folder) as partial:
        record: dict[str, Any] = config.model_dump(mode="json")
        write_json(partial / CONFIG_FILE, record)
        if not isinstance(own, MotionPrimitives):
            write_vocabulary(partial / VOCABULARY_FILE, own)
        # Through bytes: safetensors' own writer reports a full disk in a way of its own.
        write_bytes(partial / WEIGHTS_FILE, save({k: v.contiguous() for k, v in tensors.items()}))


def load_gtrs(folder: str | Path, device: str | torch.device = "cpu") -> GtrsPlanner:
    """Read a planner that `save_gtrs` wrote.

    Raises:
        InputError: a file is missing or wrong, a member of the configuration is unknown or out of
            range, or the weights do not have the sizes that it says.
    """
    folder = Path(folder)
    config = read_record(folder / CONFIG_FILE, _Config, 1, _MEND_FOLDER, "recast-gtrs")
    possible: Trajectories | MotionPrimitives | None = config.primitives
    if possible is None:
        possible = read_vocabulary(folder / VOCABULARY_FILE)
    model = empty_model(config.model)
    load_weights(model, read_weights(folder / WEIGHTS_FILE), folder / WEIGHTS_FILE, device)
    return GtrsPlanner(model, possible, config.views, name=config.name, weights=config.scoring)


def load_checkpoint(
    path: str | Path,
    vocabulary: str | Path | None = None,
    views: ViewLayout = WAYMO_NATIVE,
    *,
    config: GtrsConfig | None = None,
    device: str | torch.device = "cpu",
    name: str = "gtrs-dense",
) -> GtrsPlanner:
    """Read a released GTRS-Dense checkpoint, or weights with the same names as safetensors.

    `save_gtrs` makes a folder of it that needs no pickle any more.

    Args:
        path: Lightning checkpoint (`.ckpt`), state dict (`.pth`) or safetensors.
        vocabulary: `.npy` file, such as the released 8192 trajectories; None takes those in the
            checkpoint, with which it was trained.
        config: sizes; None for the released ones.
        name: name of the planner, for tables and messages.

    Raises:
        InputError: see `read_weights`, `load_weights` and `read_vocabulary`; or no vocabulary is
            given and the checkpoint has none.
    """
    tensors = read_weights(path)
    if vocabulary is not None:
        trajectories = read_vocabulary(vocabulary)
    elif VOCABULARY in tensors:
        trajectories = check_vocabulary(path, tensors[VOCABULARY])
    else:
        raise InputError(path, VOCABULARY, "is missing", "give a vocabulary file")
    model = empty_model(config or GtrsConfig())
    load_weights(model, tensors, path, device)
    return GtrsPlanner(model, trajectories, views, name=name, weights=VOCABULARY_ONLY)


def convert_release(folder: Path) -> None:
    """Write `planner/` from the files in a folder; see `load_checkpoint` and `save_gtrs`."""
    planner = load_checkpoint(folder / CHECKPOINT, folder / VOCABULARY_OF_RELEASE)
    shutil.rmtree(folder / PLANNER, ignore_errors=True)  # of a try that was killed
    save_gtrs(folder / PLANNER, planner)


def read_weights(path: str | Path) -> dict[str, Tensor]:
    """All tensors of a file by name, without the prefix of released checkpoints, on the CPU.

    A PyTorch file may hold a state dict or have one under "state_dict". Nothing but tensors and
    plain values is unpickled (`weights_only`).

    Raises:
        InputError: the file is missing, cannot be read, or holds other objects.
    """
    path = Path(path)
    with disk_errors(path), path.open("rb") as file:
        pickled = file.read(4).startswith(_PICKLES)
    tensors = _read_pytorch(path) if pickled else read_safetensors(path, "file", _MEND)[0]
    bare = {name.removeprefix(PREFIX): tensor for name, tensor in tensors.items()}
    if len(bare) < len(tensors):
        raise InputError(
            path, PREFIX, "is the prefix of some names that also appear without it", _MEND
        )
    return bare


def load_weights(
    model: GtrsModel,
    tensors: Mapping[str, Tensor],
    where: str | Path,
    device: str | torch.device = "cpu",
) -> None:
    """Copy weights into a model, which may be on the meta device; every name and shape must agree.

    Floating-point types are converted to the model's. The vocabulary and the unused modules of
    released checkpoints are passed over. Afterwards the model is on `device` and in evaluation
    mode.

    Raises:
        InputError: a tensor is missing, unexpected, of another shape or kind, or not finite. The
            line names the first and counts all.
    """
    given = {k: v for k, v in tensors.items() if k != VOCABULARY and not k.startswith(UNUSED)}
    require_state(where, given, model.state_dict(), _MEND)
    if model.device.type == "meta":
        model.to_empty(device=device)
    model.to(device).load_state_dict(given)
    model.eval()


def _read_pytorch(path: Path) -> dict[str, Tensor]:
    content = read_torch_file(path, _MEND)
    if isinstance(content, Mapping) and isinstance(content.get("state_dict"), Mapping):
        content = content["state_dict"]
    if not isinstance(content, Mapping) or not content:
        raise InputError(path, "state_dict", "is missing", "give a Lightning or PyTorch checkpoint")
    for name, value in content.items():
        if not isinstance(name, str) or not isinstance(value, Tensor):
            raise InputError(
                path,
                str(name),
                f"is {type(value).__name__}, not a tensor",
                "give a Lightning or PyTorch checkpoint",
            )
    return dict(content)
