"""What a planner wants to see, from whatever rig."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import PinholeCamera, se3
from recast.planning.matching import Look, degrees_between
from recast.planning.types import CameraMount, Planner

Array = NDArray[np.float64]

FITS_DEGREES = 2.0
"""A camera shows a view as it is if no corner looks further than this from where it should."""

_SAMPLES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
"""Corners and centre, as shares of width and height."""


@dataclass(frozen=True)
class View:
    """A level picture in a certain direction.

    Attributes:
        name: what the planner calls it.
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
        height, width = mount.seen.shape
        rows = round(self.crop_rows * height / self.camera.height)
        columns = round(self.crop_columns * width / self.camera.width)
        return float(mount.seen[rows : height - rows, columns : width - columns].mean())

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
    forward = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return se3.from_rotation_translation(rotation, position)


def wanted_views(planner: Planner) -> tuple[View, ...]:
    """The planner's attribute `wanted_views`; () where it has none."""
    return tuple(getattr(planner, "wanted_views", ()))


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
    turned: Array = rays @ mount.rig_from_camera[:3, :3].T
    return turned
