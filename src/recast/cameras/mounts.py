"""Cameras on the rig, views that are wanted, and which cameras show them; nuPlan's rig.

Cameras are matched by direction and field of view."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Image, Mask
from recast.cameras.pinhole import PinholeCamera
from recast.geometry import se3

WITHIN_DEGREES = 30.0
"""A camera that looks further off than this does not stand for a wanted one."""
FITS_DEGREES = 2.0
"""A camera shows a view as it is if no corner looks further than this from where it should."""

NUPLAN_CAMERAS = ("nuplan_l0", "nuplan_f0", "nuplan_r0")
"""Left, front and right."""

NUPLAN_CAMERA = PinholeCamera(
    width=1920,
    height=1080,
    fx=1545.0,
    fy=1545.0,
    cx=960.0,
    cy=560.0,
    distortion=(-0.356123, 0.172545, -0.002130, 0.000464, -0.052310),
)
"""Intrinsics shared by all three; the images are as distorted as this says."""

_SIDE = 640
"""Pixels of the longer side at which `seen_by` looks, at most."""

_NUPLAN_MOUNTS = (
    ((1.646, 0.143, 1.521), 55.2, -0.5),
    ((1.670, -0.026, 1.523), 0.2, -1.5),
    ((1.626, -0.162, 1.526), -55.5, 0.4),
)

_SAMPLES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
"""Corners and centre, as shares of width and height."""


@dataclass(frozen=True)
class CameraMount:
    """A camera as the planner sees it: intrinsics of the images it gets, and where it sits.

    Attributes:
        camera: camera at the size of the rendered images; rectified, unless virtual.
        rig_from_camera: (4, 4) OpenCV camera frame to rig.
        seen: mask (height, width) of a virtual camera's pixels that look where a camera of the log
            does; the others are black. None for a camera of the log.
        source: the log's camera at whose place a virtual camera is, if any.
        window: left, top, right and bottom edge, pixels, of the part that is rendered; the rest is
            black. None for the whole image.
    """

    camera: PinholeCamera
    rig_from_camera: Array
    seen: NDArray[np.bool_] | None = None
    source: str | None = None
    window: tuple[int, int, int, int] | None = None

    def framed(self, rendered: Image) -> Image:
        """The image (height, width, 3), black around the part that was rendered."""
        if self.window is None:
            return rendered
        left, top, right, bottom = self.window
        image = np.zeros((self.camera.height, self.camera.width, 3), np.uint8)
        image[top:bottom, left:right] = rendered
        return image

    def windowed(self, image: Image) -> Image:
        """The part of a whole image that is rendered."""
        if self.window is None:
            return image
        left, top, right, bottom = self.window
        return image[top:bottom, left:right]

    def masked(self, image: Image) -> Image:
        """A whole image, black around the part that is rendered."""
        return self.framed(self.windowed(image))


@dataclass(frozen=True)
class Look:
    """Where a camera looks, whatever its name.

    Attributes:
        direction: (3,) unit vector through the image's centre, rig frame.
        field: horizontal field of view, degrees.
    """

    direction: Array
    field: float

    @classmethod
    def level(cls, yaw: float, field: float) -> Look:
        """A level look, `yaw` degrees to the left of ahead."""
        turn = np.deg2rad(yaw)
        return cls(np.array([np.cos(turn), np.sin(turn), 0.0]), field)

    @classmethod
    def of(cls, mount: CameraMount) -> Look:
        """The look of a camera."""
        camera = mount.camera
        across = np.array([0.0, 0.5, 1.0]) * camera.width
        rays = camera.rays(np.stack([across, np.full(3, camera.height / 2)], axis=-1))
        left, centre, right = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        direction: Array = mount.rig_from_camera[:3, :3] @ centre
        return cls(direction, float(degrees_between(left, right)))

    @property
    def yaw(self) -> float:
        """Degrees to the left of ahead."""
        return float(np.rad2deg(np.arctan2(self.direction[1], self.direction[0])))

    def __str__(self) -> str:
        yaw = round(self.yaw)
        side = "left" if yaw > 0 else "right"
        where = f"{abs(yaw)} degrees {side}" if yaw else "ahead"
        return f"{where}, {self.field:.0f} wide"

    def angle(self, other: Look) -> float:
        """Degrees between the two directions."""
        return float(degrees_between(self.direction, other.direction))

    def likeness(self, other: Look) -> float:
        """0 to 1: what both fields see over what either sees, as if side by side in one plane."""
        both = min((self.field + other.field) / 2 - self.angle(other), self.field, other.field)
        return max(both, 0.0) / (self.field + other.field - max(both, 0.0))


def match_cameras(wanted: Mapping[str, Look], mounts: Mapping[str, CameraMount]) -> dict[str, str]:
    """The camera that stands for each wanted one, each camera for one only.

    A camera may stand for one if it looks within `WITHIN_DEGREES` of its direction. Of those, the
    pairs whose fields of view agree best are made first; equal ones in the order of the arguments.

    Args:
        wanted: looks by the planner's names.
        mounts: mounts by the rig's names, which do not matter.

    Returns:
        wanted name to the rig's, in the order of `wanted`; without those with no camera left.
    """
    looks = {name: Look.of(mount) for name, mount in mounts.items()}
    pairs = sorted(
        # Rounded: the same rig under other names, in other units, is still in the same order.
        (-round(want.likeness(look), 6), i, j, name, camera)
        for i, (name, want) in enumerate(wanted.items())
        for j, (camera, look) in enumerate(looks.items())
        if want.angle(look) <= WITHIN_DEGREES
    )
    found: dict[str, str] = {}
    for _, _, _, name, camera in pairs:
        if name not in found and camera not in found.values():
            found[name] = camera
    return {name: found[name] for name in wanted if name in found}


def directions(mounts: Mapping[str, CameraMount]) -> str:
    """The cameras for a message, such as "CAM_FRONT (ahead, 65 wide)"; "none" if there are none."""
    return ", ".join(f"{name} ({Look.of(mount)})" for name, mount in mounts.items()) or "none"


def degrees_between(a: Array, b: Array) -> Array:
    """Angles (...) between directions (..., 3)."""
    # The sine too: arccos alone knows nothing of angles below a millionth.
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.rad2deg(np.arctan2(sine, np.sum(a * b, axis=-1)))


@dataclass(frozen=True)
class View:
    """A level picture in a certain direction.

    Attributes:
        camera: intrinsics; images of another size in the same proportion will do.
        yaw: direction of the optical axis, degrees to the left of ahead.
        crop_rows, crop_columns: pixels at each edge that the planner does not look at.
    """

    name: str
    camera: PinholeCamera
    yaw: float
    crop_rows: int = 0
    crop_columns: int = 0

    def mount(self, size: tuple[int, int], position: Array) -> CameraMount:
        """A camera that shows it.

        Args:
            size: width and height of the images.
            position: (3,) place in the rig.
        """
        return CameraMount(self.camera.resized(*size), camera_pose(position, self.yaw, 0.0))

    @property
    def look(self) -> Look:
        """Where it looks."""
        return Look.of(self._own)

    def off_by(self, mount: CameraMount) -> float:
        """Degrees by which the worst corner of a camera looks elsewhere.

        Infinite if its images have other proportions, to the pixel.
        """
        camera, theirs = self.camera, mount.camera
        if abs(theirs.height - theirs.width * camera.height / camera.width) > 1.0:
            return np.inf
        return float(degrees_between(_sampled(self._own), _sampled(mount)).max())

    def covered(self, mount: CameraMount) -> float:
        """Share of the pixels that the planner looks at which cameras of the log see.

        Args:
            mount: a camera that shows this view.
        """
        if mount.seen is None:
            return 1.0
        left, top, right, bottom = self.window(mount)
        return float(mount.seen[top:bottom, left:right].mean())

    def window(self, mount: CameraMount) -> tuple[int, int, int, int]:
        """Left, top, right and bottom edge, pixels, of what the planner looks at.

        Args:
            mount: a camera that shows this view.
        """
        width, height = mount.camera.width, mount.camera.height
        rows = round(self.crop_rows * height / self.camera.height)
        columns = round(self.crop_columns * width / self.camera.width)
        return columns, rows, width - columns, height - rows

    @property
    def _own(self) -> CameraMount:
        return self.mount((self.camera.width, self.camera.height), np.zeros(3))


def camera_pose(position: ArrayLike, yaw: float, pitch: float) -> Array:
    """`rig_from_camera` (4, 4) of a camera without roll.

    Args:
        position: (3,) metres in the rig frame (x forward, y left, z up).
        yaw, pitch: degrees of the optical axis: to the left of x, and upwards.
    """
    turn, rise = np.deg2rad(yaw), np.deg2rad(pitch)
    forward = se3.direction(turn, rise)
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return se3.from_rotation_translation(rotation, position)


def choose_views(views: Iterable[View], mounts: Mapping[str, CameraMount]) -> dict[str, str]:
    """The cameras that show views as they are, whatever they are called.

    All have images of one size, since planners put them together; if there is a choice, of that
    size in which most views have a camera.

    Returns:
        name of the view to that of the camera; without views that no camera shows.
    """
    views = tuple(views)
    sizes: dict[tuple[int, int], dict[str, tuple[float, str]]] = {}
    for view in views:
        for name, mount in mounts.items():
            # Rounded, or noise of 1e-15 would decide between equal ones.
            off = round(view.off_by(mount), 6)
            found = sizes.setdefault((mount.camera.width, mount.camera.height), {})
            if off <= FITS_DEGREES and off < found.get(view.name, (np.inf, ""))[0]:
                found[view.name] = off, name
    most = max(sizes.values(), key=len, default={})
    return {view.name: most[view.name][1] for view in views if view.name in most}


def _sampled(mount: CameraMount) -> Array:
    """Unit directions (5, 3) in the rig through corners and centre."""
    camera = mount.camera
    rays = camera.rays(_SAMPLES * [camera.width, camera.height])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays @ mount.rig_from_camera[:3, :3].T


def seen_by(mount: CameraMount, cameras: Iterable[CameraMount]) -> Mask:
    """Pixels (H, W) of a camera whose direction at least one other camera looks in.

    Directions only: places are taken to be the same, as on one roof all are against what they see.
    Large images are looked at in a smaller size: undoing a lens for two million pixels takes long.
    """
    full = mount.camera.width, mount.camera.height
    shrink = max(1.0, max(full) / _SIDE)
    small = mount.camera.resized(round(full[0] / shrink), round(full[1] / shrink))
    rays = small.rays(small.pixel_grid()) @ mount.rig_from_camera[:3, :3].T
    seen = np.zeros(rays.shape[:2], np.bool_)
    for other in cameras:
        pixels, depth = other.camera.project(rays @ other.rig_from_camera[:3, :3])
        u, v = pixels[..., 0], pixels[..., 1]
        inside = (u >= 0) & (u <= other.camera.width) & (v >= 0) & (v <= other.camera.height)
        seen |= inside & (depth > 0)
    if seen.shape[::-1] == full:
        return seen
    return cv2.resize(seen.astype(np.uint8), full, interpolation=cv2.INTER_NEAREST) > 0


def nuplan_rig(scale: float = 1.0) -> dict[str, CameraMount]:
    """The virtual rig by camera name, in the rear-axle frame.

    NAVSIM feeds the planner the raw images, with their distortion. A renderer of pinhole images
    renders with `Lens(camera).source` and bends the result: see
    `recast.simulation.scene_renderer.through_lenses`.

    Args:
        scale: factor on width and height, which are rounded to whole pixels.

    Source: nuPlan's published calibration, rounded: position in metres, yaw to the left, pitch
    upwards (the optical axis of the front camera points 1.5 degrees below the horizon), no roll.
    """
    size = round(NUPLAN_CAMERA.width * scale), round(NUPLAN_CAMERA.height * scale)
    camera = NUPLAN_CAMERA.resized(*size)
    return {
        name: CameraMount(camera, camera_pose(position, yaw, pitch))
        for name, (position, yaw, pitch) in zip(NUPLAN_CAMERAS, _NUPLAN_MOUNTS, strict=True)
    }
