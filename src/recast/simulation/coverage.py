"""How much of what the cameras of a rollout saw of the actor was seen, mirrored or invented."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from recast.actors.actor import LEAST_PIXELS, Coverage
from recast.arrays import Array
from recast.cameras import CameraMount, PinholeCamera
from recast.geometry import se3
from recast.simulation.history import other_poses
from recast.simulation.rollout import Rollout
from recast.simulation.setup import RolloutSetup

SHARES = ("seen", "mirrored", "invented")
_MOST_STEPS = int(1e9)  # as many as a rollout may have


class Meter(Protocol):
    """Measures one image, see `recast.actors.actor.CoverageMeter`."""

    def measure(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        shown: NDArray[np.bool_] | None = None,
    ) -> Coverage:
        """Coverage of the actor when all actors stand at `poses`."""


@dataclass(frozen=True)
class ImageCoverage:
    """The coverage in one image.

    Attributes:
        camera: name of the camera.
        step: step of the rollout.
        planned: whether the planner was given this image.
        coverage: coverage of the actor; its pixels are 0 where the image does not show it.
    """

    camera: str
    step: int
    planned: bool
    coverage: Coverage


@dataclass(frozen=True)
class RolloutCoverage:
    """The coverage in the images of a rollout at its plan steps, by step, then by camera."""

    images: tuple[ImageCoverage, ...]

    @property
    def of_planner(self) -> RolloutCoverage | None:
        """Of the images that the planner was given; None for one that looks at none."""
        given = tuple(image for image in self.images if image.planned)
        return RolloutCoverage(given) if given else None

    @property
    def visible(self) -> int:
        """Number of images that show the actor."""
        return sum(image.coverage.pixels > 0 for image in self.images)

    @property
    def mean(self) -> Coverage:
        """Mean area where the actor is visible, and shares of all its pixels in all images."""
        return Coverage.mean(image.coverage for image in self.images)

    def by_step(self) -> tuple[NDArray[np.int64], Array]:
        """Steps (M,) at which some image shows the actor, and shares (M, 3) of its pixels there."""
        steps = sorted({image.step for image in self.images})
        means = {
            step: Coverage.mean(i.coverage for i in self.images if i.step == step) for step in steps
        }
        shown = {step: mean for step, mean in means.items() if mean.pixels > 0}
        shares = [[getattr(mean, name) for name in SHARES] for mean in shown.values()]
        return np.array(list(shown), np.int64), np.array(shares).reshape(-1, len(SHARES))

    def to_json(self) -> dict[str, Any]:
        """Means over all images, and over those of the planner (None for one that has none)."""
        given = self.of_planner
        return {"all": self._means(), "planner": None if given is None else given._means()}

    def _means(self) -> dict[str, float]:
        return {"images": len(self.images), "visible": self.visible, **asdict(self.mean)}

    def validate(self) -> None:
        """Raise ValueError naming the image and the value at fault."""
        for row, image in enumerate(self.images):
            one = image.coverage
            shares = np.array([getattr(one, name) for name in SHARES])
            if not 0 <= image.step < _MOST_STEPS:
                raise ValueError(f"row {row}: step {image.step} is out of range")
            if not (one.pixels == 0 or LEAST_PIXELS <= one.pixels < np.inf):
                raise ValueError(f"row {row}: {one.pixels} pixels are out of range")
            total = 1.0 if one.pixels else 0.0
            if not (np.all((shares >= 0) & (shares <= 1)) and abs(shares.sum() - total) < 1e-5):
                raise ValueError(
                    f"row {row}: shares {shares.tolist()} of {one.pixels:g} pixels are not "
                    f"within 0 and 1, or their sum is not {total:g}"
                )


def rollout_coverage(
    rollout: Rollout,
    setup: RolloutSetup,
    meter: Meter,
    mounts: Mapping[str, CameraMount],
    recorded: Sequence[str],
    given: Sequence[str],
) -> RolloutCoverage:
    """Measure a rollout after it was run, from its poses alone.

    Only at the steps at which the planner plans. There it costs a twenty-fifth of what a filmed
    rollout costs; at every step it would cost a fifth.

    Args:
        setup: what it was run with.
        mounts: cameras as they were rendered; one with distortion is measured without.
        recorded: names of the cameras of the films.
        given: names of the planner's cameras.
    """
    images = []
    for step in rollout.plan_steps.tolist():
        poses = other_poses(setup, rollout.timestamp_us(step))
        poses |= {one.track_id: one.world_from_actor[step] for one in rollout.controlled}
        poses[rollout.track_id] = rollout.world_from_actor[step]
        for name in dict.fromkeys((*recorded, *given)):
            mount = mounts[name]
            camera_from_world = se3.inverse(rollout.world_from_rig[step] @ mount.rig_from_camera)
            found = meter.measure(mount.camera.rectified(), camera_from_world, poses, mount.seen)
            images.append(ImageCoverage(name, step, name in given, found))
    return RolloutCoverage(tuple(images))
