"""The camera of a turntable, measured from the outlines of a vehicle of unknown shape.

One fixed camera sees a vehicle that turns about a vertical axis by known angles. Seen from the
vehicle, the camera stands on a circle, here of radius 1. A plane through two of its places that
touches the vehicle touches both outlines, above and below; angle of view, pitch and yaw of the
camera are those for which it does, in many pairs of views. Vertical planes that touch the outlines
left and right then give the box seen from above, and points at which the planes touch its height.

Source of the constraint: Wong and Cipolla, Structure and motion from silhouettes, ICCV 2001.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import HalfspaceIntersection

from recast.arrays import Array, Image
from recast.core.errors import InputError
from recast.recar.vehicle_set import Identity, VehicleSet, begin_set, finish_set, write_identity
from recast.recar.views import camera_pose, pinhole

LEAST_VIEWS = 8
MOST_RESIDUAL = 0.005
"""Median residual, as a share of the widest outline, above which the views are not those of a
turntable: 0.0003 on synthetic cars, 0.004 if their azimuths are off by 8 degrees at random (the
angle of view is then off by up to 5 degrees), 0.002 on real spins cut out by GrabCut, 0.05 if it
lost parts of the vehicle."""
MOST_ACROSS = 0.9
"""Width with mirrors over length of a vehicle, at most; of a car of 2.7 m it is about 0.75."""
FOV_WITHIN = 0.1
"""Share by which fields of view of the vehicles of one camera differ from their median."""
ELEVATION_WITHIN_DEG = 2.0
"""The same of elevations; 2 degrees are 0.3 m of height at 9 m."""

_APART_DEG = 25.0, 105.0  # angle between the views of a pair; the line between them must stay clear
_MOST_PAIRS = 400
_TOUCH_PX = 1.0  # outline points as near to the touching plane as this touch it
_TOUCH_SHARE = 0.1  # share of the outline's width over which a plane may touch: it is one point
_HEIGHT_PERCENT = 5.0, 95.0  # of the heights of touching points; the outer ones are errors
_STARTS = (25.0, 10.0), (60.0, 10.0), (40.0, -15.0)  # field of view and pitch in degrees


@dataclass(frozen=True)
class TurntableFit:
    """The camera of one vehicle; lengths are in units of the vehicle's length.

    Attributes:
        fov_deg: angle of view across the image's width.
        elevation_deg: elevation of the camera above the horizontal through the box centre.
        distance: distance from the camera to the box centre, in lengths of the vehicle.
        size: (3,) length, width with mirrors, height, in lengths of the vehicle.
        centres: (V, 2) pixels (x, y) of the box centre in each view.
        pose: (4, 4) `actor_from_camera` of the view at azimuth 0, in lengths of the vehicle.
        residual_px: median distance of an outline from the plane that touches its partner.
        views: number of views used; those that touch the image's edge are left out.
    """

    fov_deg: float
    elevation_deg: float
    distance: float
    size: Array
    centres: Array
    pose: Array
    residual_px: float
    views: int


def fit_turntable(
    alphas: Sequence[Image],
    azimuths_deg: Sequence[float],
    where: str | Path,
    fov_deg: float | None = None,
) -> TurntableFit:
    """Measure the camera of a turntable; its principal point is the middle of the image.

    Args:
        alphas: (H, W) uint8 of the views.
        azimuths_deg: azimuths of the camera about the vehicle: 0 ahead, 90 to its left.
        where: name of the vehicle, for messages.
        fov_deg: angle of view across the width where it is known.

    Raises:
        InputError: fewer than `LEAST_VIEWS` outlines inside of their images, or no camera fits;
            the vehicle is as wide as long.
    """
    height, width = alphas[0].shape
    hulls = [_outline(alpha) for alpha in alphas]
    inside = [view for view, hull in enumerate(hulls) if hull is not None]
    if len(inside) < LEAST_VIEWS:
        problem = f"only {len(inside)} of {len(alphas)} show the whole vehicle"
        mend = f"give at least {LEAST_VIEWS} views in which it does not touch the image's edge"
        raise InputError(where, "views", problem, mend)
    most = max(len(hull) for hull in hulls if hull is not None)
    outlines = np.stack([np.resize(hull, (most, 2)) for hull in hulls if hull is not None])
    azimuths = np.asarray(azimuths_deg, float)
    ring = _Ring(outlines, azimuths[inside], width, height)
    solution = ring.solve(fov_deg)
    residual = ring.miss(*solution)
    widest = float(np.ptp(outlines[..., 0], axis=1).max())
    if not residual <= MOST_RESIDUAL * widest:
        raise InputError(
            where,
            "outlines",
            f"are not those of a turntable: they differ by {residual:.1f} pixels, at most "
            f"{MOST_RESIDUAL * widest:.1f} are allowed",
            "give regular azimuths of one fixed camera, and masks without shadows",
        )
    low, high = ring.bounds(*solution, where)
    length, across = (high - low)[:2]
    if across > MOST_ACROSS * length:
        problem = f"are of a vehicle that is {across / length:.1f} times as wide as long"
        mend = "check that the first view shows the front, and that the masks differ"
        raise InputError(where, "outlines", problem, mend)
    centre = (low + high) / 2
    focal, pitch, yaw = solution
    fov = float(np.degrees(2 * np.arctan(width / 2 / focal)))
    camera = pinhole(width, height, fov)
    poses = [_pose(azimuth, pitch, yaw) for azimuth in azimuths]
    centres = np.array([camera.project((centre - p[:3, 3]) @ p[:3, :3])[0] for p in poses])
    reach = np.array([1.0, 0.0, 0.0]) - [0.0, 0.0, centre[2]]
    elevation = float(np.degrees(np.arctan2(reach[2], reach[0])))
    if elevation < 0:  # hardly: a spin that is read backwards looks as if from below
        other = _Ring(outlines, -ring.azimuths, width, height)
        if other.miss(*other.solve(fov_deg)) < residual:
            problem = f"fit the other way around better than a camera at {elevation:.1f} degrees"
            mend = "if the photographs go around clockwise, ingest them with --clockwise"
            raise InputError(where, "views", problem, mend)
    pose = _pose(0.0, pitch, yaw)
    pose[:3, 3] = (pose[:3, 3] - centre) / length
    return TurntableFit(
        fov,
        elevation,
        float(np.linalg.norm(reach)) / length,
        (high - low) / length,
        centres,
        pose,
        residual,
        len(inside),
    )


def fit_set(
    vehicle_set: VehicleSet, fov_deg: float | None = None
) -> dict[str, TurntableFit | InputError]:
    """The camera of each vehicle of a set, or why it has none."""
    fits: dict[str, TurntableFit | InputError] = {}
    for name, identity in vehicle_set.identities.items():
        try:
            views = range(vehicle_set.record.views)
            alphas = [np.ascontiguousarray(identity.view(view)[..., 3]) for view in views]
            fits[name] = fit_turntable(alphas, vehicle_set.record.azimuths_deg, name, fov_deg)
        except InputError as error:
            fits[name] = error
    return fits


def medians(fits: Mapping[str, TurntableFit | InputError]) -> tuple[float, float]:
    """Median elevation and field of view, in degrees, of the vehicles that have a camera.

    Raises:
        InputError: that of the first vehicle where none has one.
    """
    cameras = [fit for fit in fits.values() if isinstance(fit, TurntableFit)]
    for fit in fits.values():
        if not cameras and isinstance(fit, InputError):
            raise fit
    elevation, fov = np.median([(fit.elevation_deg, fit.fov_deg) for fit in cameras], axis=0)
    return float(elevation), float(fov)


def write_fitted(
    vehicle_set: VehicleSet, fits: Mapping[str, TurntableFit | InputError], out: Path
) -> None:
    """Write a set with its camera: the same views, shifted so that they look at the box centre.

    All vehicles are fitted again with the median field of view. `distance_m` is known for those
    with a size.

    Raises:
        InputError: a vehicle has no camera, vehicles do not share one, a shift cuts a vehicle, or
            `out` holds something else.
    """
    _, fov = medians(fits)
    _check_alike(fits, "fov_deg", fov, FOV_WITHIN * fov)
    fits = fit_set(vehicle_set, fov)
    elevation, _ = medians(fits)
    _check_alike(fits, "elevation_deg", elevation, ELEVATION_WITHIN_DEG)
    camera = {"fov_deg": round(fov, 3), "elevation_deg": round(elevation, 3)}
    record = vehicle_set.record.model_copy(update={"name": out.absolute().name, **camera})
    finished = begin_set(out, record, list(fits))
    for name, identity in vehicle_set.identities.items():
        fit = fits[name]
        if name not in finished and isinstance(fit, TurntableFit):
            size = identity.record.size
            distance = None if size is None else round(fit.distance * size[0], 4)
            views = [_shifted(identity, view, fit.centres[view]) for view in range(record.views)]
            measured = identity.record.model_copy(update={"distance_m": distance})
            write_identity(out, record, measured, views)
    finish_set(out, record)


def _check_alike(
    fits: Mapping[str, TurntableFit | InputError], field: str, median: float, most: float
) -> None:
    for name, fit in fits.items():
        if isinstance(fit, InputError):
            raise fit
        value = getattr(fit, field)
        if abs(value - median) > most:
            problem = f"is {value:.1f}, but the median of the set is {median:.1f}"
            raise InputError(name, field, problem, "make a set for each camera")


def _shifted(identity: Identity, view: int, centre: Array) -> Image:
    """A view shifted by whole pixels so that `centre` is in its middle."""
    picture = identity.view(view)
    height, width = picture.shape[:2]
    x, y = (int(shift) for shift in np.round(np.array([width, height]) / 2 - centre))
    moved = np.zeros_like(picture)
    if abs(x) < width and abs(y) < height:
        rows, columns = slice(max(y, 0), height + min(y, 0)), slice(max(x, 0), width + min(x, 0))
        moved[rows, columns] = np.roll(picture, (y, x), axis=(0, 1))[rows, columns]
    if (moved[..., 3] > 127).sum() < (picture[..., 3] > 127).sum():
        problem = f"is cut by the shift of {x}, {y} pixels to the box centre"
        mend = "ingest the photographs with a margin around the vehicle"
        raise InputError(identity.where(view), "view", problem, mend)
    return moved


def _outline(alpha: Image) -> Array | None:
    """Convex hull (K, 2) of the largest part in pixels; None where it touches the image's edge."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((alpha > 127).astype(np.uint8))
    if count < 2:
        return None
    part = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    if part[[0, -1]].any() or part[:, [0, -1]].any():
        return None
    points = []
    for levels, mask, flip in ((alpha, part, 1), (alpha.T, part.T, -1)):
        lines = np.flatnonzero(mask.any(axis=1))
        for side in (1, -1):
            first = mask[:, ::side].argmax(axis=1)[lines]
            inner, outer = (
                levels[lines, ::side][np.arange(len(lines)), at].astype(float)
                for at in (first, first - 1)
            )
            edge = first + 0.5 - (inner - 127.5) / (inner - outer)
            ends = edge if side == 1 else mask.shape[1] - edge
            points.append(np.stack([ends, lines + 0.5], axis=1)[:, ::flip])
    hull = cv2.convexHull(np.concatenate(points).astype(np.float32))
    return np.asarray(hull[:, 0], np.float64)


