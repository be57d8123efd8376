"""A car body as an implicit surface, negative inside, about metres nearby; and its fittings.

Box frame shifted to the ground: x forward from the middle, y left, z up from the ground. The lower
body and the greenhouse are each a rounded intersection of curved half spaces (one for every panel),
joined by a rounded union; wheel wells are cut out. A panel's own function also tells how far a
surface point lies from the panel's border, which is how windows get their frames. Wheels and
mirrors are points of the left side; the right side mirrors them.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator

from recast.actors.template.materials import TemplateMaterial
from recast.arrays import Array, Int64Array
from recast.geometry.boxes import smooth_max

if TYPE_CHECKING:
    from recast.actors.template.design import VehicleDesign


_UPSWEEP = 0.10  # slope by which the underside rises towards the bumpers


@dataclass(frozen=True)
class BodyPanels:
    """Signed distances (N,) to the single panels at N points, negative on the inner side."""

    windscreen: Array
    rear_window: Array
    roof: Array
    side_window: Array
    shoulder: Array
    side: Array
    nose: Array
    tail: Array
    bottom: Array
    greenhouse: Array
    lower: Array

    def at(self, index: Int64Array) -> BodyPanels:
        """The distances of some of the points (M,)."""
        return BodyPanels(*(values[index] for values in self.__dict__.values()))


class TemplateBody:
    """The implicit body of a vehicle of given box and design.

    Args:
        size: (3,) length, width, height in metres; the body touches all faces of the box but the
            bottom one, which the wheels touch.
        design: landmarks and parts.
    """

    def __init__(self, size: Array, design: VehicleDesign) -> None:
        self.size = np.asarray(size, np.float64)
        self.design = design
        p = design.proportions
        self.length, self.width, self.height = (float(v) for v in self.size)
        lateral = self.width / 1.75
        self.tumblehome = p.tumblehome * lateral
        self.wheel_radius = min(p.wheel_radius, 0.27 * self.height)
        self.wheel_width = 0.205 * lateral
        self.axles = (self.x_at(p.front_axle_x), self.x_at(p.rear_axle_x))
        self.clearance = p.clearance_z * self.height
        knots = [
            (1.02, p.deck_z - 0.015),
            (max(0.985, p.tail_x + 0.006), p.deck_z),
            (p.tail_x, p.tail_z),
            (0.55, 0.5 * (p.cowl_z + p.belt_rear_z)),
            (p.cowl_x, p.cowl_z),
            (0.5 * p.cowl_x + 0.02, 0.45 * p.bonnet_z + 0.55 * p.cowl_z),
            (min(0.045, 0.3 * p.cowl_x), p.bonnet_z),
            (-0.02, p.bonnet_z - 0.05),
        ]
        if p.tail_x < 0.7:  # a bed, not a boot: flat behind the cab
            knots[2] = (0.62, p.deck_z)
        knots = sorted((self.x_at(fraction), z * self.height) for fraction, z in knots)
        xs, zs = np.array(knots).T
        xs = np.maximum.accumulate(xs) + 1e-4 * np.arange(len(xs))  # none may coincide
        grid = np.linspace(-0.6, 0.6, 241) * self.length
        profile = PchipInterpolator(xs, zs)(np.clip(grid, xs[0], xs[-1]))
        self._profile = (grid, profile)

    def redesigned(self, design: VehicleDesign) -> TemplateBody:
        """The body of the same box with another design."""
        if design.proportions != self.design.proportions:
            return TemplateBody(self.size, design)
        other = copy(self)
        other.design = design
        return other

    def x_at(self, fraction: float) -> float:
        """x in metres of a fraction of the length behind the front bumper."""
        return self.length * (0.5 - fraction)

    @property
    def bumper_low(self) -> float:
        """Height of the lower edge of both bumpers, metres."""
        return self.clearance + _UPSWEEP * 0.14 * self.length

    def shoulder_z(self, x: Array) -> Array:
        """Height of the lower body's upper profile along x: bonnet, window sill, boot lid."""
        return np.interp(x, *self._profile)

    def half_width(self, x: Array, z: Array) -> Array:
        """Half width of the lower body: a barrel with a shoulder and flared wheel arches."""
        s = self.width / 1.75
        widest = 0.42 * self.height
        above = np.maximum(z - widest, 0.0) / (0.30 * self.height)
        below = np.maximum(widest - z, 0.0) / (0.32 * self.height)
        taper = 0.045 * s * np.abs(2 * x / self.length) ** 4
        crease = 0.010 * s * np.exp(-(((z - 0.555 * self.height) / 0.03) ** 2))
        flare = sum(
            (
                np.exp(-(((np.hypot(x - a, z - self.wheel_radius) - self.arch_radius) / 0.05) ** 2))
                for a in self.axles
            ),
            start=np.zeros_like(x),
        )
        return (
            self.width / 2
            - 0.016
            - s * (0.055 * above**2 + 0.05 * below**2)
            - taper
            + crease
            + (0.012 + 0.12 * self.design.side.cladding) * s * flare
        )

    @property
    def arch_radius(self) -> float:
        """Radius of the wheel arch openings, metres."""
        return 1.13 * self.wheel_radius

    def panels(self, points: Array) -> BodyPanels:
        """Distances of points (N, 3) to each panel."""
        p, H, L = self.design.proportions, self.height, self.length
        x, y, z = points.T
        across = np.abs(2 * y / self.width)
        lateral = self.width / 1.75
        middle_z = 0.36 * H

        nose = (
            x
            - L / 2
            + p.nose_bow * lateral * across**2.6
            + p.nose_lean * (np.maximum(z - middle_z, 0.0) / (0.2 * H)) ** 2
            + 0.035 * (np.maximum(middle_z - z, 0.0) / (0.22 * H)) ** 2
        )
        tail = (
            -L / 2
            - x
            + p.tail_bow * lateral * across**3
            + p.tail_lean * (np.maximum(z - middle_z, 0.0) / (0.25 * H)) ** 2
            + 0.06 * (np.maximum(middle_z - z, 0.0) / (0.22 * H)) ** 2
        )
        side = np.abs(y) - self.half_width(x, z)
        shoulder = (z - self.shoulder_z(x) + 0.055 * lateral * across**2) * 0.95
        ends = np.maximum(np.abs(x) - 0.36 * L, 0.0)
        bottom = self.clearance + _UPSWEEP * ends**2 / (0.14 * L) - z
        edge = 0.09 * lateral
        ends = smooth_max([nose, tail], 0.05)
        lower = smooth_max([smooth_max([shoulder, side], edge), ends], edge)
        lower = smooth_max([lower, bottom], 0.06)

        windscreen = self._raked(
            x + 0.13 * lateral * across**2, z, p.cowl_x, p.cowl_z, p.roof_front_x, 0.985, 1.0
        )
        rear_window = self._raked(
            x - 0.09 * lateral * across**2,
            z,
            p.tail_x,
            p.tail_z,
            p.roof_rear_x,
            p.roof_rear_z,
            -1.0,
        )
        crown_x = self.x_at(0.55 * p.roof_front_x + 0.45 * p.roof_rear_x)
        reach = self.x_at(p.roof_rear_x) - crown_x
        drop = (1 - p.roof_rear_z) * np.minimum(((x - crown_x) / reach) ** 2, 2.0)
        roof = z - H * (1 - drop) + 0.045 * lateral * across**2
        belt = p.cowl_z * H
        rise = np.clip((z - belt) / max(H - belt, 0.2), -0.5, 1.2)
        plan = 0.30 * self.tumblehome * (2 * (x + 0.05 * L) / L) ** 2
        side_window = np.abs(y) - (
            self.width / 2 - 0.055 * lateral - plan - self.tumblehome * rise - 0.03 * rise**2
        )
        radius = p.edge_radius * lateral
        windows = smooth_max([windscreen, rear_window], 0.05)
        greenhouse = smooth_max([windows, side_window, roof], radius)
        outside = np.maximum(np.maximum(nose, tail), 0.6 * belt - z)
        greenhouse = smooth_max([greenhouse, outside], 0.04)
        return BodyPanels(
            windscreen,
            rear_window,
            roof,
            side_window,
            shoulder,
            side,
            nose,
            tail,
            bottom,
            greenhouse,
            lower,
        )

    def _raked(
        self,
        x: Array,
        z: Array,
        low_x: float,
        low_z: float,
        top_x: float,
        top_z: float,
        sign: float,
    ) -> Array:
        """Distance to the slightly bulging pane through two landmarks; `sign` +1 faces forward."""
        x0, x1 = self.x_at(low_x), self.x_at(top_x)
        z0, z1 = low_z * self.height, top_z * self.height
        norm = np.hypot(x1 - x0, z1 - z0)
        along = np.clip((z - z0) / (z1 - z0), 0.0, 1.0)
        bulge = 0.05 * norm * along * (1 - along)
        return sign * ((z1 - z0) * (x - x0) - (x1 - x0) * (z - z0)) / norm - bulge

    def wells(self, points: Array) -> Array:
        """Distance to the wheel wells (N,), negative inside them."""
        x, y, z = points.T
        inner = self.width / 2 - 0.30 * self.width / 1.75
        nearest = np.min([np.hypot(x - a, z - self.wheel_radius) for a in self.axles], axis=0)
        return np.maximum(nearest - self.arch_radius, inner - np.abs(y))

    def distance(self, points: Array) -> Array:
        """Signed distance (N,), approximate, of points (N, 3) to the body without wheels."""
        panels = self.panels(points)
        union = -smooth_max([-panels.lower, -panels.greenhouse], 0.04)
        beyond = np.max(np.abs(points[:, :2]) - self.size[:2] / 2, axis=1)
        return np.maximum(np.maximum(union, -self.wells(points)), beyond)


