"""What a scene-level evaluation is asked to do, and which images of the drives count in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.cameras import CameraMount
from recast.core.artefact import file_hash, folder_hash
from recast.core.errors import InputError, require_range
from recast.geometry import se3
from recast.metrics.scene_level.frames import FrameRule, RolloutFrame, visible_share
from recast.reconstruction.scores import Rectangle
from recast.runs.sources import vqa_source
from recast.scene import SceneRasterizer, StreetScene
from recast.simulation import Rollout
from recast.studies.grid import BenchSettings
from recast.synthetic import Oracle, World

Depth = NDArray[np.float32]
DepthOf = Callable[[CameraMount, Array, Rectangle], Depth]
"""Depth (H, W) in metres along z of a street without the target: from a mount, at
`world_from_camera` (4, 4), for points inside of a rectangle at least; inf for the sky."""

LEVEL_FORMAT, LEVEL_VERSION = "recast-scene-level", 1
DRIVER = "pdm-closed"
"""Planner that drives each trajectory once, for all arms (paper, section 5, Q2)."""
LEVEL_MOTIONS = ("cut-in", "oncoming", "stationary", "advancing")
"""The paper's four, with both settings each."""
_FILES = ("inception", "clip", "lpips")
"""Networks that are named by a path."""
_SOLID = 0.5
"""Opacity from which a street hides what lies behind it."""


@dataclass(frozen=True)
class NetworkFiles:
    """Weights of the networks; a score whose network is not given has no column.

    Attributes:
        inception: weights file, see `load_inception`.
        lpips: ImageNet weights of AlexNet or VGG-16, see `load_lpips`.
        vqa: what `load_vqa_scorer` takes as text.
        clip: folder of a CLIP model.
        device: device that the networks compute on: cpu, cuda or cuda:1.
    """

    inception: Path | None = None
    clip: Path | None = None
    lpips: Path | None = None
    vqa: str | None = None
    device: str = "cpu"

    def hashes(self) -> dict[str, str]:
        """What stands for each network that is given, in keys and results.

        Raises:
            InputError: a file is missing, or the VQA scorer is unknown.
        """
        found = {}
        for name in _FILES:
            path = getattr(self, name)
            if path is not None and not path.exists():
                raise InputError(path, name, "is missing", "give a file or folder that exists")
            if path is not None:
                found[name] = folder_hash(path) if path.is_dir() else file_hash(path)
        if self.vqa is not None:
            found["vqa"] = vqa_source(self.vqa)
        return found


@dataclass(frozen=True)
class LevelSettings:
    """A scene-level evaluation.

    Attributes:
        grid: scenes, motions and arms (the first is the baseline); its one planner is `DRIVER`.
        rule, hashes: when an image counts; hashes of the networks' files by name.
        crop: "boxed" keeps the background around the vehicle, "masked" takes away what lies outside
            of the box's outline.
        most_references: logged crops of a scene that LPIPS and the CLIP image score compare with.
        frechet_samples: bootstrap samples of Frechet distances; the other scores' are the grid's.
    """

    grid: BenchSettings
    rule: FrameRule
    crop: Literal["boxed", "masked"]
    most_references: int
    networks: NetworkFiles
    hashes: Mapping[str, str]
    frechet_samples: int

    def __post_init__(self) -> None:
        run = self.grid.run.model_copy(update={"planners": (DRIVER,), "films": False})
        object.__setattr__(self, "grid", replace(self.grid, run=run))

    def absolute(self) -> Self:
        """The same with absolute paths of logs and weights, see `BenchSettings.absolute`."""
        files = {
            name: path.absolute()
            for name in _FILES
            if (path := getattr(self.networks, name)) is not None
        }
        return replace(self, grid=self.grid.absolute(), networks=replace(self.networks, **files))

    def validate(self) -> None:
        """Raise InputError naming the setting at fault."""
        self.rule.validate()
        require_range(1, references=self.most_references, frechet_samples=self.frechet_samples)

    def record(self) -> dict[str, Any]:
        """What makes this evaluation another than others: plain data."""
        return {
            **self.grid.record(),
            "format": LEVEL_FORMAT,
            "version": LEVEL_VERSION,
            "rule": asdict(self.rule),
            "crop": self.crop,
            "most_references": self.most_references,
            "networks": dict(self.hashes),
            "frechet_samples": self.frechet_samples,
        }


def visible_frames(
    rollouts: Sequence[Rollout],
    mounts: Mapping[str, CameraMount],
    rule: FrameRule,
    depths: Sequence[DepthOf],
) -> Iterator[RolloutFrame]:
    """Images that count, by rollout, step and camera: no street hides the vehicle in them.

    Args:
        depths: depth functions of every street that an arm uses.
    """
    for rollout in rollouts:
        size = rollout.actor_size
        for step in range(0, rollout.steps_run, rule.every):
            for name, mount in mounts.items():
                world_from_camera = rollout.world_from_rig[step] @ mount.rig_from_camera
                seen_from = se3.inverse(world_from_camera) @ rollout.world_from_actor[step]
                rectangle = rule.rectangle(size, seen_from, mount.camera)
                if rectangle is None:
                    continue
                shares = (
                    visible_share(
                        depth(mount, world_from_camera, rectangle), size, seen_from, mount.camera
                    )
                    for depth in depths
                )
                if all(share >= rule.least_visible for share in shares):
                    yield RolloutFrame(rollout.motion, rollout.setting, step, name, rectangle)


def street_depth(street: StreetScene, track_id: str) -> DepthOf:
    """Depth of a reconstructed street without a track."""
    others = {key: one for key, one in street.actors.items() if key != track_id}
    rasterizer = SceneRasterizer(replace(street, actors=others))

    def depth(mount: CameraMount, world_from_camera: Array, rectangle: Rectangle) -> Depth:
        del rectangle
        image = rasterizer.render(mount.camera, se3.inverse(world_from_camera), {})
        solid = image.alpha > _SOLID
        return np.where(solid, image.depth / np.where(solid, image.alpha, 1), np.float32(np.inf))

    return depth


def true_depth(world: World, track_id: str) -> DepthOf:
    """Depth of a synthetic world without a track."""
    oracle = Oracle(world)
    underground = np.eye(4)
    underground[2, 3] = -1000.0
    # A parked vehicle is part of the world, so it is put where no ray meets it.
    poses = {track_id: underground} if world.vehicles[track_id].parked else {}

    def depth(mount: CameraMount, world_from_camera: Array, rectangle: Rectangle) -> Depth:
        left, top, right, bottom = rectangle
        window = mount.camera.cropped(left, top, right - left, bottom - top)
        frame = oracle.render(window, world_from_camera, poses)
        return frame.within(mount.camera.width, mount.camera.height, left, top).depth

    return depth
