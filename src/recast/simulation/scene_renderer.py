"""What needs torch in a rollout: images of a street scene, and what they showed of the actor."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.actors.actor import LEAST_PIXELS, Coverage
from recast.arrays import Array, Image
from recast.cameras import CameraMount, Lens, PinholeCamera
from recast.core.errors import InputError
from recast.core.foreign import whole
from recast.geometry import se3
from recast.scene.street_scene import GapMeter, SceneRasterizer, StreetScene, ViewGaps
from recast.simulation.renderer import BaseRenderer, MountedRenderer, SensorRenderer
from recast.simulation.rollout import Rollout, SimState
from recast.splats import Window


class SceneRenderer(MountedRenderer):
    """Renders a reconstructed street scene.

    Args:
        scene: scene in the log's world frame; must hold the controlled actors.
        mounts: cameras to render, see `camera_mounts`.
        device: device to render on, see `SceneRasterizer`.
        absent: tracks that are not drawn, wherever they are.
    """

    def __init__(
        self,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        device: str = "auto",
        absent: Collection[str] = (),
    ) -> None:
        kept = {key: actor for key, actor in scene.actors.items() if key not in absent}
        scene = scene if len(kept) == len(scene.actors) else replace(scene, actors=kept)
        self.scene, self._absent = scene, frozenset(absent)
        self.rasterizer = SceneRasterizer(scene, device)
        super().__init__(mounts)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the scene with its actors at the poses of `state`.

        Raises:
            InputError: the scene has no model of a controlled actor.
        """
        poses = self.poses(state)
        images = {}
        for name in camera_names:
            mount = self._mounts[name]
            source = mount.source or name
            rig_from_camera = self.scene.mounted(
                mount.rig_from_camera, source, state.timestamp_us, state.log_mounts.get(source)
            )
            camera_from_world = se3.inverse(state.world_from_rig @ rig_from_camera)
            image = draw_image(
                self.rasterizer,
                mount.camera,
                camera_from_world,
                poses,
                state.timestamp_us,
                mount.window,
                self.scene.exposure(source, state.timestamp_us),
            )
            images[name] = mount.framed(image)
        return images

    def poses(self, state: SimState) -> dict[str, Array]:
        """`world_from_actor` (4, 4) of the actors that are drawn, by track id.

        Raises:
            InputError: the scene has no model of a controlled actor.
        """
        for track_id in state.actors:
            if track_id not in self.scene.actors and track_id not in self._absent:
                there = ", ".join(self.scene.actors) or "none"
                raise InputError(
                    "scene",
                    f"actor {track_id}",
                    "has no model in the scene",
                    f"reconstruct or insert the actor first; the scene has models of {there}",
                )
        # Other tracks that the scene modelled as background cannot be moved or drawn apart.
        poses = {key: pose for key, pose in state.poses.items() if key in self.scene.actors}
        refined = self.scene.actor_poses(state.timestamp_us) if state.log_mounts else {}
        return poses | {key: refined[key] for key in poses if key in refined}


def draw_image(
    rasterizer: SceneRasterizer,
    camera: PinholeCamera,
    camera_from_world: Array,
    poses: Mapping[str, Array],
    timestamp_us: int,
    window: Window | None = None,
    exposure: Tensor | None = None,
) -> Image:
    """An image (height, width, 3) uint8 RGB of a rectified camera; see `SceneRasterizer.draw`.

    Args:
        timestamp_us: time of the recording whose shapes deformable actors have.
        window: the part of the image to draw; None for all of it.
        exposure: change (3, 4) of the image's colours, see `StreetScene.exposure`.
    """
    drawn = rasterizer.draw(
        camera,
        camera_from_world,
        poses,
        shapes_us=timestamp_us,
        window=window,
        exposure=exposure,
    )
    # Quantised where it was drawn: a quarter of the bytes to bring over.
    return (drawn.rgb * 255).round().to(torch.uint8).cpu().numpy()