def wheel(body: TemplateBody, axle_x: float, spacing: float) -> tuple[Array, Array, Int64Array]:
    """Points (N, 3), outward normals (N, 3) and materials (N,) of the left wheel on one axle.

    A lathed tyre and rim; the gaps between the spokes lie 5 cm behind them, those of a wheel cover
    1 cm. Points are `spacing` metres apart.
    """
    r, w, rim = body.wheel_radius, body.wheel_width, body.design.rim
    q = rim.share * r  # radius of the rim
    profile = np.array(
        [
            (0.0, -0.03),
            (0.20 * q, -0.03),
            (0.27 * q, -0.045),
            (0.88 * q, -0.025),
            (0.96 * q, -0.005),
            (1.01 * q, -0.018),
            (0.55 * q + 0.45 * r, 0.0),
            (0.95 * r, -0.018),
            (r, -0.05),
            (r, -w + 0.05),
            (0.95 * r, -w + 0.018),
            (0.8 * r, -w),
            (0.5 * r, -w),
        ]
    )
    radii, depths, slopes = [], [], []
    for (r0, d0), (r1, d1) in pairwise(profile):
        n = max(1, int(np.ceil(np.hypot(r1 - r0, d1 - d0) / spacing)))
        t = (np.arange(n) + 0.5) / n
        radii.append(r0 + t * (r1 - r0))
        depths.append(d0 + t * (d1 - d0))
        slopes.append(np.tile([(d0 - d1), (r1 - r0)], (n, 1)) / np.hypot(r1 - r0, d1 - d0))
    rings = np.concatenate(radii), np.concatenate(depths), np.concatenate(slopes)
    per_ring = np.maximum(6, np.ceil(2 * np.pi * rings[0] / spacing)).astype(int)
    ring = np.repeat(np.arange(len(per_ring)), per_ring)
    within = np.arange(len(ring)) - np.repeat(np.cumsum(per_ring) - per_ring, per_ring)
    angle = 2 * np.pi * (within + 0.5 * (ring % 2)) / per_ring[ring]
    radius, depth, slope = rings[0][ring], rings[1][ring], rings[2][ring]

    labels = np.full(len(ring), int(TemplateMaterial.TYRE))
    outer = depth > -0.06
    metal = outer & (radius < q)
    labels[metal] = {
        "alloy": TemplateMaterial.ALLOY,
        "dark": TemplateMaterial.DARK_ALLOY,
        "cover": TemplateMaterial.COVER,
    }[rim.kind]
    # 0 in the middle of a spoke, 0.5 between two; spokes taper a little towards the rim
    fold = np.abs((angle / (2 * np.pi) * round(rim.spokes) + 0.5) % 1 - 0.5)
    wide = rim.spoke_width / 2 * (0.75 + 0.35 * 0.6 * q / np.maximum(radius, 0.2 * q))
    cover = rim.kind == "cover"
    between = metal & (radius > (0.52 if cover else 0.27) * q) & (radius < 0.87 * q)
    gap = between & (fold > (0.3 if cover else wide))
    if rim.pairs and not cover:
        gap |= between & (fold < 0.25 * wide) & (radius > 0.4 * q)
    labels[gap] = TemplateMaterial.WHEEL_GAP
    labels[metal & (radius > 0.975 * q)] = TemplateMaterial.WHEEL_GAP
    labels[outer & (radius < 0.08 * q)] = TemplateMaterial.WHEEL_GAP
    depth = np.where(gap, depth - (0.01 if cover else 0.05), depth)

    cos, sin = np.cos(angle), np.sin(angle)
    centre = np.array([axle_x, body.width / 2 - 0.012, r])
    points = centre + np.stack([radius * cos, depth, radius * sin], axis=-1)
    normals = np.stack([slope[:, 0] * cos, slope[:, 1], slope[:, 0] * sin], axis=-1)
    return points, normals, labels


