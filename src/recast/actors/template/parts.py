"""Which part of the vehicle a pixel shows, and the design moved to where its parts are seen.

A colour alone tells parts apart: tail lamps are red, panes and grilles dark and grey, plates
bright, and paint is what most of the body is. A design and a placement are right if the patches
of each part lie on pixels that look like it; and a photograph colours a patch only if it does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import Observation
from recast.actors.place import minimum
from recast.actors.template.body import BodyPanels, TemplateBody
from recast.actors.template.cloud import SurfaceCloud
from recast.actors.template.design import Proportions, VehicleDesign, in_order, limits, options
from recast.actors.template.materials import PART_OF_MATERIAL, VehiclePart, label_body
from recast.actors.template.proportions import Silhouette, TemplatePlacement
from recast.actors.template.texture import SurfaceView
from recast.arrays import Array, Int64Array
from recast.geometry import se3
from recast.geometry.colour import cielab

# Mean and deviation of each part's colour, CIE Lab; paint's mean is measured.
_COLOURS: dict[VehiclePart, tuple[tuple[float, ...], tuple[float, ...]]] = {
    VehiclePart.PAINT: ((0, 0, 0), (20, 7, 8)),
    VehiclePart.GLASS: ((30, 0, -1), (18, 5, 7)),
    VehiclePart.DARK: ((14, 0, 0), (12, 6, 6)),
    VehiclePart.RED: ((34, 40, 22), (15, 17, 14)),
    VehiclePart.CLEAR: ((66, 0, 0), (20, 7, 8)),
    VehiclePart.PLATE: ((72, 0, 4), (16, 7, 14)),
}
_CHROMA = 0.25  # by which the deviation of a paint's chroma grows with its chroma: light and shade
# A colour that no part has says nothing about parts; the own part's floor is the lower one.
_FLOOR, _OTHERS_FLOOR = -16.0, -14.0
_OUTSIDE = -3.0  # log likelihood of a patch that lies beside the mask


def to_lab(display: Array) -> Array:
    """CIE Lab (..., 3) of display colours (..., 3), clipped to [0, 1]."""
    return cielab(np.clip(display, 0, 1))


def part_likelihoods(lab: Array, paint: Array) -> Array:
    """Log likelihoods (..., parts) of colours (..., 3) under each part; `paint` (..., 3), Lab."""
    found = []
    for part in VehiclePart:
        mean, deviation = (np.array(values, np.float64) for values in _COLOURS[part])
        if part == VehiclePart.PAINT:
            mean = paint
            chroma = np.linalg.norm(paint[..., 1:], axis=-1, keepdims=True)
            deviation = deviation + _CHROMA * chroma * np.array([0.0, 1.0, 1.0])
        apart = (lab - mean) / deviation
        found.append(-0.5 * np.sum(apart**2, axis=-1) - np.sum(np.log(deviation), axis=-1))
    likelihoods = np.stack(found, axis=-1)
    return np.maximum(likelihoods, _FLOOR)


def accepted(
    view: SurfaceView, part: Int64Array, modelled: Array, strict: NDArray[np.bool_]
) -> SurfaceView:
    """The view without what it shows of other parts, on those patches where that may happen.

    Args:
        part: (N,) part of each patch, see `VehiclePart`.
        modelled: (N, 3) display colours of painted patches as the fitted light shows them.
        strict: (N,) patches that must look like their own part; the others are believed.
    """
    likelihoods = part_likelihoods(to_lab(view.colour), to_lab(modelled))
    own = _own(likelihoods, part)
    np.put_along_axis(likelihoods, part[:, None], -np.inf, axis=1)
    ahead = own - np.maximum(likelihoods.max(axis=1), _OTHERS_FLOOR)
    trust = np.clip((ahead + _TOLERANT) / _SOFT, 0.0, 1.0)
    return replace(view, weight=view.weight * np.where(strict, trust, 1.0))


_TOLERANT, _SOFT = 3.0, 2.0  # nats by which another part may fit better, and the way down


@dataclass(frozen=True)
class PartEvidence:
    """What each pixel of one view says of parts."""

    observation: Observation
    scores: NDArray[np.float32]  # (H, W, parts) log likelihoods

    @staticmethod
    def of(observation: Observation, paint: Array) -> PartEvidence:
        """The evidence of a view of a vehicle of such a paint (3,), CIE Lab."""
        image = np.asarray(observation.rgba[..., :3], np.float64) / 255
        scores = part_likelihoods(to_lab(image), paint)
        scores -= scores.mean(axis=-1, keepdims=True)
        scores = np.clip(scores, -6.0, 6.0)
        scores[observation.rgba[..., 3] <= 127] = _OUTSIDE
        return PartEvidence(observation, scores.astype(np.float32))

    def sampled(self, placed: Array) -> Array:
        """Log likelihoods (N, parts) at points (N, 3) of the box frame."""
        to_camera = self.observation.camera_from_object
        pixels, _ = self.observation.camera.project(se3.apply(to_camera, placed))
        height, width = self.scores.shape[:2]
        u, v = np.floor(pixels).astype(np.int64).T
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        found = np.full((len(placed), len(VehiclePart)), _OUTSIDE)
        found[inside] = self.scores[v[inside], u[inside]]
        return found


@dataclass(frozen=True)
class SeenPatches:
    """Body patches that one view shows, with what it says of them."""

    points: Array  # (N, 3) model frame
    normals: Array  # (N, 3)
    scores: Array  # (N, parts)
    weight: Array  # (N,) adds up to the view's share


STEPS = (0.20, 0.10, 0.05)
"""Shares of a number's range that it is moved by."""


