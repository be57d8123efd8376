"""The template generator: a parametric vehicle, photographs on it, and their light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from recast.actors.generate import VEHICLE, Asset, BaseGenerator
from recast.actors.observation import Observation
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import (
    SurfaceCloud,
    build_cloud,
    flat_gaussians,
    group_means,
    group_patches,
    shell_groups,
    tangents,
    voxel_ids,
)
from recast.actors.template.lighting import (
    CLEAR_DAY,
    Daylight,
    estimate_light,
    estimate_rims,
    estimate_windows,
    fit_harmonics,
    sh_basis,
    shade,
)
from recast.actors.template.materials import VehiclePart
from recast.actors.template.parts import (
    OVERLAP_WEIGHT,
    STEPS,
    PartEvidence,
    accepted,
    fit_parts,
    paint_colour,
    seen_patches,
    settled,
)
from recast.actors.template.proportions import (
    ShapeFit,
    Silhouette,
    TemplatePlacement,
    contour,
    find_axles,
    fit_shapes,
    place,
)
from recast.actors.template.texture import (
    SurfaceView,
    TemplateTexture,
    balanced,
    blended,
    mirrored_texture,
    view_surface,
)
from recast.arrays import Array, Int64Array
from recast.geometry.colour import linear_to_gamma
from recast.splats import MIP, Gaussians, concatenate
from recast.splats.gaussians import C0

_OPACITY = 0.99
_STYLES = 3  # offered to choose from
_WHEEL_REACH = 1.45  # wheel radii about an axle within which a photograph may show the wheel
_SAME_COLOUR = 0.12  # display values
_LESS_OVERLAP = 0.12  # of a further view with its mask than the first: it shows something else
_FOREIGN = (
    0.18  # of the painted surface: whole cars, two real and eight of seed 41, have 0.02 to 0.12
)

_DARK = 0.25  # level of the light
_PART_TRUST = 0.25  # between styles: a whole pane that is off is one error, not many
# Cost by which a style may be behind and still be chosen by its parts; not where so many LiDAR
# points tell its shape: an outline hardly tells a hatchback from an estate.
_CLOSE, _SOLID_POINTS = 12.0, 100
_ROUNDS = (STEPS, STEPS[1:])  # of parts and placement, each with the other
SKETCHED = 0.028
"""Edge in metres of the patches of a candidate, until it is chosen."""
_SKETCH_SPACING = 0.035  # metres: enough for a silhouette
_CELLS = (0.055, 0.03)  # metres: patches that look alike are merged in voxels of these edges
_TOLERANCE = 0.03  # display values
_BACKING_DEPTH = 0.05  # metres behind the surface
_BACKING_CELL = 0.10
_VIEW_DEPENDENCE = 0.3  # of the model's changing reflections, how much a photographed patch keeps


class TemplateGenerator(BaseGenerator):
    """Parametric vehicle in the style of AutoSplat's template: class shape, symmetry, photographs.

    A body of the class, bent to the LiDAR points and the outlines of the masks, with wheels,
    windows, lamps and plates, covered with flat Gaussians. Colours come from the crop that shows
    the surface best, from the mirror image if only the other side is shown, else from the template
    with the observed paint.

    Args:
        spacing: metres between surface patches before merging; larger is coarser and faster.
        style: body style to use instead of the fitted one.
    """

    name = "template"

    def __init__(self, spacing: float = 0.016, style: str | None = None) -> None:
        self.spacing = spacing
        self.style = style

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """Sketches of the body styles that fit LiDAR and outlines best, best first.

        Of several views, also what the best one gives alone.
        """
        fits = _fits(observation, seed, self.style)[:_STYLES]
        offered = [partial(self._sketch, observation, seed, [fit]) for fit in fits]
        if observation.further:
            offered.append(partial(self._sketch, replace(observation, further=()), seed))
        return offered

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Build the vehicle; it fills the logged box. See `ActorGenerator.generate`.

        A further view whose outline cannot be that of the vehicle is left out: `left_out` of the
        details counts these.
        """
        fits = _fits(observation, seed, self.style)
        return self._built(self._best(observation, seed, fits), seed, self.spacing)

    def _sketch(
        self, observation: Observation, seed: int, fits: list[ShapeFit] | None = None
    ) -> Asset:
        """The vehicle of the best fit, with coarse patches; its `finish` makes fine ones."""
        fits = _fits(observation, seed, self.style) if fits is None else fits
        best = self._best(observation, seed, fits)
        sketch = self._built(best, seed, max(self.spacing, SKETCHED))
        return replace(sketch, finish=partial(self._built, best, seed, self.spacing))

    def _best(self, observation: Observation, seed: int, fits: list[ShapeFit]) -> PlacedTemplate:
        """The fit whose parts and outline explain the views best, in those views that it can."""
        rng = np.random.default_rng(seed)
        spacing = max(self.spacing, _SKETCH_SPACING)
        close = _CLOSE if len(observation.points) < _SOLID_POINTS else 0.0
        likely = [fit for fit in fits[:_STYLES] if fit.cost <= fits[0].cost + close]
        placed = [_placed(observation, fit, spacing, rng) for fit in likely]
        best = max(placed, key=lambda one: one.total)
        least = best.placements[0].overlap - _LESS_OVERLAP
        fitting = [one.overlap >= least for one in best.placements]
        if all(fitting):
            return best
        kept = [one for one, fit in zip(observation.views, fitting, strict=True) if fit]
        fewer = replace(observation, further=tuple(kept[1:]))
        style = fits[0].style if len(fits) == 1 else self.style
        again = self._best(fewer, seed, _fits(fewer, seed, style))
        return replace(again, left_out=again.left_out + len(fitting) - sum(fitting))

    def _built(self, placed: PlacedTemplate, seed: int, spacing: float) -> Asset:
        """The vehicle of a placed template, with patches of an edge of `spacing` metres."""
        observation, body, placements = placed.observation, placed.body, placed.placements
        cloud = build_cloud(body, spacing, np.random.default_rng(seed))
        shown = [
            view_surface(cloud, view, placement)
            for view, placement in zip(observation.views, placements, strict=True)
        ]
        views = balanced(shown, cloud.paint > 0.9)
        light, paint = estimate_light(cloud, views, observation)
        doubts = _doubts(cloud, views[0], light, paint)
        rims = estimate_rims(cloud, views, light)
        for _ in range(2):  # what is no paint does not tell the paint
            views = _consistent(body, cloud, views, paint, light)
            light, paint = estimate_light(cloud, views, observation)
        seen = blended(views)
        strict = np.ones(len(cloud.points), bool)  # paint beside a pane is no pane
        clear = [
            accepted(view, cloud.part, _modelled(cloud, paint, light, view), strict)
            for view in views
        ]
        panes = estimate_windows(cloud, clear, light)
        texture = mirrored_texture(cloud, seen)
        distance = placed.fit.median_distance
        measured = {"median_lidar_distance_m": round(distance, 4)} if np.isfinite(distance) else {}
        return Asset(
            gaussians=vehicle_gaussians(body, cloud.dyed(panes, rims), paint, light, texture),
            axes=VEHICLE,
            generator=self.name,
            seed=seed,
            details={
                "style": placed.fit.style,
                "views": len(views),
                "paint_srgb": " ".join(f"{v:.3f}" for v in linear_to_gamma(paint)),
                "light": round(light.level, 3),
                "mirrored": round(light.mirror, 3),
                "clouds": round(light.clouds, 3),
                "contrast": round(light.contrast, 3),
                "tint": " ".join(f"{v:.3f}" for v in light.tint),
                "windows": " ".join(f"{v:.3f}" for v in panes),
                "rims": round(rims, 3),
                **measured,
                **({"doubts": doubts} if doubts else {}),
                **({"left_out": placed.left_out} if placed.left_out else {}),
                "silhouette_overlap": round(float(np.mean([one.overlap for one in placements])), 4),
                "seen_share": round(float((seen.weight > 0.5).mean()), 4),
            },
            low_pass=MIP,  # far away, thousands of small discs would grow by the filter of 3DGS
        )