def mirror(body: TemplateBody, spacing: float) -> tuple[Array, Array, Int64Array]:
    """Points, normals and materials of the left outside mirror, 8 cm beyond the box."""
    p = body.design.proportions
    scale = np.clip(body.height / 1.5, 1.0, 1.8)
    radii = np.array([0.06, 0.095, 0.065 * scale]) * np.array([1.0, 1.0, scale])
    x = body.x_at(p.cowl_x) - 0.42 * body.height / 1.5
    x = min(x, body.x_at(p.cowl_x + 0.02))
    z = p.cowl_z * body.height + 0.07 * scale
    centre = np.array([x, body.width / 2 - 0.01, z])
    count = int(4 * np.pi * 0.075**2 * scale**2 / spacing**2) + 50
    index = np.arange(count) + 0.5
    up = 1 - 2 * index / count  # Fibonacci sphere
    around = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - up**2)
    unit = np.stack([ring * np.cos(around), ring * np.sin(around), up], axis=-1)
    labels = np.full(count, int(TemplateMaterial.PAINT))
    labels[unit[:, 0] < -0.5] = TemplateMaterial.GLASS
    labels[unit[:, 2] < -0.8] = TemplateMaterial.TRIM
    normals = unit / radii
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return centre + unit * radii, normals, labels
