"""Renderers over a synthetic world: the truth, half truth with half reconstruction, and noise."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, Float32Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.workers import Closing
from recast.geometry import se3
from recast.geometry.colour import linear_to_srgb, srgb_to_linear
from recast.scene.street_scene import SceneRasterizer, StreetScene
from recast.simulation.renderer import MountedRenderer, RendererAround, SensorRenderer, jittered
from recast.simulation.rollout import SimState
from recast.simulation.scene_renderer import SceneRenderer
from recast.splats import RasterImages
from recast.synthetic import World
from recast.synthetic.rendering import CameraFrame
from recast.synthetic.world import sensor_number
from recast.synthetic.write import Oracle, OraclePool

_TRUTH_STREAM, _DISTURBANCE_STREAM = 701, 702


class TrueView(NamedTuple):
    """One camera at one step, for an oracle in another process.

    Attributes:
        exposed_as: name of the log's camera whose exposure it has.
        poses: `world_from_actor` (4, 4) of the actors, by track id.
        tracks: those that a renderer leaves out or draws apart.
        noise: number of the camera noise; 0 is the truth's own.
    """

    name: str
    exposed_as: str
    camera: PinholeCamera
    world_from_camera: Array
    poses: Mapping[str, Array]
    step: int
    timestamp_us: int
    tracks: tuple[str, ...] = ()
    noise: int = 0

    def seen_by(self, oracle: Oracle, **shown: Any) -> CameraFrame:
        """What the camera truly sees; `shown` is as for `Oracle.render`."""
        seed = oracle.world.seed
        number = [seed, _TRUTH_STREAM, sensor_number(self.name), self.step]
        return oracle.render(
            self.camera,
            self.world_from_camera,
            self.poses,
            exposure=oracle.world.exposure(self.exposed_as, self.timestamp_us),
            rng=np.random.default_rng([*number, self.noise] if self.noise else number),
            **shown,
        )


class WorldRenderer(MountedRenderer, Closing):
    """Base of renderers that look at a synthetic world, each camera with the exposure it has in the
    log, virtual ones with that of the camera at whose place they are.

    Whole images are traced, also of a camera with a window: rays are drawn by chance and their
    light is averaged with the neighbours', so that a part alone would have other pixels.

    Close it, or use it as a context manager: it may hold processes.

    Args:
        world: see `recast.synthetic.populate.world_of`.
        mounts: cameras to render, see `camera_mounts`.
        workers: processes that render the cameras of a step side by side; 0 for one for each core,
            but not more than cameras; 1 for none.
        tracks: see `TrueView`.
        noise: see `TrueView`.
        pool: pool of the same world, whose processes render instead of own ones; closing leaves it
            open.

    Raises:
        InputError: workers is negative, or embreex is not installed.
    """

    def __init__(
        self,
        world: World,
        mounts: Mapping[str, CameraMount],
        workers: int = 0,
        *,
        tracks: Collection[str] = (),
        noise: int = 0,
        pool: OraclePool | None = None,
    ) -> None:
        super().__init__(mounts)
        self._tracks, self._noise = tuple(tracks), noise
        self._own_pool = pool is None
        self._pool = OraclePool(world, workers, most=len(self._mounts)) if pool is None else pool

    def views(self, state: SimState, camera_names: Sequence[str]) -> list[TrueView]:
        """What is to be looked at for the named cameras."""
        found = []
        for name in camera_names:
            mount = self._mounts[name]
            place = state.world_from_rig @ mount.rig_from_camera
            exposed_as = name if mount.source is None else mount.source
            seen = name, exposed_as, mount.camera, place, state.poses, state.step
            found.append(TrueView(*seen, state.timestamp_us, self._tracks, self._noise))
        return found

    def close(self) -> None:
        """End its own processes."""
        if self._own_pool:
            self._pool.close()


class OracleRenderer(WorldRenderer):
    """Renders a synthetic world, without the vehicles of `tracks`; see `WorldRenderer`."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the world with its vehicles at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle.
        """
        views = self.views(state, camera_names)
        images = zip(camera_names, self._pool.map(_render, views), strict=True)
        return {name: self._mounts[name].masked(image) for name, image in images}


def _render(oracle: Oracle, view: TrueView) -> Image:
    return view.seen_by(oracle, absent=view.tracks).rgb


_BLUR = 1.0  # pixels, standard deviation: ray noise is that of single pixels
_DARK = np.float32(2e-3)  # linear light below which a ratio of two images is that of their rounding
_NEARER = 0.3, 0.02  # metres, and share of the depth, by which a street must be nearer to hide


# Colours of the functions below are display values in [0, 1] unless the text says that they are
# linear light.


def as_image(display: NDArray[np.floating]) -> Image:
    """Display values (H, W, 3) as uint8."""
    return (np.clip(display, 0, 1) * 255).round().astype(np.uint8)


def light_left(beside: Image, without: Image) -> Float32Array:
    """Share (H, W, 3) of the linear light of a street that a vehicle leaves, or adds.

    Both images are blurred by a pixel, which hides the noise of their rays. The share is exactly 1
    where they are the same.

    Args:
        beside: (H, W, 3) uint8 the street with what the vehicle shades and mirrors, the vehicle
            itself not seen.
        without: (H, W, 3) uint8 the same view without the vehicle.
    """
    both = (srgb_to_linear(image.astype(np.float32) / 255) for image in (beside, without))
    with_it, without_it = (cv2.GaussianBlur(one.astype(np.float32), (0, 0), _BLUR) for one in both)
    return (with_it + _DARK) / (without_it + _DARK)


def shaded(street: Float32Array, left: Float32Array) -> Float32Array:
    """A street (H, W, 3) of whose linear light the share `left` (H, W, 3) is left."""
    dark = linear_to_srgb(srgb_to_linear(street) * left)
    return np.where(left == 1, street, dark).astype(np.float32)


def vehicle_in_street(
    street: Float32Array,
    front: Float32Array,
    front_alpha: Float32Array,
    vehicle: Image,
    alpha: Float32Array,
) -> Float32Array:
    """A traced vehicle in a street of Gaussians, (H, W, 3).

    Where the vehicle covers a part of a pixel, its light and the street's are added.

    Args:
        street: (H, W, 3) all of the street.
        front: (H, W, 3) the part of the street that is nearer than the vehicle, premultiplied.
        front_alpha: (H, W) opacity of that part.
        vehicle: (H, W, 3) uint8 the vehicle alone, not mixed with anything.
        alpha: (H, W) share of the pixel that it covers.
    """
    shown = front + (1 - front_alpha[..., None]) * (vehicle.astype(np.float32) / 255)
    light = (1 - alpha[..., None]) * srgb_to_linear(street)
    light += alpha[..., None] * srgb_to_linear(np.clip(shown, 0, 1))
    return np.where(alpha[..., None] > 0, linear_to_srgb(light), street).astype(np.float32)


def gaussians_in_truth(
    truth: Image,
    truth_depth: Float32Array,
    layer: Float32Array,
    depth: Float32Array,
    alpha: Float32Array,
) -> Image:
    """Gaussians in front of a traced image, (H, W, 3) uint8; hidden where the street is nearer.

    The street hides them only where it is nearer by more than 0.3 m and 2 % of the depth: a shadow
    lies on the road.

    Args:
        truth: (H, W, 3) uint8 the true image.
        truth_depth: (H, W) depth of the truth at the pixel centres, metres; infinite for the sky.
        layer: (H, W, 3) colour of the Gaussians, premultiplied.
        depth: (H, W) sum of T alpha z of the Gaussians, metres.
        alpha: (H, W) opacity of the Gaussians.
    """
    metres, share = _NEARER
    own = depth / np.maximum(alpha, np.float32(1e-6))
    shown = (alpha > 0) & (own - metres - share * own <= truth_depth)
    mixed = layer + (1 - alpha[..., None]) * (truth.astype(np.float32) / 255)
    return np.where(shown[..., None], as_image(mixed), truth)


_CLEARANCE_M = 0.5
"""What is to hide a vehicle is nearer than its nearest point by that: splats of the road at its
wheels are large."""


class _TrueParts(NamedTuple):
    """What a true vehicle brings into an image.

    Attributes:
        left: (H, W, 3) see `light_left`.
        vehicles: each alone, the farthest first.
    """

    left: Float32Array
    vehicles: list[CameraFrame]


class TrueVehicleRenderer(WorldRenderer):
    """The true vehicles of some tracks in a reconstructed street, with their true light and shadow.

    Together with `GeneratedVehicleRenderer`, its reverse, it tells what a wrong verdict is made of:
    the street or the vehicle.

    The street's Gaussians hide a vehicle where their centres are nearer than its nearest point.

    Args:
        world: see `WorldRenderer`, as for `mounts`, `workers` and `pool`.
        scene: the street; its own models of the tracks are left out.
        tracks: tracks whose vehicles are the true ones.
    """

    def __init__(
        self,
        world: World,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        workers: int = 0,
        *,
        tracks: Collection[str],
        pool: OraclePool | None = None,
    ) -> None:
        super().__init__(world, mounts, workers, tracks=tracks, pool=pool)
        self._street = SceneRenderer(scene, mounts, absent=tracks)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the street with its actors and the true vehicles at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle, or the scene no model of another actor.
        """
        views = self.views(state, camera_names)
        parts = self._pool.map(_true_parts, views)
        poses, time = self._street.poses(state), state.timestamp_us
        return {
            view.name: self._mounts[view.name].masked(self._composed(view, part, poses, time))
            for view, part in zip(views, parts, strict=True)
        }

    def _composed(
        self, view: TrueView, parts: _TrueParts, poses: Mapping[str, Array], time: int
    ) -> Image:
        camera, camera_from_world = view.camera, se3.inverse(view.world_from_camera)
        rasterizer = self._street.rasterizer
        exposure = self._street.scene.exposure(view.exposed_as, time)
        drawn = rasterizer.draw(camera, camera_from_world, poses, shapes_us=time, exposure=exposure)
        image = shaded(drawn.rgb.cpu().numpy(), parts.left)
        for vehicle in parts.vehicles:
            nearest = float(vehicle.depth.min()) - _CLEARANCE_M
            front = rasterizer.layer(
                camera, camera_from_world, poses, shapes_us=time, nearer_than=max(nearest, 0.3)
            )
            rgb, alpha, _ = _arrays(front)
            if exposure is not None:
                rgb = _exposed(rgb, alpha, exposure.numpy())
            image = vehicle_in_street(image, rgb, alpha, vehicle.rgb, vehicle.alpha)
        return as_image(image)