def _doubts(cloud: SurfaceCloud, view: SurfaceView, light: Daylight, paint: Array) -> str:
    """What a person should look at in the best view, joined by "; "."""
    doubts = []
    strict = np.ones(len(cloud.points), bool)
    own = accepted(view, cloud.part, _modelled(cloud, paint, light, view), strict).weight
    body = cloud.on_body & (view.weight > 0.5) & (cloud.part == VehiclePart.PAINT)
    if body.any() and (other := float((own[body] < 0.75 * view.weight[body]).mean())) > _FOREIGN:
        doubts.append(
            f"{other:.0%} of the body that the image shows does not look like its paint: another "
            "vehicle or a load in the crop, a decal, dirt, or an open roof"
        )
    if light.level < _DARK:
        doubts.append("the image is as dark as at night: paint and light are guesses")
    return "; ".join(doubts)


@dataclass(frozen=True)
class PlacedTemplate:
    """A body with its parts where the views show them."""

    observation: Observation
    fit: ShapeFit
    body: TemplateBody
    placements: tuple[TemplatePlacement, ...]  # placement in each view
    agreement: float  # nats by which its parts explain the views
    left_out: int = 0  # further views that it cannot be in

    @property
    def total(self) -> float:
        """Nats by which parts, outlines and fit speak for it, to be compared between styles."""
        missed = sum(1 - one.overlap for one in self.placements)
        nats = self.fit.cost / 2  # a cost is in halves of nats
        return _PART_TRUST * self.agreement - OVERLAP_WEIGHT * missed - nats