def fit_parts(
    body: TemplateBody,
    seen: Sequence[SeenPatches],
    usual: VehicleDesign,
    steps: Sequence[float] = STEPS,
) -> TemplateBody:
    """The body with the parts of its design where the views show them.

    Every number and every choice of the design is tried at other values, in turn, and kept where
    the patches then fit their pixels better by more than the change costs; the body's shape is
    fitted before, by outlines and LiDAR, and is not changed.

    Args:
        body: body with the design to start from.
        seen: patches of each view on that body.
        usual: design that numbers are drawn to.
        steps: shares of a number's range that it is moved by, one after the other.
    """
    if not seen:
        return body
    every = max(1, sum(len(one.points) for one in seen) // _MOST_PATCHES)
    points, normals, scores, weight = (
        np.concatenate([getattr(one, name)[::every] for one in seen])
        for name in ("points", "normals", "scores", "weight")
    )
    weight = weight * every
    shapes = {body.design.proportions: (body, body.panels(points))}

    def shaped(shape: Proportions) -> tuple[TemplateBody, BodyPanels]:
        if shape not in shapes:
            other = body.redesigned(replace(body.design, proportions=shape))
            shapes[shape] = other, other.panels(points)
        return shapes[shape]

    def labelled(design: VehicleDesign) -> Int64Array:
        other, panels = shaped(design.proportions)
        return PART_OF_MATERIAL[label_body(other.redesigned(design), points, normals, panels)]

    def gain(design: VehicleDesign, part: Int64Array) -> float:
        return float(weight @ _own(scores, part)) - _cost(design, usual)

    shown = {
        "front": weight[normals[:, 0] > 0.5].sum() > _LEAST_SHOWN * weight.sum(),
        "rear": weight[normals[:, 0] < -0.5].sum() > _LEAST_SHOWN * weight.sum(),
    }
    tried = [knob for knob in knobs() if shown.get(knob.group, True)]
    best, now = body.design, labelled(body.design)
    value = gain(best, now)
    for step in steps:
        matter = []  # knobs that moved a visible patch, and have more than one step
        for knob in tried:
            for other in knob.moved(best, step):
                part = labelled(other)
                if np.array_equal(part, now):
                    continue
                if knob.limits is not None and knob not in matter:
                    matter.append(knob)
                if (found := gain(other, part)) > value + _LEAST_GAIN:
                    best, now, value = other, part, found
        tried = matter
    return body.redesigned(best)


_MOST_PATCHES = 2500
_LEAST_SHOWN = 0.03  # share of the weight that must lie on an end of the vehicle
_MEASUREMENTS = 150.0  # independent ones in a view that shows the vehicle squarely
_LEAST_GAIN = 0.1  # nats
_NUMBER_SPREAD = 0.15  # of its range, by which a number differs from the usual one
_CHOICE_COST = 1.5  # nats of a choice that is not the usual one


@dataclass(frozen=True)
class DesignKnob:
    """A choice of a design, or numbers that move together."""

    group: str
    names: tuple[str, ...]
    limits: tuple[float, float] | None
    choices: tuple[Any, ...] = ()

    def moved(self, design: VehicleDesign, step: float) -> Iterator[VehicleDesign]:
        """Designs with other values: a step of the range up and down, or every other choice."""
        part = getattr(design, self.group)
        now = [getattr(part, name) for name in self.names]
        if self.limits is None:
            others = [[one] for one in self.choices if one != now[0]]
        else:
            low, high = self.limits
            ways = [sign * step * (high - low) for sign in (-1, 1)]
            others = [[float(np.clip(v + way, low, high)) for v in now] for way in ways]
        for values in others:
            changes: dict[str, Any] = {
                self.group: replace(part, **dict(zip(self.names, values, strict=True)))
            }
            other = replace(design, **changes)
            if values != now and in_order(other):  # not at a limit
                yield other

    def cost(self, design: VehicleDesign, usual: VehicleDesign) -> float:
        """Nats that the difference from the usual values costs; pairs are counted singly."""
        if len(self.names) > 1:
            return 0.0
        value, expected = (getattr(getattr(d, self.group), self.names[0]) for d in (design, usual))
        if self.limits is None:
            return 0.0 if value == expected else _CHOICE_COST
        low, high = self.limits
        return 0.5 * ((value - expected) / (_NUMBER_SPREAD * (high - low))) ** 2


def _cost(design: VehicleDesign, usual: VehicleDesign) -> float:
    return sum(knob.cost(design, usual) for knob in knobs())


@cache
def knobs() -> tuple[DesignKnob, ...]:
    """Every number and choice that colours tell, by the annotations of the design's fields."""
    found: list[DesignKnob] = []
    for group, kind in get_type_hints(VehicleDesign).items():
        if group == "rim":  # wheels are no part of the body
            continue
        ranges, choices = limits(kind), options(kind)
        for name in (field.name for field in fields(kind)):
            if group != "proportions" or name in _LANDMARKS:
                knob = DesignKnob(group, (name,), ranges.get(name), choices.get(name, ()))
                found.append(knob)
    found += [DesignKnob(group, names, (0.0, 1.0)) for group, names in _TOGETHER]
    return tuple(found)


# The body's landmark that colours tell and outlines do not; the others stay as fitted.
_LANDMARKS = ("belt_rear_z",)
_TOGETHER = (
    ("rear", ("lamp_low", "lamp_high")),
    ("front", ("lamp_z", "grille_z")),
    ("side", ("pillar_b_x", "pillar_c_x")),
)


def settled(
    placement: TemplatePlacement,
    seen: SeenPatches,
    body: TemplateBody,
    evidence: PartEvidence,
    outline: Silhouette,
) -> SettledView:
    """The placement moved across its view, and turned, to where the parts are seen.

    Args:
        body: body on which the patches lie.
        outline: silhouette of the model against the view's mask.
    """
    across = evidence.observation.camera_from_object[:2, :3]
    part = PART_OF_MATERIAL[label_body(body, seen.points, seen.normals)]

    def moved(x: Array) -> TemplatePlacement:
        shift = placement.shift + _SHIFT_SPREAD * x[:2] @ across
        return replace(placement, shift=shift, yaw=placement.yaw + _YAW_SPREAD * float(x[2]))

    def fit(placed: TemplatePlacement) -> float:
        return float(seen.weight @ _own(evidence.sampled(placed.points(seen.points)), part))

    def cost(x: Array) -> float:
        other = moved(x)
        return OVERLAP_WEIGHT * (1 - outline.overlap(other)) - fit(other) + 0.5 * float(x @ x)

    best = moved(minimum(cost, 3, 60, xatol=0.05, fatol=0.05))
    return SettledView(outline.judged(best), fit(best))


@dataclass(frozen=True)
class SettledView:
    """Where the vehicle is in one view."""

    placement: TemplatePlacement
    agreement: float  # nats by which its parts explain the view


_SHIFT_SPREAD, _YAW_SPREAD = 0.06, np.radians(1.5)  # metres, radians: labels are off in one frame
OVERLAP_WEIGHT = 60.0
"""Nats of the whole overlap of an outline with its mask."""


def _own(scores: Array, part: Int64Array) -> Array:
    return np.take_along_axis(scores, part[:, None], axis=1)[:, 0]


def paint_colour(seen: Sequence[SurfaceView], painted: NDArray[np.bool_]) -> Array:
    """Colour (3,) of the paint, CIE Lab: median of the patches that should show it.

    Args:
        painted: (N,) patches whose part is paint.
    """
    colours = np.concatenate([one.colour[painted & (one.weight > 0.5)] for one in seen])
    if len(colours) < _FEW:
        return np.array([50.0, 0.0, 0.0])
    lab = to_lab(colours)
    middle = np.median(lab, axis=0)
    for _ in range(4):  # towards where most of them are
        near = np.linalg.norm((lab - middle) / [25.0, 10.0, 10.0], axis=1) < 1.0
        if near.sum() < _FEW:
            break
        middle = np.median(lab[near], axis=0)
    return np.asarray(middle)


_FEW = 20  # patches


def seen_patches(
    cloud: SurfaceCloud, view: SurfaceView, evidence: PartEvidence, placement: TemplatePlacement
) -> SeenPatches:
    """What one view says of a body's patches."""
    shown = cloud.on_body & (view.weight > 0.2)
    area = view.weight[shown] * cloud.spacing[shown] ** 2
    total = float(area.sum())
    fine = float(np.median(view.sharpness[shown])) / _FINE if shown.any() else 0.0
    share = _MEASUREMENTS * min(total / _WHOLE_VIEW, 1.0) * min(fine, 1.0)
    points = cloud.points[shown]
    return SeenPatches(
        points,
        cloud.normals[shown],
        evidence.sampled(placement.points(points)),
        area * share / max(total, 1e-9),
    )


_FINE = 60.0  # pixels a metre from which lamps and plates are several pixels high
_WHOLE_VIEW = 5.0  # square metres that a view of two sides of a car shows
