"""A reconstructed street: what never moves, what does and where it is, the sky; its images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, BoolArray, Float32Array, Int64Array
from recast.cameras import PinholeCamera
from recast.core.brief import Brief
from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.checks import check_times
from recast.scene.actor import (
    BLACK,
    DrawnActor,
    SceneActor,
    check_gaussians,
    exposed,
    exposed_colours,
    painted,
    painted_actor,
)
from recast.scene.sky import SkyMap, composite, pixel_coordinates
from recast.splats import (
    CLASSIC,
    Gaussians,
    LowPass,
    RasterImages,
    Window,
    concatenate,
    freeze,
    morton_order,
    pick_device,
    rasterize_frozen,
)

DEFORMABLE = frozenset({"pedestrian"})
"""Categories that are not symmetric at every moment."""
MOVED_M = 2.0
SPREAD_M = 0.5
CLOCK_TOLERANCE_US = 60_000
"""Sensors of one frame fire up to half a period of 10 Hz (and a little) apart."""


def moves(trajectory: Trajectory) -> bool:
    """Whether a track counts as moving in the world.

    First and last position more than 2 m apart, or a spread along an axis above 0.5 m (Street
    Gaussians' rule), the first so that label noise of parked cars does not count.
    """
    positions = trajectory.poses[:, :3, 3]
    travelled = float(np.linalg.norm(positions[-1] - positions[0]))
    return travelled > MOVED_M or bool(np.any(positions.std(axis=0) > SPREAD_M))


def stands(trajectory: Trajectory) -> bool:
    """Whether every pose is the same, as `choose_actors` makes those of parked vehicles."""
    return bool(np.all(trajectory.poses == trajectory.poses[:1]))


def pose_at(trajectory: Trajectory, timestamp_us: int) -> Array | None:
    """World pose (4, 4) at a time, or None where the track is absent.

    Interpolated in the world frame. A camera that fires shortly before the first or after the last
    label still saw the object: there the end pose is held.
    """
    first, last = int(trajectory.timestamps_us[0]), int(trajectory.timestamps_us[-1])
    if not first - CLOCK_TOLERANCE_US <= timestamp_us <= last + CLOCK_TOLERANCE_US:
        return None
    return trajectory.at(min(max(timestamp_us, first), last))


def corrected(
    camera_from_world: Array,
    corrections: Mapping[str, tuple[Int64Array, Array]],
    camera_name: str,
    timestamp_us: int,
) -> Array:
    """A logged pose (4, 4) with the learned correction at its time.

    Interpolated linearly between the neighbouring training views, held before the first and after
    the last; cameras that were not trained on stay as logged.
    """
    if camera_name not in corrections:
        return camera_from_world
    times, twists = corrections[camera_name]
    twist = [np.interp(timestamp_us, times, twists[:, i]) for i in range(6)]
    moved: Array = twist_matrix(torch.tensor(twist, dtype=torch.float64)).numpy()
    return moved @ camera_from_world


def twist_matrix(twist: Tensor) -> Tensor:
    """Rigid matrix (4, 4) of a twist (6,): rotation by Rodrigues' formula, translation as it is.

    The translation is not multiplied by SO(3)'s left Jacobian: the parametrisation is as good a
    chart near zero, and decoupled.
    """
    rotation = twist[3:]
    theta2 = rotation.dot(rotation)
    small = theta2 < 1e-8
    safe = torch.where(small, torch.ones_like(theta2), theta2)
    theta = safe.sqrt()
    a = torch.where(small, 1 - theta2 / 6, theta.sin() / theta)
    b = torch.where(small, 0.5 - theta2 / 24, (1 - theta.cos()) / safe)
    x, y, z = rotation.unbind()
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
    turn = torch.eye(3, dtype=twist.dtype) + a * skew + b * (skew @ skew)
    top = torch.cat([turn, twist[:3, None]], dim=1)
    bottom = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=twist.dtype)
    return torch.cat([top, bottom])


MOST_CORRECTED = 100.0
"""Largest learned correction of a camera, metres or radians."""


class Insertable(Protocol):
    """What can take an actor's place in a scene, such as `recast.actors.Actor`."""

    def inserted_into(self, scene: StreetScene) -> StreetScene:
        """The scene with it in the place of the actor with its track id."""


@dataclass(frozen=True, repr=False)
class StreetScene(Brief):
    """Background, actors and sky.

    Attributes:
        background: world-frame Gaussians, all that stands still.
        actors: actors by track id.
        sky: colour at infinity.
        world_offset: (3,) float64, dataset coordinates = world coordinates + offset.
        camera_corrections: learned camera pose corrections by camera name: times (F,) int64 and
            twists (F, 6) (see `recast.scene.street_scene.corrected`).
        log_name: the log it was made from.
        low_pass: filter that the background was made for; each actor has its own.
        mounts: learned corrections of the cameras' places in the rig by camera: (4, 4), which
            multiply `rig_from_camera` from the left; see `mounted`.
        exposures: learned changes of an image's colours by camera, relative to the scene's colours:
            times (F,) int64 and transforms (F, 3, 4); see `exposure`.
        unseen: (N,) bool, Gaussians of the background that no training image showed; None where
            that is not known.
        sky_seen: (h, w) bool, cells of the sky map that images showed; None likewise.
        origin: the folder that it was read from; None for one that was changed or never saved.
    """

    background: Gaussians
    actors: Mapping[str, SceneActor]
    sky: SkyMap
    world_offset: Array = field(default_factory=lambda: np.zeros(3))
    camera_corrections: Mapping[str, tuple[Int64Array, Array]] = field(default_factory=dict)
    log_name: str = ""
    low_pass: LowPass = CLASSIC
    exposures: Mapping[str, tuple[Int64Array, Array]] = field(default_factory=dict)
    mounts: Mapping[str, Array] = field(default_factory=dict)
    unseen: Tensor | None = None
    sky_seen: Tensor | None = None
    origin: Path | None = field(default=None, init=False, compare=False)

    def _facts(self) -> Mapping[str, object]:
        return {
            "log": self.log_name,
            "background": f"{len(self.background)} Gaussians",
            "actors": len(self.actors),
            "origin": self.origin,
        }

    def validate(self) -> None:
        """Raise ValueError naming the member at fault: shape, range, order, or not finite."""
        check_gaussians("background", self.background)
        for track_id, actor in self.actors.items():
            actor.validate(f"actors[{track_id!r}]")
            if actor.track_id != track_id:
                raise ValueError(f"actors[{track_id!r}].track_id: is {actor.track_id!r}")
        self.sky.validate()
        if self.world_offset.shape != (3,) or not np.all(np.isfinite(self.world_offset)):
            raise ValueError(f"world_offset: three finite metres, got {self.world_offset}")
        for name, (times, twists) in self.camera_corrections.items():
            where = f"camera_corrections[{name!r}]"
            check_times(where, times)
            if len(times) == 0 or twists.shape != (len(times), 6):
                raise ValueError(f"{where}: {len(times)} times, twists {twists.shape}")
            if not np.all(np.abs(twists) <= MOST_CORRECTED):  # also NaN
                raise ValueError(f"{where}: a twist is not finite, or beyond {MOST_CORRECTED:g}")
        for name, (times, affines) in self.exposures.items():
            where = f"exposures[{name!r}]"
            check_times(where, times)
            if len(times) == 0 or affines.shape != (len(times), 3, 4):
                raise ValueError(f"{where}: {len(times)} times, transforms {affines.shape}")
            if not np.all(np.abs(affines) <= MOST_CORRECTED):  # also NaN
                raise ValueError(f"{where}: a number is not finite, or beyond {MOST_CORRECTED:g}")
        for name, moved in self.mounts.items():
            where = f"mounts[{name!r}]"
            if moved.shape != (4, 4) or not np.all(np.abs(moved) <= MOST_CORRECTED):
                raise ValueError(f"{where}: expected (4, 4) finite numbers, got {moved.tolist()}")
        for where, marks, shape in (
            ("unseen", self.unseen, (len(self.background),)),
            ("sky_seen", self.sky_seen, tuple(self.sky.colours.shape[:2])),
        ):
            if marks is not None and (marks.dtype != torch.bool or tuple(marks.shape) != shape):
                raise ValueError(f"{where}: {marks.dtype} {tuple(marks.shape)}, not bool {shape}")

    def at(self, poses: Mapping[str, Array], timestamp_us: int | None = None) -> Gaussians:
        """Everything drawn when the actors stand at `poses`, in the world frame.

        Args:
            poses: `world_from_actor` (4, 4) by track id. Parked vehicles that it does not name
                stand where they are; other actors that it does not name are absent.
            timestamp_us: time of the recording whose shapes deformable actors have, see
                `SceneActor.shaped_at`.

        Raises:
            KeyError: a pose for an actor that the scene does not have.
        """
        parts = [self.background]
        for track_id, pose in {**self.standing, **poses}.items():
            actor = self.actors[track_id].shaped_at(timestamp_us).lit_at(pose).stepped_at(pose)
            parts.append(actor.drawn.transformed(torch.from_numpy(np.array(pose))))
        return concatenate(parts)

    def actor_poses(self, timestamp_us: int) -> dict[str, Array]:
        """Logged (refined) `world_from_actor` of the actors present at a time."""
        poses = {
            track_id: pose_at(actor.trajectory, timestamp_us)
            for track_id, actor in self.actors.items()
        }
        return {track_id: pose for track_id, pose in poses.items() if pose is not None}

    @property
    def standing(self) -> dict[str, Array]:
        """Poses of the parked vehicles, which are part of the street: who does not move one draws
        it where it stands."""
        return {
            track_id: actor.trajectory.poses[0]
            for track_id, actor in self.actors.items()
            if stands(actor.trajectory)
        }

    def with_actor(self, actor: SceneActor | Insertable) -> StreetScene:
        """The scene with an actor added, or put in the place of the one with its track id.

        Args:
            actor: one of a scene; or a generated vehicle, see `recast.actors.insert`.
        """
        if not isinstance(actor, SceneActor):
            return actor.inserted_into(self)
        return replace(self, actors={**self.actors, actor.track_id: actor})

    def corrected_camera(
        self, camera_from_world: Array, camera_name: str, timestamp_us: int
    ) -> Array:
        """A logged camera pose (4, 4) with the learned correction at its time."""
        return corrected(camera_from_world, self.camera_corrections, camera_name, timestamp_us)

    def exposure(self, camera_name: str, timestamp_us: int) -> Tensor | None:
        """The change (3, 4) of an image's colours by its camera at a time of the recording.

        Interpolated linearly, held before the first and after the last time; None for a camera
        whose exposure was not learned.
        """
        if camera_name not in self.exposures:
            return None
        times, affines = self.exposures[camera_name]
        flat = affines.reshape(len(times), 12)
        found = [np.interp(timestamp_us, times, flat[:, i]) for i in range(12)]
        return torch.tensor(found, dtype=torch.float32).view(3, 4)

    def mounted(
        self,
        rig_from_camera: Array,
        camera_name: str,
        timestamp_us: int = 0,
        calibrated: Array | None = None,
    ) -> Array:
        """Where a camera truly sits in the rig (4, 4), or a virtual one at its place.

        As calibrated, moved by the mean of what training learned of its poses: what of it changes
        with time is the noise of the log's poses, which a simulated drive does not have.

        Args:
            calibrated: `rig_from_camera` (4, 4) of the log, if the rig stands where the log has it
                at `timestamp_us`: then moved by what was learned there, noise and all.
        """
        if calibrated is not None:
            logged = se3.inverse(calibrated)
            here = se3.inverse(self.corrected_camera(logged, camera_name, timestamp_us))
            return here @ logged @ rig_from_camera
        moved = self.mounts.get(camera_name)
        return rig_from_camera if moved is None else moved @ rig_from_camera

    def exposed(self, affine: Tensor) -> StreetScene:
        """The scene with the colours' transform (3, 4) in all its parts; the sky in [0, 1].

        `exposures` stay what they are.
        """
        return replace(
            self,
            background=exposed(self.background, affine),
            actors={name: actor.exposed(affine) for name, actor in self.actors.items()},
            sky=SkyMap(exposed_colours(self.sky.colours, affine).clamp(0, 1)),
        )


_FAR = 1e10
"""Metres; all that is farther is sky."""


@dataclass(frozen=True)
class SceneImage:
    """One rendered view.

    Attributes:
        rgb: (H, W, 3) float32 in [0, 1].
        depth: (H, W) float32, sum of T alpha z in metres, not divided by alpha.
        alpha: (H, W) float32 accumulated opacity; the rest is sky.
    """

    rgb: Float32Array
    depth: Float32Array
    alpha: Float32Array


class SceneRasterizer:
    """Draws one scene again and again: what does not change is worked out once.

    Args:
        device: device to draw on, see `recast.splats.pick_device`.

    Raises:
        InputError: there is no such device, or gsplat is missing.
    """

    def __init__(self, scene: StreetScene, device: str = "auto") -> None:
        place = pick_device(device)
        self._standing = scene.standing
        self._sky = scene.sky.colours.to(place)
        background = scene.background.detach()
        ordered = background.select(morton_order(background.means)).to(place)
        self._background = freeze(ordered, scene.low_pass)
        self._actors = {
            track_id: DrawnActor(actor, place) for track_id, actor in scene.actors.items()
        }

    def render(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        colours_us: int | None = None,
        shapes_us: int | None = None,
        exposure: Tensor | None = None,
    ) -> SceneImage:
        """Draw one view; see `render_scene` and `draw`."""
        moments = colours_us, shapes_us
        drawn = self.draw(camera, camera_from_world, poses, *moments, exposure=exposure)
        return SceneImage(
            rgb=drawn.rgb.cpu().numpy(),
            depth=drawn.depth.cpu().numpy(),
            alpha=drawn.alpha.cpu().numpy(),
        )

    def draw(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        colours_us: int | None = None,
        shapes_us: int | None = None,
        window: Window | None = None,
        exposure: Tensor | None = None,
    ) -> RasterImages:
        """Draw one view and leave it where it was drawn, sky included, rgb in [0, 1].

        Args:
            window: the part of the camera's image to draw, with the pixels of the whole image; None
                for all of it.
            colours_us: time of the recording whose colours the actors have, where they change; None
                for those that they are stored with.
            shapes_us: time of the recording whose shapes deformable actors have, see
                `SceneActor.shaped_at`.
            exposure: change (3, 4) of the image's colours, see `StreetScene.exposure`.
        """
        result = self.layer(camera, camera_from_world, poses, colours_us, shapes_us, window=window)
        left, top, right, bottom = window or (0, 0, camera.width, camera.height)
        # Interpolated between nodes of the whole image.
        coordinates = pixel_coordinates(camera, camera_from_world)[top:bottom, left:right]
        with torch.no_grad():
            rgb = composite(result.rgb, result.alpha, self._sky, coordinates)
            if exposure is not None:
                rgb = exposed_colours(rgb, exposure.to(rgb))
        return replace(result, rgb=rgb.clamp(0, 1))

    def layer(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        colours_us: int | None = None,
        shapes_us: int | None = None,
        *,
        nearer_than: float = _FAR,
        street: bool = True,
        window: Window | None = None,
    ) -> RasterImages:
        """Draw Gaussians alone: rgb is premultiplied, on black, without a sky; others as `draw`.

        Args:
            nearer_than: only Gaussians whose centres lie nearer, metres along the camera's z axis.
            street: False leaves out all but the actors of `poses`.

        Raises:
            ValueError: neither street nor actors are to be drawn.
        """
        view = torch.from_numpy(np.asarray(camera_from_world, np.float64))
        K = torch.from_numpy(camera.matrix).float()
        drawn = [(self._background, torch.eye(4, dtype=torch.float64))] if street else []
        for track_id, pose in {**(self._standing if street else {}), **poses}.items():
            world_from_actor = torch.from_numpy(np.array(pose, np.float64))
            for part in self._actors[track_id].at(pose, colours_us, shapes_us):
                drawn.append((part, world_from_actor))
        with torch.no_grad():
            return rasterize_frozen(
                drawn, view, K, camera.width, camera.height, far=nearer_than, window=window
            )


@dataclass(frozen=True)
class ViewGaps:
    """What a view shows that the log does not.

    Attributes:
        invented: share of the pixels whose surface no training image showed: the LiDAR met it, or
            it is a ground assumed under what hid it, in colours of what is near by.
        empty: share of the pixels with neither a surface nor sky that a training image showed; they
            have the colour of sky near by.
    """

    invented: float
    empty: float

    @classmethod
    def mean(cls, several: Iterable[ViewGaps | None]) -> ViewGaps | None:
        """Mean over views; None where there are none."""
        found = [(one.invented, one.empty) for one in several if one is not None]
        return cls(*np.mean(found, axis=0).tolist()) if found else None


class GapMeter:
    """Measures what views of one scene show that its log does not.

    Args:
        scene: an imported one does not tell.
        device: device to draw on, see `recast.splats.pick_device`.
    """

    def __init__(self, scene: StreetScene, device: str = "auto") -> None:
        self._rasterizer: SceneRasterizer | None = None
        self._tracks = frozenset(scene.actors)
        if scene.unseen is None or scene.sky_seen is None:
            return
        red, green = torch.tensor([1.0, *BLACK[1:]]), torch.tensor([0.0, 1.0, 0.0])
        marks = torch.where(scene.unseen[:, None], red, torch.tensor(BLACK))
        marked = replace(
            scene,
            background=painted(scene.background, marks),
            actors={k: painted_actor(v, BLACK, BLACK) for k, v in scene.actors.items()},
            sky=SkyMap((~scene.sky_seen)[..., None] * green),
        )
        self._rasterizer = SceneRasterizer(marked, device)

    def measure(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        usable: BoolArray | None = None,
    ) -> ViewGaps | None:
        """Shares of the pixels of a view; None if the scene does not tell.

        Args:
            camera, camera_from_world: see `render_scene`.
            poses: the same; tracks of which the scene has no model are part of its background.
            usable: (H, W) pixels that count; None for all.
        """
        if self._rasterizer is None:
            return None
        known = {key: pose for key, pose in poses.items() if key in self._tracks}
        rgb = self._rasterizer.render(camera, camera_from_world, known).rgb
        marked = (rgb if usable is None else rgb[usable]) > 0.5
        return ViewGaps(float(marked[..., 0].mean()), float(marked[..., 1].mean()))


def render_scene(
    scene: StreetScene,
    camera: PinholeCamera,
    camera_from_world: Array,
    poses: Mapping[str, Array],
) -> SceneImage:
    """Draw a scene once. For many images of one scene keep a `SceneRasterizer`.

    Args:
        camera: rectified intrinsics.
        camera_from_world: (4, 4).
        poses: `world_from_actor` (4, 4) by track id. Parked vehicles that it does not name are
            drawn where they stand; other actors that it does not name are not drawn.

    Raises:
        ValueError: the camera has distortion.
        KeyError: a pose for an actor that the scene does not have.
    """
    return SceneRasterizer(scene).render(camera, camera_from_world, poses)