class LensRenderer(MountedRenderer):
    """Renders what another renderer cannot.

    Each distorted camera is rendered a little wider and without distortion, then the image is bent;
    one with a wide field of view is put together from several images, see `Lens.faces`. Where no
    camera of the log looks (see `CameraMount.seen`), virtual ones are black.

    Args:
        renderer: renderer of pinhole cameras; has the mounts that `pinhole_mounts` gives for each
            of `mounts`.
        mounts: the cameras as they shall be.
    """

    def __init__(self, renderer: SensorRenderer, mounts: Mapping[str, CameraMount]) -> None:
        super().__init__(mounts)
        self._renderer = whole(renderer, BaseRenderer)
        self._parts = {name: tuple(pinhole_mounts(name, mount)) for name, mount in mounts.items()}

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images of the named cameras; raises what the inner renderer raises."""
        parts = [part for name in camera_names for part in self._parts[name]]
        drawn = self._renderer.render(state, parts)
        images = {}
        for name in camera_names:
            mount, own = self._mounts[name], [drawn[part] for part in self._parts[name]]
            image = own[0] if mount.camera.is_rectified else _lens(mount.camera).bend(*own)
            images[name] = image if mount.seen is None else image * mount.seen[..., None]
        return images

    def close(self) -> None:
        """Close the inner renderer."""
        self._renderer.close()


def pinhole_mounts(name: str, mount: CameraMount) -> dict[str, CameraMount]:
    """The rectified cameras that a camera's image is put together from, by name; the first has the
    camera's own name."""
    if mount.camera.is_rectified:
        return {name: replace(mount, seen=None)}
    mounts = {}
    for index, face in enumerate(_lens(mount.camera).faces):
        turn = se3.from_rotation_translation(face.face_from_lens.T, np.zeros(3))
        source = name if index and mount.source is None else mount.source
        own = f"{name}, face {index}" if index else name
        mounts[own] = CameraMount(face.camera, mount.rig_from_camera @ turn, None, source)
    return mounts


def through_lenses(
    mounts: Mapping[str, CameraMount],
    make: Callable[[Mapping[str, CameraMount]], SensorRenderer],
) -> SensorRenderer:
    """A renderer of cameras of which some may have distortion, such as `nuplan_rig`, or be virtual.

    Args:
        mounts: cameras to render.
        make: gives a renderer of pinhole cameras for mounts. Where no camera has distortion and
            none is virtual, its renderer is returned as it is.
    """
    if all(mount.camera.is_rectified and mount.seen is None for mount in mounts.values()):
        return make(mounts)
    sources = {
        k: v for name, mount in mounts.items() for k, v in pinhole_mounts(name, mount).items()
    }
    return LensRenderer(make(sources), mounts)


@lru_cache(maxsize=4)
def _lens(camera: PinholeCamera) -> Lens:
    # A map over all pixels: shared by cameras of one make, and by the rollouts of a run.
    return Lens(camera)


GAPS_EVERY = 5
"""Every n-th plan step is measured: half a second apart at 10 Hz."""


@dataclass(frozen=True)
class RolloutGaps:
    """What the planner's images of a rollout show that the log does not.

    Attributes:
        mean: mean over images.
        worst: mean over the cameras, at the moment that shows most.
        worst_s: seconds from the start to that moment.
    """

    mean: ViewGaps
    worst: ViewGaps
    worst_s: float


def rollout_gaps(
    rollout: Rollout,
    meter: GapMeter,
    mounts: Mapping[str, CameraMount],
    given: Sequence[str],
) -> RolloutGaps | None:
    """Measure a rollout after it was run, from its poses alone, at every `GAPS_EVERY`th plan step.

    Args:
        mounts: cameras as they were rendered; one with distortion is measured without.
        given: names of the planner's cameras.

    Returns:
        None where the scene does not tell, or the planner looks at nothing.
    """
    moments = {}
    for step in rollout.plan_steps[::GAPS_EVERY].tolist():
        poses = rollout.state(step).poses
        found = []
        for name in given:
            mount = mounts[name]
            camera_from_world = se3.inverse(rollout.world_from_rig[step] @ mount.rig_from_camera)
            camera = mount.camera.rectified()
            found.append(meter.measure(camera, camera_from_world, poses, mount.seen))
        mean = ViewGaps.mean(found)
        if mean is not None:
            moments[step] = mean
    mean = ViewGaps.mean(moments.values())
    if mean is None:
        return None
    worst = max(moments, key=lambda step: moments[step].invented + moments[step].empty)
    return RolloutGaps(mean, moments[worst], worst * rollout.dt)


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
        """Coverage of the images that the planner was given; None for one that looks at none."""
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
    meter: Meter,
    mounts: Mapping[str, CameraMount],
    recorded: Sequence[str],
    given: Sequence[str],
) -> RolloutCoverage:
    """Measure a rollout after it was run, from its poses alone.

    Only at the steps at which the planner plans. There it costs a twenty-fifth of what a filmed
    rollout costs; at every step it would cost a fifth.

    Args:
        mounts: cameras as they were rendered; one with distortion is measured without.
        recorded: names of the cameras of the films.
        given: names of the planner's cameras.
    """
    images = []
    for step in rollout.plan_steps.tolist():
        poses = rollout.state(step).poses
        for name in dict.fromkeys((*recorded, *given)):
            mount = mounts[name]
            camera_from_world = se3.inverse(rollout.world_from_rig[step] @ mount.rig_from_camera)
            found = meter.measure(mount.camera.rectified(), camera_from_world, poses, mount.seen)
            images.append(ImageCoverage(name, step, name in given, found))
    return RolloutCoverage(tuple(images))