def _pose(azimuth: float, pitch: float, yaw: float) -> Array:
    """`actor_from_camera` (4, 4) on the circle of radius 1, origin at its centre."""
    pose = camera_pose(azimuth + yaw, pitch, 1.0)
    pose[:3, 3] = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0
    return pose


class _Ring:
    """Outlines (V, K, 2) in pixels, seen from azimuths (V,)."""

    def __init__(self, outlines: Array, azimuths: Array, width: int, height: int) -> None:
        self.outlines, self.azimuths = outlines, azimuths
        self.width, self.middle = width, np.array([width / 2, height / 2])
        self.places = np.stack([_pose(a, 0.0, 0.0)[:3, 3] for a in azimuths])
        apart = np.abs((azimuths[:, None] - azimuths + 180) % 360 - 180)
        pairs = np.argwhere(np.triu((apart >= _APART_DEG[0]) & (apart <= _APART_DEG[1])))
        some = np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PAIRS)).round().astype(int)
        self.pairs = pairs[some]  # (P, 2)
        self.inward = -self.places[self.pairs].sum(axis=1)
        self.inward /= np.linalg.norm(self.inward, axis=1, keepdims=True)

    def rays(self, focal: float, pitch: float, yaw: float) -> Array:
        """Directions (V, K, 3) of depth 1 of the outlines' points, in the vehicle's axes."""
        flat = (self.outlines - self.middle) / focal
        rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=-1)
        turns = np.stack([_pose(a, pitch, yaw)[:3, :3] for a in self.azimuths])
        return np.einsum("vij,vkj->vki", turns, rays)

    def planes(self, rays: Array) -> tuple[Array, Array]:
        """Angles (P, 2, K) about the line of each pair of the planes of its rays, and px per rad.

        The latter is in units of the focal length.
        """
        inward = np.einsum("pskc,pc->psk", rays[self.pairs], self.inward)
        up = rays[self.pairs][..., 2]
        return np.arctan2(up, inward), np.hypot(up, inward)

    def residuals(self, focal: float, pitch: float, yaw: float) -> Array:
        """(2 P,) pixels by which the planes that touch two outlines differ, above and below."""
        angles, reach = self.planes(self.rays(focal, pitch, yaw))
        parts = []
        for touching in (angles.argmax(axis=-1), angles.argmin(axis=-1)):
            index = touching[..., None]
            ends = np.take_along_axis(angles, index, -1)[..., 0]
            scale = np.take_along_axis(reach, index, -1)[..., 0].mean(axis=1)
            parts.append((ends[:, 0] - ends[:, 1]) * scale * focal)
        return np.concatenate(parts)

    def miss(self, focal: float, pitch: float, yaw: float) -> float:
        """Median of the residuals, in pixels."""
        return float(np.median(np.abs(self.residuals(focal, pitch, yaw))))

    def solve(self, fov_deg: float | None) -> tuple[float, float, float]:
        """Focal length in pixels, pitch and yaw in degrees."""

        def camera(x: Array) -> tuple[float, float, float]:
            fov = fov_deg or float(np.clip(x[2], 0.5, 175.0))
            return self.width / 2 / float(np.tan(np.radians(fov) / 2)), float(x[0]), float(x[1])

        middle = float(self.outlines[..., 0].mean())
        solutions = []
        for fov, pitch in _STARTS:
            focal = camera(np.array([0.0, 0.0, fov]))[0]
            yaw = float(np.degrees(np.arctan((middle - self.middle[0]) / focal)))
            start = [pitch, yaw] if fov_deg else [pitch, yaw, fov]
            solutions.append(
                least_squares(
                    lambda x: self.residuals(*camera(x)),
                    start,
                    loss="soft_l1",
                    diff_step=1e-4,
                    max_nfev=60,
                )
            )
        return camera(min(solutions, key=lambda solution: solution.cost).x)

    def bounds(
        self, focal: float, pitch: float, yaw: float, where: str | Path
    ) -> tuple[Array, Array]:
        """Lower and upper corner (3,) of the box, in radii."""
        rays = self.rays(focal, pitch, yaw)
        flat = rays[..., :2] / np.linalg.norm(rays[..., :2], axis=-1, keepdims=True)
        places = self.places[:, :2]
        side = places[:, None, 1] * flat[..., 0] - places[:, None, 0] * flat[..., 1]
        lines = []  # (3,): normal and offset of vertical planes that touch
        for ends, sign in ((side.argmax(axis=1), 1.0), (side.argmin(axis=1), -1.0)):
            along = flat[np.arange(len(ends)), ends]
            normals = sign * np.stack([-along[:, 1], along[:, 0]], axis=1)
            lines.append(np.column_stack([normals, -(normals * places).sum(axis=1)]))
        planes = np.concatenate(lines)
        if planes[:, 2].max() > -1e-6:
            raise InputError(
                where, "outlines", "do not turn about the vehicle", "check masks and azimuths"
            )
        turned = np.degrees(np.arctan2(planes[:, 1], planes[:, 0])) % 360
        planes = planes[np.argsort(turned)]
        apart = np.diff(np.sort(turned), prepend=-360.0) > 90 / len(self.azimuths)  # no two alike
        corners = HalfspaceIntersection(planes[apart], np.zeros(2)).intersections
        # The outermost corner lies outside of the vehicle, between two planes that touch it.
        corners = np.sort(corners, axis=0)[1:-1]
        heights = self._heights(rays, focal)
        low, high = (
            np.percentile(heights[1], _HEIGHT_PERCENT[0]),
            np.percentile(heights[0], _HEIGHT_PERCENT[1]),
        )
        return np.append(corners.min(axis=0), low), np.append(corners.max(axis=0), high)

    def _heights(self, rays: Array, focal: float) -> tuple[Array, Array]:
        """Heights of the points at which planes touch the vehicle, above and below."""
        angles, reach = self.planes(rays)
        pixels, ends = self.outlines[self.pairs], self.places[self.pairs]
        heights = []
        for touching in (angles.argmax(axis=-1), angles.argmin(axis=-1)):
            index = touching[..., None]
            off = np.abs(angles - np.take_along_axis(angles, index, -1)) * reach * focal
            near = (off < _TOUCH_PX)[..., None]
            long = np.where(near, pixels, -np.inf).max(2) - np.where(near, pixels, np.inf).min(2)
            points = np.linalg.norm(long, axis=-1) < _TOUCH_SHARE * np.ptp(pixels[..., 0], axis=-1)
            taken = np.take_along_axis(rays[self.pairs], index[..., None], 2)[:, :, 0]
            one, other = taken[:, 0], taken[:, 1]
            between = ends[:, 1] - ends[:, 0]
            # The rays meet in plan, where those of two places of the circle are never parallel.
            across = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
            depth = (between[:, 0] * other[:, 1] - between[:, 1] * other[:, 0]) / across
            found = depth * one[:, 2]
            single = found[points.all(axis=1)]
            heights.append(single if len(single) else found)
        return heights[0], heights[1]
