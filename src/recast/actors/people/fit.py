"""A body's build and gait, by masks and images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import torch
from torch import Tensor

from recast.actors.people.body import (
    DEVELOPMENT,
    STRIDE,
    WHEEL_RADIUS,
    BodySurface,
    PersonShape,
    surface_of,
)
from recast.actors.people.clothes import region_colours
from recast.actors.people.views import NOWHERE, PersonView, box_from_body, gait_of, gaussians_of
from recast.actors.segment import disc, grabcut
from recast.arrays import Array
from recast.splats import Gaussians
from recast.splats.gaussians import C0

_COARSE = 0.045
"""Metres between patches where bodies are compared with images."""
_STEPS_A_CYCLE = 24  # of phases that are tried
_MOST_VIEWS, _FEW_VIEWS = 24, 10  # where phases and where builds are tried
_RIDER, _RIDES_HIGH = 1.72, 1.6  # metres of a rider, and of its crown, below which it is smaller
_MOST_PX = 192  # of the longer side of an image, where bodies are compared
_NATURAL = 0.15  # deviation of the logarithm of a stride's length between people
_HABIT = 0.05  # cost of a stride that is off by that deviation, in one image
_LARGEST = np.array([0.18, 0.15, 0.07, 0.3, 0.12])  # see `_shaped`
_FIRST = np.array([0.06, 0.04, 0.03, 0.12, 0.05])
_ODD, _PACK = 0.01, 0.007  # cost of the largest values, and of a pack
_ROUNDS = 3
_TURNS = 2  # of masks, phases and build
_COLOUR = 1.0  # weight of display values beside outlines
_MASK_PX, _GRABCUTS = 40.0, 4  # pixels a metre of an image that is cut
_CLEAR = 0.4  # of what tells a person from the street, in the first guess of a mask
_ASIDE, _CORE = 0.12, 0.05  # metres outside of a body that may be it, and inside that are


@dataclass(frozen=True)
class PersonFit:
    """A body where the images show it.

    Attributes:
        shape: build and cycle.
        place: (2,) metres of the body's origin ahead and to the left of the box centre.
        phase: shares of a cycle that have passed where the way begins.
        cost: mean share of the mask's area by which outlines (and colours) differ.
    """

    shape: PersonShape
    place: Array
    phase: float
    cost: float


def shape_in(size: Array, cyclist: bool) -> PersonShape:
    """The body that a box of `size` (3,) metres holds, before any look at it."""
    length, _, height = (float(side) for side in size)
    if cyclist:
        rider = _RIDER * min(1.0, height / _RIDES_HIGH)
        return PersonShape(
            rider, bicycle=max(length, 4 * WHEEL_RADIUS), top=height, cycle=DEVELOPMENT
        )
    return PersonShape(1.01 * height, cycle=STRIDE * height)


@lru_cache(maxsize=4)
def _coarse_surface(shape: PersonShape) -> BodySurface:
    """The coarse body, kept while its place alone is moved. Not to be changed."""
    return surface_of(shape, _COARSE)


class _Drawn:
    """A coarse body in views, at any phase; white, or in the colours (R, 3) of its regions."""

    def __init__(
        self, shape: PersonShape, size: Array, place: Array, colours: Tensor | None = None
    ) -> None:
        self.surface, self._cycle = _coarse_surface(shape), shape.cycle
        self._weight = 0.0 if colours is None else _COLOUR
        pose = box_from_body(size, place)
        white = np.ones((len(self.surface.points), 3))
        self.gaussians = gaussians_of(self.surface, pose, white)
        self._gait = gait_of(self.surface, pose, shape.cycle, 0.0, NOWHERE)
        if colours is not None:
            sh = (colours[torch.from_numpy(self.surface.region)][:, None] - 0.5) / C0
            self.gaussians = replace(self.gaussians, sh=sh)

    def at(self, view: PersonView, phase: float) -> Gaussians:
        """The body in a view, at a phase where its way begins."""
        return self._gait.posed(self.gaussians, phase + view.gone / self._cycle)

    def cost(self, view: PersonView, phase: float) -> float:
        """How much a view differs."""
        with torch.no_grad():
            outline, colour = view.differs(*view.drawn(self.at(view, phase)))
        return outline + self._weight * colour


def fit_person(
    views: Sequence[PersonView],
    size: Array,
    cyclist: bool,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[PersonFit, list[PersonView]]:
    """Find phase and cycle, then masks about that body, then build and place; twice.

    Args:
        size: (3,) logged box, metres.
        progress: called with the number of parts done, and of all.

    Returns:
        The body, and the views with the masks that it was fitted to.
    """
    every = max(1, -(-len(views) // _MOST_VIEWS))
    few = [view.shrunk(_MOST_PX) for view in views[::every]]
    start = shape_in(size, cyclist)
    first = _timed(few, size, PersonFit(start, np.zeros(2), 0.0, np.inf))
    found, usual = [], np.zeros(len(_LARGEST))
    for pack in (False,) if cyclist else (False, True):
        fit = replace(first, shape=replace(first.shape, pack=pack))
        found.append(_turn(few, size, replace(start, pack=pack), fit, None, usual))
    fit, used, build = min(found, key=lambda one: one[0].cost + _PACK * one[0].shape.pack)
    for turn in range(1, _TURNS):
        if progress is not None:
            progress(turn, _TURNS)
        drawn = _Drawn(fit.shape, size, fit.place)
        posed = [drawn.at(view, fit.phase) for view in used]
        colours = region_colours(drawn.surface, posed, used)
        begin = replace(start, pack=fit.shape.pack)
        fit, used, build = _turn(few, size, begin, fit, colours, build)
    return fit, _outlined(views, size, fit)


def _turn(
    views: Sequence[PersonView],
    size: Array,
    start: PersonShape,
    fit: PersonFit,
    colours: Tensor | None,
    build: Array,
) -> tuple[PersonFit, list[PersonView], Array]:
    """Masks about a body, its phases, its build, and the phases again."""
    used = _outlined(views, size, fit)
    fit = _timed(used, size, fit, colours)
    build, fit = _built(
        used, size, replace(start, cycle=fit.shape.cycle), fit.phase, build, colours
    )
    return _timed(used, size, fit, colours), used, build


def _outlined(views: Sequence[PersonView], size: Array, fit: PersonFit) -> list[PersonView]:
    """The views with masks about a body, see `outlined`."""
    drawn = _Drawn(fit.shape, size, fit.place)
    return outlined(views, [drawn.at(view, fit.phase) for view in views])


def outlined(views: Sequence[PersonView], posed: Sequence[Gaussians]) -> list[PersonView]:
    """The views with masks of their own colours and edges about a body (GrabCut).

    The body's middle is the person's for sure, and what is far from it is not.

    Args:
        posed: the body in each view, in the view's box frame.
    """
    found = []
    for view, gaussians in zip(views, posed, strict=True):
        with torch.no_grad():
            alpha = view.drawn(gaussians)[1].numpy()
        per_metre = view.camera.fx / max(float(view.camera_from_object[2, 3]), 1.0)
        height, width = alpha.shape
        scale = max(1, round(_MASK_PX / per_metre))  # GrabCut takes whole pixels
        large, reach = (width * scale, height * scale), scale * per_metre
        body = (cv2.resize(alpha, large, interpolation=cv2.INTER_LINEAR) > 0.5).astype(np.uint8)
        trimap = np.full(body.shape, cv2.GC_BGD, np.uint8)
        trimap[cv2.dilate(body, disc(_ASIDE * reach)) > 0] = cv2.GC_PR_BGD
        clear = cv2.resize(view.apart, large, interpolation=cv2.INTER_LINEAR) > _CLEAR
        trimap[(body > 0) & clear] = cv2.GC_PR_FGD
        trimap[cv2.erode(body, disc(_CORE * reach)) > 0] = cv2.GC_FGD
        pixels = (view.image * 255).round().to(torch.uint8).numpy()
        image = np.asarray(cv2.resize(pixels, large, interpolation=cv2.INTER_CUBIC), np.uint8)
        mask = body > 0
        if mask.any() and not mask.all():
            mask = grabcut(image, trimap, _GRABCUTS)
        small = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        found.append(replace(view, mask=np.asarray(small, np.float32)))
    return found


def _timed(
    views: Sequence[PersonView], size: Array, fit: PersonFit, colours: Tensor | None = None
) -> PersonFit:
    """The phase, and of several views the cycle, at which the body differs least."""
    shape = fit.shape
    drawn = _Drawn(shape, size, fit.place, colours)
    phases = np.arange(_STEPS_A_CYCLE) / _STEPS_A_CYCLE
    gone = np.array([view.gone for view in views])
    costs = np.array(
        [[drawn.cost(view, phase - view.gone / shape.cycle) for phase in phases] for view in views]
    )
    weights = np.array([view.weight for view in views])
    usual = DEVELOPMENT if shape.bicycle else STRIDE * shape.height
    factors = np.exp(np.linspace(-0.35, 0.35, 57)) if np.ptp(gone) > 0 else np.ones(1)
    begins = np.arange(2 * _STEPS_A_CYCLE) / (2 * _STEPS_A_CYCLE)
    rows = np.arange(len(views))
    best = replace(fit, cost=np.inf)
    for factor in factors:
        place = (begins[:, None] + gone / (usual * factor)) % 1.0 * _STEPS_A_CYCLE
        low, share = place.astype(int) % _STEPS_A_CYCLE, place % 1.0
        cost = (1 - share) * costs[rows, low] + share * costs[rows, (low + 1) % _STEPS_A_CYCLE]
        # What the images do not tell, people's habit does.
        habit = _HABIT * (np.log(factor) / _NATURAL) ** 2 / np.sqrt(len(views))
        total = cost @ weights / weights.sum() + habit
        index = int(total.argmin())
        if total[index] < best.cost:
            known = replace(shape, cycle=float(usual * factor))
            best = PersonFit(known, fit.place, float(begins[index]), float(total[index]))
    return best


def _shaped(start: PersonShape, values: Array) -> PersonShape:
    """A shape by metres ahead and aside and the logarithms of height, girth and a rider's size."""
    tall = float(np.exp(values[2]))
    height = start.height * (float(np.exp(values[4])) if start.bicycle else tall)
    return replace(start, height=height, top=start.top * tall, girth=float(np.exp(values[3])))


def _built(
    views: Sequence[PersonView],
    size: Array,
    start: PersonShape,
    phase: float,
    build: Array,
    colours: Tensor | None,
) -> tuple[Array, PersonFit]:
    """Pattern search over place and shape, see `_shaped`."""
    used = views[:: max(1, -(-len(views) // _FEW_VIEWS))]
    weights = np.array([view.weight for view in used])

    def candidate(values: Array) -> PersonFit:
        shape = _shaped(start, values)
        drawn = _Drawn(shape, size, values[:2], colours)
        costs = [drawn.cost(view, phase) for view in used]
        odd = _ODD * float(np.sum((values / _LARGEST) ** 2))
        return PersonFit(shape, values[:2], phase, float(np.average(costs, weights=weights)) + odd)

    values, best = build, candidate(build)
    step = _FIRST.copy()
    for _ in range(_ROUNDS):
        for number in range(len(values) if start.bicycle else len(values) - 1):
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[number] += sign * step[number]
                moved = np.clip(moved, -_LARGEST, _LARGEST)
                tried = candidate(moved)
                if tried.cost < best.cost:
                    values, best = moved, tried
                    break
        step /= 2
    return values, best
