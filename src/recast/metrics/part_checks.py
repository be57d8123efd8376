"""Whether a drawn vehicle shows the parts that its photograph shows: wheels, lamps, plate, windows.

Every visible side of the box is brought to a picture in metres (the plane of that side, as the
known camera sees it), of the photograph and of the render alike. The same detectors then run on
both. A part passes if the render has it where the photograph has it, and nowhere else. What the
photograph does not decide, such as the tail lamps of a red car, is left out and counted.

Constants were chosen on the Honda Civic and the Toyota Alphard and on vehicles of the synthetic
world (seeds from 40 on); no constant was chosen on another real car.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Image, Mask
from recast.geometry.colour import cielab
from recast.metrics.actor_scores import ActorView, ScoredCutout

Side = Literal["front", "left", "rear", "right"]
PARTS = ("wheels", "windows", "head lamps", "tail lamps", "plate")
PIXELS_PER_METRE = 80
STEEPEST_DEG = 62.0
"""Angle to the normal of a side of the box up to which that side is looked at."""

_AZIMUTHS: dict[Side, float] = {"front": 0.0, "left": 90.0, "rear": 180.0, "right": 270.0}
_INSET = 0.06  # metres from the side of the box to the plane: panels and wheels lie within
# Share of the length from the side of the box to the plane where its pane is looked at.
_PANE_BEHIND: dict[Side, float] = {"front": 0.27, "rear": 0.10}
_MARGIN = 0.10  # metres around the side of the box
_ROUND = 0.35  # metres more beside its ends, whose corners are round and are seen beside the plane
_LIGHT_RANGE, _HUE_RANGE = 40.0, 14.0  # CIE L, and a or b, between pictures of one paint
_SHADES = 3  # cells of 6 CIE L by which one paint differs between its panels
_LEAST_SEEN = 0.3  # share of the plane within the mask below which a side is not looked at
_UNLIKE_PAINT = 16.0  # CIE76 from the own paint above which a pixel is no painted panel
_PLACE = 0.12  # metres by which a lamp or a pane may be beside its place
_AGREE = 0.6  # share of the part that must be at its place, and of what is drawn of it
_WHEEL_ROOM, _WHEEL_BESIDE, _WHEEL_OWN = 0.9, 0.06, 0.88  # metres, metres, share
# Metres by which a photograph's camera may be off: on the Civic and the Alphard, the middle between
# the wheels differs by 0.04 and 0.09 m between the photographs of both sides.
_CAMERA_OFF = 0.05
_WHEEL_PLACE, _WHEEL_APART, _WHEEL_LIKE = 0.15, 0.16, 0.5
_LEAST_BESIDE = 60.0  # CIE L of what a dark wheel is seen before
_WHEEL_RADII = (0.28, 0.31, 0.34, 0.37, 0.40)  # metres
_PANES_ALIKE = 0.5  # IoU of window areas
_PANES_LIGHT = 30.0  # CIE L by which panes may be lighter or darker than photographed
_RED, _HUE_RANGE_DEG, _HUE_APART_DEG = 20.0, (-25.0, 48.0), 14.0
_SMEAR, _CRISP = 0.05, 0.2  # metres of detail, and share of it that a lamp must have
_PLATES = ((0.52, 0.12), (0.46, 0.11), (0.34, 0.17))  # metres: European, flat, Japanese
# CIE L: contrast of a plate in the photograph, and the lower one that is enough in the render
_PLATE_CONTRAST, _PLATE_DRAWN, _PLATE_LIKE, _PLATE_SECOND = 26.0, 16.0, 4.0, 0.85


@dataclass(frozen=True)
class SidePicture:
    """One side of the box in metres, as a camera sees its plane.

    Attributes:
        lab: (H, W, 3) float32 CIE Lab; left to right as one who stands before that side sees it.
        mask: (H, W) pixels on the vehicle.
        low: (2,) coordinates of the lower left corner: metres from the middle of the side, and
            metres above the bottom of the box.
        height: height of the box, metres.
        width: width of this side of the box, metres.
        paint: (3,) CIE Lab of the paint on this side.
    """

    side: Side
    lab: Array
    mask: Mask
    low: Array
    height: float
    width: float
    paint: Array

    def rows(self, low: float, high: float) -> Mask:
        """(H, 1) rows between two shares of the box's height."""
        z = self.low[1] + (self.mask.shape[0] - np.arange(self.mask.shape[0]) - 0.5) / (
            PIXELS_PER_METRE
        )
        return ((z >= low * self.height) & (z <= high * self.height))[:, None]

    @property
    def across(self) -> Array:
        """(W,) metres of the columns from the middle of the side."""
        return self.low[0] + (np.arange(self.mask.shape[1]) + 0.5) / PIXELS_PER_METRE

    def unlike_paint(self) -> Mask:
        """(H, W) pixels on the vehicle that do not have the colour of its paint."""
        apart = np.linalg.norm(self.lab - self.paint, axis=-1) > _UNLIKE_PAINT
        return opened(apart & self.mask, 0.02)

    def panes(self) -> Mask:
        """(H, W) pixels of panes: what does not have the paint's colour in the upper half.

        Coloured paint is paint in every light; a pane's mirror images of sky and paint, which the
        rest of it surrounds, are the pane's.
        """
        lightness, hue = self.paint[0], self.paint[1:]
        lit = (self.lab[..., :1] + 16.0) / (lightness + 16.0)  # CIE Lab of k times the light
        apart = np.linalg.norm(self.lab[..., 1:] - lit * hue, axis=-1)
        coloured = min(float(np.hypot(*hue)) / _UNLIKE_PAINT, 1.0)
        light = np.abs(self.lab[..., 0] - lightness) * (1.0 - coloured)
        unlike = (np.hypot(apart, light) > _UNLIKE_PAINT * (1.0 - 0.4 * coloured)) & self.mask
        found = opened(unlike & self.rows(0.52, 0.95), 0.06).astype(np.uint8)
        outlines, _ = cv2.findContours(found, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        return cv2.drawContours(found, outlines, -1, 1, cv2.FILLED) > 0


@dataclass(frozen=True)
class PartCheck:
    """One part on one side.

    Attributes:
        passed: None where the photograph does not decide it.
        reason: what differs, or why it is not decided.
    """

    part: str
    side: Side
    passed: bool | None
    reason: str = ""


def paint_colours(cutouts: Sequence[ScoredCutout]) -> Array:
    """(N, 3) CIE Lab of a vehicle's paint in each of its pictures.

    The densest colour between a quarter and four fifths of the outline's height, where pixels are
    mostly panels; a median would mix in wheels and glass. Where glass or trim is denser in one
    picture than the panels, the pictures' common colour decides.
    """
    pictures = [(cielab(one.rgb), one.mask) for one in cutouts]
    single = np.array([_densest(*one, None) for one in pictures])
    return np.array([_densest(*one, np.median(single, axis=0)) for one in pictures])


def _densest(lab: Array, mask: Mask, about: Array | None) -> Array:
    """(3,) CIE Lab of the densest colour of a vehicle's picture, near one that is given."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return np.zeros(3)
    body = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    top, tall = rows[0], rows[-1] - rows[0]
    body[: round(top + 0.25 * tall)] = False
    body[round(top + 0.80 * tall) :] = False
    colours, trust = lab[body], np.ones(int(body.sum()))
    if about is not None:
        apart = np.abs(colours - about)
        near = (apart[:, 0] < _LIGHT_RANGE) & (apart[:, 1:].max(axis=1) < _HUE_RANGE)
        colours, trust = colours[near], 1.0 - apart[near, 0] / _LIGHT_RANGE
    if len(colours) < 20:
        return np.asarray(np.median(lab[mask], axis=0) if about is None else about)
    cells = np.round(colours / 6.0).astype(int)
    unique, index = np.unique(cells, axis=0, return_inverse=True)
    counts = np.bincount(index.ravel(), trust)
    # neighbours count too, over a wide range of light: panels are shaded, trim and plates are flat
    apart = np.abs(unique[:, None] - unique[None])
    near = (apart[..., 0] <= _SHADES) & (apart[..., 1:].max(axis=2) <= 1)
    # dark colours count less, as tyres, glass and grilles are dark on every car
    weight = (near @ counts) * np.clip(unique[:, 0] * 6.0 / 30.0, 0.35, 1.0)
    best = near[int(np.argmax(weight))]
    return np.asarray(np.median(colours[best[index.ravel()]], axis=0))


def side_picture(
    cutout: ScoredCutout,
    view: ActorView,
    size: ArrayLike,
    side: Side,
    paint: Array,
    inset: float = _INSET,
) -> SidePicture | None:
    """A side of the box in metres; None where the camera hardly sees it.

    Args:
        size: (3,) length, width, height of the box, metres.
        paint: (3,) CIE Lab of the cutout's paint.
        inset: metres from the side to the plane that is looked at, which lies within the box.
    """
    length, width, height = np.asarray(size, float)
    azimuth = np.radians(_AZIMUTHS[side])
    normal = np.array([np.round(np.cos(azimuth)), np.round(np.sin(azimuth)), 0.0])
    right = np.array([-normal[1], normal[0], 0.0])
    half, depth = (width, length) if normal[0] else (length, width)
    eye = -view.camera_from_actor[:3, :3].T @ view.camera_from_actor[:3, 3]
    middle = (depth / 2 - inset) * normal
    towards = eye - middle
    if towards @ normal < np.cos(np.radians(STEEPEST_DEG)) * np.linalg.norm(towards[:2]):
        return None
    beside = _MARGIN + (_ROUND if normal[0] else 0.0)
    low = np.array([-half / 2 - beside, -_MARGIN])
    shape = np.ceil((np.array([half, height]) - 2 * low - [half, 0.0]) * PIXELS_PER_METRE)
    across, tall = shape.astype(int)
    columns = (np.arange(across) + 0.5) / PIXELS_PER_METRE + low[0]
    rows = low[1] + (tall - np.arange(tall) - 0.5) / PIXELS_PER_METRE - height / 2
    points = middle + columns[None, :, None] * right + rows[:, None, None] * [0.0, 0.0, 1.0]
    seen = points @ view.camera_from_actor[:3, :3].T + view.camera_from_actor[:3, 3]
    camera = view.camera
    x = (seen[..., 0] / seen[..., 2] * camera.fx + camera.cx - 0.5).astype(np.float32)
    y = (seen[..., 1] / seen[..., 2] * camera.fy + camera.cy - 0.5).astype(np.float32)
    rgba = np.dstack([cutout.rgb, cutout.alpha]).astype(np.float32)
    taken = cv2.remap(rgba, x, y, cv2.INTER_AREA)
    alpha = taken[..., 3]
    mask = alpha > 0.5
    if mask.mean() < _LEAST_SEEN:
        return None
    lab = cielab(np.clip(taken[..., :3] / np.maximum(alpha, 1e-3)[..., None], 0, 1))
    # a flank in the shade has another colour than the bonnet beside it in the picture
    own = _densest(lab, mask, paint)
    return SidePicture(side, lab, mask, low, float(height), float(half), own)


def part_checks(
    shown: ScoredCutout,
    truth: ScoredCutout,
    view: ActorView,
    size: ArrayLike,
    paints: tuple[Array, Array],
) -> list[PartCheck]:
    """The checks of all sides that a view shows.

    Args:
        shown, truth: render and photograph by the view's camera.
        size: (3,) length, width, height of the vehicle's box, metres.
        paints: (3,) CIE Lab of the paint in the render and in the photograph, see `paint_colours`.
    """
    checks = []
    for side in _AZIMUTHS:
        pictures = _both(shown, truth, view, size, side, paints, _INSET)
        if pictures is None:
            continue
        ends = {"front": (_head_lamps, _plate), "rear": (_tail_lamps, _plate)}
        for check in ends.get(side, (_windows, _wheels)):
            checks.append(check(*pictures))
        behind = _PANE_BEHIND.get(side, 0.0) * float(np.asarray(size)[0])
        if behind:  # a windscreen stands far behind the plane of lamps and plate
            own = pictures[0].paint, pictures[1].paint
            pictures = _both(shown, truth, view, size, side, paints, behind)
            if pictures is not None:
                drawn, real = (
                    replace(one, paint=paint) for one, paint in zip(pictures, own, strict=True)
                )
                checks.append(_windows(drawn, real))
    return checks


def _both(
    shown: ScoredCutout,
    truth: ScoredCutout,
    view: ActorView,
    size: ArrayLike,
    side: Side,
    paints: tuple[Array, Array],
    inset: float,
) -> tuple[SidePicture, SidePicture] | None:
    """A side in the render and in the photograph; None where the photograph hardly shows it."""
    drawn, real = (
        side_picture(one, view, size, side, paint, inset)
        for one, paint in zip((shown, truth), paints, strict=True)
    )
    if real is None or drawn is not None:
        return None if real is None or drawn is None else (drawn, real)
    nothing = np.zeros_like(real.mask)  # nothing is drawn there
    return replace(real, lab=np.zeros_like(real.lab), mask=nothing, paint=paints[0]), real


def passed_share(checks: Sequence[PartCheck]) -> tuple[int, int, int]:
    """Number of checks passed, decided, and left out because the photograph does not decide."""
    decided = [one for one in checks if one.passed is not None]
    return sum(bool(one.passed) for one in decided), len(decided), len(checks) - len(decided)


def opened(mask: Mask, metres: float) -> Mask:
    """The mask (H, W) without what is narrower."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disc(metres / 2)) > 0


def _grown(mask: Mask, metres: float) -> Mask:
    return cv2.dilate(mask.astype(np.uint8), _disc(metres)) > 0


def _disc(radius: float) -> Image:
    reach = max(1, round(radius * PIXELS_PER_METRE))
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(element, np.uint8)


def _alike(shown: Mask, real: Mask) -> tuple[float, float]:
    """Share of the real area that is drawn nearby, and of the drawn one that is real nearby."""
    recall = float(_grown(shown, _PLACE)[real].mean()) if real.any() else 0.0
    precision = float(_grown(real, _PLACE)[shown].mean()) if shown.any() else 0.0
    return recall, precision


def _smeared(shown: SidePicture, real: SidePicture, area: Mask) -> str:
    """Why what is drawn about a lamp is a smear; empty if it is as crisp as photographed."""
    near = _grown(area, _PLACE / 2) & real.mask & shown.mask
    if not near.any():
        return "nothing is drawn there"
    energies = []
    for one in (shown, real):
        lab = np.where(one.mask[..., None], one.lab, one.paint)
        fine = cv2.GaussianBlur(lab, (0, 0), 0.6) - cv2.GaussianBlur(
            lab, (0, 0), _SMEAR * PIXELS_PER_METRE
        )
        energies.append(float((fine[near] ** 2).sum(axis=-1).mean()))
    share = energies[0] / max(energies[1], 1e-9)
    return f"{share:.0%} of the photographed contrast" if share < _CRISP else ""


def _windows(shown: SidePicture, real: SidePicture) -> PartCheck:
    panes = [one.panes() for one in (shown, real)]
    room = (real.mask & real.rows(0.52, 0.95)).sum()
    part = "windows"
    if room == 0 or panes[1].sum() < 0.2 * room:
        return PartCheck(part, real.side, None, "no pane differs from the paint")
    overlap = (panes[0] & panes[1]).sum() / max((panes[0] | panes[1]).sum(), 1)
    if overlap < _PANES_ALIKE:
        return PartCheck(part, real.side, False, f"IoU {overlap:.2f}")
    light = [
        float(np.median(one.lab[p][:, 0])) for one, p in zip((shown, real), panes, strict=True)
    ]
    if abs(light[0] - light[1]) > _PANES_LIGHT:
        return PartCheck(part, real.side, False, f"light {light[0]:.0f}, photograph {light[1]:.0f}")
    return PartCheck(part, real.side, True)


def wheel_places(picture: SidePicture, dark: bool = False) -> list[float]:
    """Metres from the middle of the side of what looks like a wheel on the ground.

    Args:
        dark: look for dark discs between lighter surroundings; without, for light rims in dark
            tyres, which are seen before a dark body too.
    """
    beside = max(float(picture.paint[0]), _LEAST_BESIDE) if dark else 0.0
    light = np.where(picture.mask, picture.lab[..., 0], beside).astype(np.float32)
    inside = picture.mask.astype(np.float32)
    best = np.full(picture.mask.shape[1], -1.0)
    for radius in _WHEEL_RADII:
        reach = round((1.3 if dark else 1.0) * radius * PIXELS_PER_METRE)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / (radius * PIXELS_PER_METRE)
        away = np.hypot(x, y)
        disc = away <= (1.3 if dark else 1.0)
        pattern = np.where(away < 1.0, -1.0, 1.0) if dark else np.where(away < 0.66, 1.0, -1.0)
        pattern = np.where(disc, pattern - pattern[disc].mean(), 0.0)
        pattern = (pattern / np.sqrt((pattern**2).sum())).astype(np.float32)
        ones = disc.astype(np.float32)
        count = float(ones.sum())
        value = cv2.filter2D(light, -1, pattern, borderType=cv2.BORDER_CONSTANT)
        mean = cv2.filter2D(light, -1, ones, borderType=cv2.BORDER_CONSTANT) / count
        square = cv2.filter2D(light**2, -1, ones, borderType=cv2.BORDER_CONSTANT)
        spread = np.sqrt(np.maximum(square - count * mean**2, 1e-3) + count * 3.0**2)
        full = cv2.filter2D(inside, -1, ones, borderType=cv2.BORDER_CONSTANT) / count
        likeness = np.where(full > (0.6 if dark else 0.9), value / spread, -1.0)
        row = picture.mask.shape[0] - (radius - picture.low[1]) * PIXELS_PER_METRE
        room = round(0.07 * PIXELS_PER_METRE)
        band = likeness[round(row) - room : round(row) + room + 1]
        best = np.maximum(best, band.max(axis=0))
    apart = round(_WHEEL_APART * PIXELS_PER_METRE)
    highest = cv2.dilate(best[None].astype(np.float32), np.ones((1, 2 * apart + 1)))[0]
    peaks = np.flatnonzero((best >= highest - 1e-6) & (best > _WHEEL_LIKE))
    return [float(picture.across[peak]) for peak in peaks]


def _wheels(shown: SidePicture, real: SidePicture) -> PartCheck:
    for dark in (False, True):
        places = wheel_places(real, dark)
        if len(places) == 2 and places[1] - places[0] > 0.4 * real.width:
            break
    else:
        return PartCheck("wheels", real.side, None, f"photograph: {len(places)} found")
    drawn_places = wheel_places(shown, dark)
    if len(drawn_places) != 2:
        return PartCheck("wheels", real.side, False, f"{len(drawn_places)} found")
    apart = np.subtract(drawn_places, places)
    off = float(np.abs(apart - np.clip(apart.mean(), -_CAMERA_OFF, _CAMERA_OFF)).max())
    # a second wheel that overlaps the first is no peak of its own, but adds to what is dark
    near = np.abs(real.across[:, None] - places).min(axis=1) < _WHEEL_ROOM
    dark_areas = [
        one.unlike_paint() & (one.lab[..., 0] < one.paint[0]) & one.rows(0.04, 0.40) & near
        for one in (shown, real)
    ]
    own = _grown(dark_areas[1], _WHEEL_BESIDE)[dark_areas[0]]
    if own.size and own.mean() < _WHEEL_OWN:
        told = f"{1 - own.mean():.0%} of what is dark about them lies beside"
        return PartCheck("wheels", real.side, False, told)
    told = "" if off <= _WHEEL_PLACE else f"{off:.2f} m from their place"
    return PartCheck("wheels", real.side, off <= _WHEEL_PLACE, told)


def red_area(picture: SidePicture) -> Mask:
    """(H, W) pixels as red as a tail lamp, and redder in hue than the paint."""
    a, b = picture.lab[..., 1], picture.lab[..., 2]
    hue = np.degrees(np.arctan2(b, a))
    least, most = _HUE_RANGE_DEG
    if np.hypot(*picture.paint[1:]) > _RED:
        most = min(most, float(np.degrees(np.arctan2(*picture.paint[:0:-1]))) - _HUE_APART_DEG)
    red = (np.hypot(a, b) > _RED) & (hue > least) & (hue < most) & picture.mask
    return opened(red, 0.02) & picture.rows(0.30, 0.92)


def _tail_lamps(shown: SidePicture, real: SidePicture) -> PartCheck:
    red = [red_area(one) for one in (shown, real)]
    for side, part in (("left", real.across < 0), ("right", real.across > 0)):
        if (red[1] & part).sum() < 0.005 * PIXELS_PER_METRE**2:
            return PartCheck("tail lamps", real.side, None, f"photograph: none on the {side}")
    for side, part in (("left", real.across < 0), ("right", real.across > 0)):
        recall, precision = _alike(red[0] & part, red[1] & part)
        if min(recall, precision) < _AGREE:
            told = f"{side}: {recall:.0%} of the photographed lamp, {precision:.0%} at its place"
            return PartCheck("tail lamps", real.side, False, told)
    smeared = _smeared(shown, real, red[1])
    return PartCheck("tail lamps", real.side, not smeared, smeared)


def _head_lamps(shown: SidePicture, real: SidePicture) -> PartCheck:
    """Lamps are unlike the paint and full of contrast, left and right at the height of the belt."""
    unlike = [one.unlike_paint() & one.rows(0.34, 0.70) for one in (shown, real)]
    for side, sign in (("left", -1), ("right", 1)):
        part = (sign * real.across > 0.22 * real.width) & (sign * real.across < 0.5 * real.width)
        area = unlike[1] & part
        if area.sum() < 0.012 * PIXELS_PER_METRE**2:
            return PartCheck("head lamps", real.side, None, f"photograph: none on the {side}")
        recall, precision = _alike(unlike[0] & part, area)
        if min(recall, precision) < _AGREE:
            told = f"{side}: {recall:.0%} of the photographed lamp, {precision:.0%} at its place"
            return PartCheck("head lamps", real.side, False, told)
        smeared = _smeared(shown, real, area)
        if smeared:
            return PartCheck("head lamps", real.side, False, f"{side}: {smeared}")
    return PartCheck("head lamps", real.side, True)


def plate_places(
    picture: SidePicture, least: float = _PLATE_CONTRAST
) -> list[tuple[float, float, float]]:
    """Metres across and up of what looks like a plate, best first, and how much lighter it is.

    A plate is a rectangle that is lighter than its surroundings on at least three sides, and on
    the fourth no darker: white ones lie on white bumpers.
    """
    light = np.where(picture.mask, picture.lab[..., 0], picture.paint[0])
    rows = picture.rows(0.10, 0.66) & (np.abs(picture.across) < 0.45)
    score = np.zeros(light.shape, np.float32)
    for wide, tall in _PLATES:
        w, h = (max(3, round(one * PIXELS_PER_METRE) | 1) for one in (wide, tall))
        inner = cv2.blur(light, (w, h))
        edge = max(2, round(0.04 * PIXELS_PER_METRE))
        sides = [
            cv2.blur(_moved(light, right, down), size)
            for right, down, size in (
                ((w + edge) // 2, 0, (edge, h)),
                (-(w + edge) // 2, 0, (edge, h)),
                (0, (h + edge) // 2, (w, edge)),
                (0, -(h + edge) // 2, (w, edge)),
            )
        ]
        over = np.sort([inner - one for one in sides], axis=0)
        score = np.maximum(score, np.where(over[0] > -_PLATE_LIKE, over[1], 0.0))
    left = np.where(rows & picture.mask, score, 0.0)
    places: list[tuple[float, float, float]] = []
    while left.max() > least and len(places) < 5:
        row, column = np.unravel_index(int(left.argmax()), left.shape)
        up = picture.low[1] + (light.shape[0] - row - 0.5) / PIXELS_PER_METRE
        places.append((float(picture.across[column]), float(up), float(left[row, column])))
        reach_x, reach_y = round(0.3 * PIXELS_PER_METRE), round(0.16 * PIXELS_PER_METRE)
        left[max(row - reach_y, 0) : row + reach_y, max(column - reach_x, 0) : column + reach_x] = 0
    return places


def _moved(image: Array, right: int, down: int) -> Array:
    """The image as seen from a pixel that is so far to the right and down."""
    matrix = np.array([[1.0, 0.0, -right], [0.0, 1.0, -down]])
    size = (image.shape[1], image.shape[0])
    moved = cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float64)


def _plate(shown: SidePicture, real: SidePicture) -> PartCheck:
    places = plate_places(real)
    if not places or (len(places) > 1 and places[1][2] > _PLATE_SECOND * places[0][2]):
        return PartCheck("plate", real.side, None, f"photograph: {len(places)} found")
    across, up, _ = places[0]
    drawn_places = plate_places(shown, _PLATE_DRAWN)
    at = [np.hypot(one[0] - across, one[1] - up) <= 1.5 * _PLACE for one in drawn_places]
    if not any(at):
        return PartCheck("plate", real.side, False, "none at its place")
    if not at[0]:
        return PartCheck(
            "plate", real.side, False, f"a clearer one {drawn_places[0][1]:.2f} m high"
        )
    return PartCheck("plate", real.side, True)