def _exposed(rgb: Float32Array, alpha: Float32Array, affine: Array) -> Float32Array:
    """Premultiplied colours (H, W, 3) of opacity (H, W) by a change (3, 4) of colours."""
    found = rgb @ affine[:, :3].T + alpha[..., None] * affine[:, 3]
    return found.astype(np.float32)


def _true_parts(oracle: Oracle, view: TrueView) -> _TrueParts:
    beside = view.seen_by(oracle, hidden=view.tracks)
    without = view.seen_by(oracle, absent=view.tracks)
    alone = [view.seen_by(oracle, alone=(track,)) for track in view.tracks]
    seen = [frame for frame in alone if np.isfinite(frame.depth).any()]
    seen.sort(key=lambda frame: -float(frame.depth.min()))
    return _TrueParts(light_left(beside.rgb, without.rgb), seen)


class GeneratedVehicleRenderer(WorldRenderer):
    """The Gaussians of some tracks' vehicles, with their shadows, in the true street.

    Args:
        world: see `WorldRenderer`, as for `mounts`, `workers` and `pool`.
        scene: has the vehicles as actors, which bring their light; its street is not drawn.
        tracks: tracks whose vehicles are those of the scene.
    """

    def __init__(
        self,
        world: World,
        scene: StreetScene,
        mounts: Mapping[str, CameraMount],
        workers: int = 0,
        *,
        tracks: Collection[str],
        pool: OraclePool | None = None,
    ) -> None:
        super().__init__(world, mounts, workers, tracks=tracks, pool=pool)
        self._scene, self._rasterizer = scene, SceneRasterizer(scene)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Render the world, and the vehicles of the scene at the poses of `state`.

        Raises:
            InputError: the world has no such vehicle.
            KeyError: the scene has no such actor.
        """
        views = self.views(state, camera_names)
        frames = self._pool.map(_street_alone, views)
        poses = {track: pose for track, pose in state.poses.items() if track in self._tracks}
        images = {}
        for view, frame in zip(views, frames, strict=True):
            camera_from_world = se3.inverse(view.world_from_camera)
            layer = self._rasterizer.layer(
                view.camera, camera_from_world, poses, shapes_us=state.timestamp_us, street=False
            )
            rgb, alpha, depth = _arrays(layer)
            exposure = self._scene.exposure(view.exposed_as, state.timestamp_us)
            if exposure is not None:
                rgb = _exposed(rgb, alpha, exposure.numpy())
            image = gaussians_in_truth(frame.rgb, frame.depth, rgb, depth, alpha)
            images[view.name] = self._mounts[view.name].masked(image)
        return images


def _street_alone(oracle: Oracle, view: TrueView) -> CameraFrame:
    return view.seen_by(oracle, absent=view.tracks)


def _arrays(drawn: RasterImages) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Colour, opacity and depth, see `RasterImages`."""
    return drawn.rgb.cpu().numpy(), drawn.alpha.cpu().numpy(), drawn.depth.cpu().numpy()