def _placed(
    observation: Observation, fit: ShapeFit, spacing: float, rng: np.random.Generator
) -> PlacedTemplate:
    body = TemplateBody(observation.size, fit.design)
    sketch = build_cloud(body, spacing, rng)
    lidar = np.asarray(observation.points, np.float64)[:: max(1, len(observation.points) // 1200)]
    thin = np.unique(voxel_ids(sketch.points, 0.9 * spacing), return_index=True)[1]
    outside = sketch.points[thin]
    placements = place(body, outside, spacing, observation, lidar)
    silhouettes = [Silhouette(view, outside, spacing) for view in observation.views]
    agreement = 0.0
    for steps in _ROUNDS:
        views = [
            view_surface(sketch, view, placement)
            for view, placement in zip(observation.views, placements, strict=True)
        ]
        paint = paint_colour(views, sketch.on_body & (sketch.part == VehiclePart.PAINT))
        evidence = [PartEvidence.of(view, paint) for view in observation.views]
        seen = [
            seen_patches(sketch, *each) for each in zip(views, evidence, placements, strict=True)
        ]
        body = body.redesigned(find_axles(body, fit.design, observation, placements))
        body = fit_parts(body, seen, fit.design, steps)
        moved = [
            settled(placement, patches, body, shown, silhouette)
            for placement, patches, shown, silhouette in zip(
                placements, seen, evidence, silhouettes, strict=True
            )
        ]
        placements = tuple(one.placement for one in moved)
        agreement = sum(one.agreement for one in moved)
    return PlacedTemplate(observation, fit, body, placements, agreement)


def _consistent(
    body: TemplateBody,
    cloud: SurfaceCloud,
    views: Sequence[SurfaceView],
    paint: Array,
    light: Daylight,
) -> list[SurfaceView]:
    """The views without patches that show another part.

    The first view is believed but around the wheels, whose place and size are never quite right;
    of the others, what contradicts both the model and the first view is left out.
    """
    x, _, z = cloud.points.T
    arches = np.min([np.hypot(x - a, z - body.wheel_radius) for a in body.axles], axis=0)
    near_wheels = arches < _WHEEL_REACH * body.wheel_radius
    first = views[0]
    kept = []
    for view in views:
        apart = np.linalg.norm(view.colour - first.colour, axis=1)
        same = (first.weight > 0.5) & (apart < _SAME_COLOUR)
        strict = near_wheels | ((view is not first) & ~same)
        modelled = _modelled(cloud, paint, light, view)
        kept.append(accepted(view, cloud.part, modelled, strict))
    return kept


def _modelled(cloud: SurfaceCloud, paint: Array, light: Daylight, view: SurfaceView) -> Array:
    """Display colours (N, 3) of paint on every patch, as a view's camera would see it."""
    count = len(cloud.points)
    albedo = np.broadcast_to(paint, (count, 3))
    return shade(albedo, np.ones(count), cloud.normals, cloud.points[:, 2], view.views, light)


def _fits(observation: Observation, seed: int, style: str | None) -> list[ShapeFit]:
    outlines = [contour(view) for view in observation.views]
    rng = np.random.default_rng(seed)
    return fit_shapes(
        observation.category, observation.size, observation.points, rng, style, outlines
    )


def vehicle_gaussians(
    body: TemplateBody,
    cloud: SurfaceCloud,
    paint: Array,
    light: Daylight = CLEAR_DAY,
    texture: TemplateTexture | None = None,
) -> Gaussians:
    """The vehicle in the actor frame: merged patches with light and photographs, and a shell.

    Args:
        cloud: the patches of the body.
        paint: (3,) linear reflectance.
        texture: what photographs show; nothing if None.
    """
    texture = texture or TemplateTexture.nothing(len(cloud.points))
    albedo = cloud.painted(paint)
    weight = texture.weight[:, None]
    look = (1 - weight) * linear_to_gamma(light.level * albedo) + weight * texture.colour
    edges = cloud.on_body & (cloud.spacing < cloud.spacing.max())
    group = group_patches(
        cloud.points, cloud.normals, np.c_[look, 0.1 * cloud.gloss], _CELLS, _TOLERANCE, edges
    )
    sh = _harmonics(group, cloud, albedo, texture, light)
    outside = flat_gaussians(group, cloud.points, cloud.normals, cloud.spacing, sh, _OPACITY)
    whole = concatenate([outside, _backing(body, cloud, sh[group])])
    shift = whole.means.new_tensor([0.0, 0.0, -body.height / 2])
    return replace(whole, means=whole.means + shift)


def _backing(body: TemplateBody, cloud: SurfaceCloud, sh: Array) -> Gaussians:
    """A coarse shell behind the surface, so that the far side does not shine through its gaps."""
    inner = cloud.points - _BACKING_DEPTH * cloud.normals
    first, second = tangents(cloud.normals)
    covered = cloud.on_body.copy()
    for direction in (first, -first, second, -second):
        # a wide Gaussian must not stick out at sills and wheel arches
        covered &= body.distance(inner + 1.3 * _BACKING_CELL * direction) < -0.01
    kept = np.flatnonzero(covered)
    shell = shell_groups(cloud.points[kept], cloud.normals[kept], _BACKING_CELL)
    return flat_gaussians(
        shell,
        inner[kept],
        cloud.normals[kept],
        cloud.spacing[kept],
        group_means(shell, sh[kept])[0],
        _OPACITY,
    )


def _harmonics(
    group: Int64Array, cloud: SurfaceCloud, albedo: Array, texture: TemplateTexture, light: Daylight
) -> Array:
    """Harmonics (G, 4, 3) of each group: the lit model, moved onto the photograph where seen."""
    points, normals, albedo, gloss, colour, weight, views = group_means(
        group,
        cloud.points,
        cloud.normals,
        albedo,
        cloud.gloss,
        texture.colour,
        texture.weight,
        texture.views,
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    views = views / np.maximum(np.linalg.norm(views, axis=1, keepdims=True), 1e-9)
    sh = fit_harmonics(albedo, gloss, normals, points[:, 2], light)
    sh[:, 1:] *= (1 - (1 - _VIEW_DEPENDENCE) * weight)[:, None, None]
    modelled = 0.5 + np.einsum("nk,nkc->nc", sh_basis(-views), sh)
    sh[:, 0] += weight[:, None] * (colour - modelled) / C0
    return sh