ImageNoise = Literal["grey", "jitter"]


class NoisyRenderer(RendererAround):
    """Images of another renderer, disturbed by less than a planner may depend on.

    A planner whose verdict changes cannot agree better with the truth than with itself.

    Args:
        noise: "grey" (see `grey_noise`; another draw for each camera and step) or "jitter" (see
            `recast.simulation.renderer.jittered`).
        seed: seed of the draws.
    """

    def __init__(self, renderer: SensorRenderer, noise: ImageNoise, seed: int) -> None:
        super().__init__(renderer)
        self._noise, self._seed = noise, seed

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images of the named cameras; raises what the inner renderer raises."""
        images = self.part.render(state, camera_names)
        if self._noise == "jitter":
            return {name: self._jittered(name, image) for name, image in images.items()}
        return {
            name: grey_noise(image, np.random.default_rng(self._number(name, state.step)))
            for name, image in images.items()
        }

    def _jittered(self, name: str, image: Image) -> Image:
        """An image moved a little; of a camera with a window, what lies in it."""
        mount = self.mounts[name]
        return mount.framed(jittered(mount.windowed(image)))

    def _number(self, camera: str, step: int) -> list[int]:
        return [self._seed, _DISTURBANCE_STREAM, sensor_number(camera), step]


def grey_noise(image: Image, rng: np.random.Generator) -> Image:
    """The image (H, W, 3) uint8 with each pixel one grey level up or down, its channels together.

    Black stays black when it goes down, and white stays white when it goes up.
    """
    step = 2 * rng.integers(0, 2, (*image.shape[:2], 1), np.int16) - 1
    return np.clip(image.astype(np.int16) + step, 0, 255).astype(np.uint8)
