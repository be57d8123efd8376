"""Photographs of sampled designs to train the parametric model on: drawn by points, and spoilt.

The bodies are the template's, with every field of the design drawn at random; the world's own
vehicles (`recast.synthetic.vehicles`) stay what the model is tested on.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from recast.actors.parametric.codec import ParametricVehicle, VehicleLook
from recast.actors.parametric.network import ConditionImages, unwrapped
from recast.actors.template.body import TemplateBody, mirror, wheel
from recast.actors.template.cloud import MIRROR, gradient, project
from recast.actors.template.design import STYLES, sample_design, sample_size
from recast.actors.template.lighting import Daylight, diffuse, mirrored, road_tint
from recast.actors.template.materials import GLASS, GLOSS, PAINTED, RIM, SRGB, label_body
from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.recar.perturb import PerturbationConfig, compose, draw
from recast.recar.perturb_camera import Fog, LowLight
from recast.recar.perturb_outline import Cropping
from recast.scene.actor import look_at
from recast.scene.light.relight import COAT

_CELL, _SEEDS = 0.08, 3
"""Edge of the cells that the surface is looked for in, metres, and points in each."""
_CHANCES = {"van": 0.05, "bus": 0.03, "truck": 0.03}
"""Shares of the styles that a class tells; the others are equally likely."""
_VANS = ("mpv", "one-box")
"""Styles that some data sets call vans."""
_FINEST = 32.0  # pixels a metre of the drawn photographs
_REACH = 1.5  # edge that a point covers, over its spacing
_BEHIND = 0.35  # metres behind its neighbours at which a pixel is a hole between points
_PERTURBATIONS = PerturbationConfig(
    rho_clean=0.3,
    cropping=Cropping(weight=0.3),
    low_light=LowLight(weight=0.3),
    fog=Fog(weight=0.4),
)
_WHITE, _SILVER, _GREY, _BLACK, _COLOUR = range(5)
_PAINTS = (0.25, 0.14, 0.18, 0.18, 0.25)


@dataclass(frozen=True)
class Weather:
    """Light on a vehicle: the template's, with a sun and a brighter horizon than its trees.

    Attributes:
        light: light of the sky.
        sun: light of the sun on a surface that faces it, over that of the sky.
        towards_sun: (3,) unit vector.
        horizon: (3,) linear light of houses and other vehicles around.
    """

    light: Daylight
    sun: float
    towards_sun: Array
    horizon: Array


def sample_weather(rng: np.random.Generator) -> Weather:
    """Clear (two in five), overcast (two in five), or a low sun."""
    kind = rng.choice(3, p=[0.4, 0.4, 0.2])
    level = float(np.exp(rng.uniform(np.log(0.3), np.log(1.5))))
    mirror = level * float(np.exp(rng.normal(0, 0.3)))
    clouds = float(np.clip((0.1, 0.9, 0.4)[kind] + rng.normal(0, 0.2), 0, 1))
    sun = (rng.uniform(0.0, 0.9), 0.0, rng.uniform(0.2, 1.2))[kind]
    towards = se3.direction(
        rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.4) if kind == 2 else rng.uniform(0.5, 1.2)
    )
    warmth = rng.normal(0.12 if kind == 2 else 0.0, 0.05)
    tint = np.array([1 + warmth, 1 + rng.normal(0, 0.015), 1 - warmth])
    tint /= tint.mean()
    horizon = mirror * rng.uniform(0, 0.35) ** 1.5 * rng.uniform(0.8, 1.2, 3)
    hue = (float(tint[0]), float(tint[1]), float(tint[2]))
    return Weather(Daylight(level, mirror, clouds, hue), sun, towards, horizon)


def sample_paint(rng: np.random.Generator) -> Array:
    """Display colour (3,) of a car's paint."""
    kind = rng.choice(5, p=_PAINTS)
    if kind == _COLOUR:
        hue = rng.choice([0.0, 0.02, 0.06, 0.12, 0.35, 0.5, 0.58, 0.62, 0.66, 0.8])
        hue = (hue + rng.normal(0, 0.02)) % 1
        return np.array(colorsys.hsv_to_rgb(hue, rng.uniform(0.3, 0.95), rng.uniform(0.12, 0.8)))
    low, high = ((0.74, 0.93), (0.52, 0.74), (0.2, 0.52), (0.03, 0.2))[kind]
    return np.clip(rng.uniform(low, high) * (1 + rng.normal(0, 0.03, 3)), 0.03, 0.95)


@dataclass(frozen=True)
class Sampled:
    """One example: the condition, and what is to be read from it."""

    condition: ConditionImages
    vehicle: ParametricVehicle


def photographs(rng: np.random.Generator, views: int) -> Iterator[Sampled]:
    """Photographs of one random vehicle, each in another paint, weather and from elsewhere."""
    cars = [style for style in STYLES if style not in _CHANCES]
    rest = (1 - sum(_CHANCES.values())) / len(cars)
    style = str(rng.choice(list(STYLES), p=[_CHANCES.get(one, rest) for one in STYLES]))
    size = sample_size(style, rng)
    design = sample_design(style, size, rng)
    cloud = _patches(TemplateBody(size, design), rng)
    category = style if style in _CHANCES else "car"
    if style in _VANS and rng.uniform() < 0.3:
        category = "van"
    for _ in range(views):
        taken = _photograph(cloud, size, rng)
        if taken is None:
            continue
        rgba, camera, pose, look, road = taken
        labelled, moved = _labelled(size, pose, rng)
        named = category if rng.uniform() < 0.8 else ""
        condition = unwrapped(rgba, camera, moved, labelled, named, road)
        yield Sampled(condition, ParametricVehicle(style, design, look))


@dataclass(frozen=True)
class _Patches:
    """Surface points of a vehicle, its ground at z = 0; see `SurfaceCloud`."""

    points: Array  # (N, 3)
    normals: Array  # (N, 3)
    spacing: Array  # (N,)
    albedo: Array  # (N, 3)
    gloss: Array  # (N,)
    paint: Array  # (N,)
    glass: Array  # (N,)
    rim: Array  # (N,)


def _patches(body: TemplateBody, rng: np.random.Generator) -> _Patches:
    """Random points in place of `build_cloud`'s even ones, in single precision: a third the time.

    In a photograph of 30 pixels a metre, several of them fall into a pixel.
    """
    grown = np.array([body.length, body.width, 0.0]) / 2 + 0.01
    low, high = grown * [-1, 0, 0], grown + np.array([0, 0, body.height + 0.02])
    axes = [np.arange(a, b, _CELL) + _CELL / 2 for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = centres.astype(np.float32)
    near = centres[np.abs(body.distance(centres)) < 0.8 * _CELL]
    seeds = np.repeat(near, _SEEDS, axis=0)
    seeds += rng.uniform(-_CELL / 2, _CELL / 2, seeds.shape).astype(np.float32)

    def distance(points: Array) -> Array:
        return body.distance(points.astype(np.float32))

    points = project(distance, seeds, 1)
    value = distance(points)
    slope = gradient(distance, points, value)
    square = np.maximum(np.sum(slope * slope, axis=1, keepdims=True), 1e-3)
    kept = (np.abs(value) < 0.03) & np.all((points > low) & (points < high), axis=1)
    points = (points - slope * (value[:, None] / square))[kept]
    normals = (slope / np.sqrt(square))[kept]
    both = np.concatenate([points, points * MIRROR]), np.concatenate([normals, normals * MIRROR])
    parts = [(*both, label_body(body, *both), _CELL / _SEEDS**0.5)]
    for p, n, labels in (*(wheel(body, x, 0.05) for x in body.axles), mirror(body, 0.05)):
        parts += [(p, n, labels, 0.05), (p * MIRROR, n * MIRROR, labels, 0.05)]
    points, normals, labels = (np.concatenate([part[i] for part in parts]) for i in range(3))
    spacing = np.concatenate([np.full(len(part[0]), part[3]) for part in parts])
    painted = PAINTED[labels]
    albedo = gamma_to_linear(SRGB)[labels] * (1 - painted)[:, None]
    return _Patches(
        points, normals, spacing, albedo, GLOSS[labels], painted, GLASS[labels], RIM[labels]
    )


def _photograph(
    cloud: _Patches, size: Array, rng: np.random.Generator
) -> tuple[Image, PinholeCamera, Array, VehicleLook, Array] | None:
    """RGBA, camera, pose, look, and the road's light (3,); None where nothing is left."""
    camera, pose = _camera(size, rng)
    weather, paint = sample_weather(rng), sample_paint(rng)
    panes, shine = 1.6 * rng.beta(2, 3), rng.uniform(0.1, 1.2)
    rims = rng.uniform(0.2, 1.2)
    centred = cloud.points - [0.0, 0.0, size[2] / 2]
    eye = -pose[:3, :3].T @ pose[:3, 3]
    rays = eye - centred
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    facing = np.sum(rays * cloud.normals, axis=1) > 0.02
    shown = np.flatnonzero(facing)
    normals, views = cloud.normals[shown], rays[shown]
    glass, rim = cloud.glass[shown], cloud.rim[shown]
    dye = 1 - glass * (1 - panes) - rim * (1 - rims)
    own = cloud.albedo[shown] * dye[:, None]
    albedo = own + cloud.paint[shown][:, None] * gamma_to_linear(paint)
    across = diffuse(normals, cloud.points[shown, 2])
    sun = weather.sun * np.clip(normals @ weather.towards_sun, 0, None)[:, None]
    light = weather.light.level * (across * (1 - 0.35 * weather.sun) + sun)
    gloss = cloud.gloss[shown] * (1 - glass * (1 - shine))
    sky = weather.light.mirror * mirrored(normals, views, gloss, weather.light.clouds)
    cosine = np.sum(normals * views, axis=1)
    level_out = np.exp(-(((2 * cosine * normals[:, 2] - views[:, 2]) / 0.15) ** 2))
    grazing = COAT + (1 - COAT) * (1 - np.clip(cosine, 0.05, 1.0)) ** 5
    sky += np.minimum(grazing * gloss, 0.9)[:, None] * level_out[:, None] * weather.horizon
    tint = np.array(weather.light.tint)
    colour = linear_to_gamma(tint * (albedo * light + sky))
    rgba = _drawn(centred[shown], cloud.spacing[shown], colour, camera, pose, rng)
    if rgba is None:
        return None
    level = float(np.mean(light) / np.mean(across))
    road = np.full(3, np.nan)
    if rng.uniform() < 0.75:
        asphalt = 0.11 * np.exp(rng.normal(0, 0.35)) * (1 + rng.normal(0, 0.02, 3))
        road = asphalt * level * tint
    # what the road does not tell of the light's hue counts as the paint's
    apparent = linear_to_gamma(gamma_to_linear(paint) * tint / np.array(road_tint(road)))
    red, green, blue = (float(v) for v in apparent)
    look = VehicleLook(
        red=red,
        green=green,
        blue=blue,
        level=float(np.log2(level)),
        mirror=float(np.log2(weather.light.mirror / level)),
        clouds=weather.light.clouds,
        panes=panes,
        pane_mirror=shine,
        rims=rims,
    )
    spoilt = _spoilt(rgba, rng)
    return None if spoilt is None else (spoilt, camera, pose, look, road)


def _camera(size: Array, rng: np.random.Generator) -> tuple[PinholeCamera, Array]:
    """A camera of a car or a person, mostly behind the vehicle and to its side."""
    azimuth = rng.normal(np.pi, 0.75) if rng.uniform() < 0.6 else rng.uniform(0, 2 * np.pi)
    reach = float(np.linalg.norm(size[:2]) / 2)
    distance = reach + float(np.exp(rng.uniform(np.log(2.5), np.log(35.0))))
    height = rng.uniform(1.1, 2.2) - size[2] / 2
    eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    pose = look_at(eye, np.array([*rng.normal(0, 0.1, 2), 0.0]))
    finest = min(_FINEST, 170 / float(np.linalg.norm(size[:2])))
    density = float(np.exp(rng.uniform(np.log(0.2 * finest), np.log(finest))))
    focal = density * distance
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
    pixels, depth = PinholeCamera(1, 1, focal, focal, 0.0, 0.0).project(se3.apply(pose, corners))
    pixels = pixels[depth > 0.3]
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    margin = 0.12 * float((high - low).max()) + 3
    width, tall = (int(v) for v in np.clip(np.ceil(high - low + 2 * margin), 12, 360))
    left, top = low - margin
    return PinholeCamera(width, tall, focal, focal, float(-left), float(-top)), pose


def _drawn(
    points: Array,
    spacing: Array,
    colour: Array,
    camera: PinholeCamera,
    pose: Array,
    rng: np.random.Generator,
) -> Image | None:
    """The photograph (H, W, 4): each pixel is the mean of the points near its frontmost one."""
    pixels, depth = camera.project(se3.apply(pose, points))
    # a point covers a few pixels if the picture is finer than the surface
    reach = camera.fx / np.maximum(depth, 0.3) * spacing * _REACH
    copies = np.clip(np.ceil(reach), 1, 4).astype(int)
    parts = []
    for count in np.unique(copies):
        chosen = np.flatnonzero(copies == count)
        steps = (np.arange(count) - (count - 1) / 2) / count
        for a in steps:
            for b in steps:
                moved = pixels[chosen] + np.array([a, b]) * reach[chosen, None]
                parts.append((moved, chosen))
    where = np.concatenate([part for part, _ in parts])
    index = np.concatenate([chosen for _, chosen in parts])
    u, v = np.floor(where).astype(int).T
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    inside &= depth[index] > 0.3
    cell, index = (v * camera.width + u)[inside], index[inside]
    if len(cell) < 30:
        return None
    count = camera.width * camera.height
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, cell, depth[index])
    front = depth[index] < nearest[cell] + 0.12
    cell, index = cell[front], index[front]
    total = np.bincount(cell, minlength=count)
    mean = [
        np.bincount(cell, weights=colour[index, c], minlength=count) / np.maximum(total, 1)
        for c in range(3)
    ]
    image = np.stack(mean, axis=-1).reshape(camera.height, camera.width, 3).astype(np.float32)
    depths = nearest.reshape(camera.height, camera.width).astype(np.float32)
    ahead = cv2.erode(depths, np.ones((3, 3), np.uint8))
    mask = (depths < ahead + _BEHIND).astype(np.uint8)
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    image[mask == 0] = 0
    blurred, weight = (cv2.blur(one, (3, 3)) for one in (image, mask.astype(np.float32)))
    holes = (closed > 0) & (mask == 0)
    image[holes] = blurred[holes] / np.maximum(weight[holes], 1e-3)[:, None]
    image[closed == 0] = rng.uniform(0.1, 0.8) * rng.uniform(0.8, 1.2, 3)
    rgb = np.clip(255 * image + rng.normal(0, 2.0, image.shape), 0, 255)
    return np.dstack([rgb.astype(np.uint8), 255 * closed])


def _spoilt(rgba: Image, rng: np.random.Generator) -> Image | None:
    """The photograph with faults of Stage II; those that hide most of it are drawn again."""
    whole = np.count_nonzero(rgba[..., 3] > 127)
    if whole < 60 or rng.uniform() < _PERTURBATIONS.rho_clean:
        return rgba if whole >= 60 else None
    for _ in range(4):
        found = compose(rgba, draw(_PERTURBATIONS, rng), rng)
        if found is not None and np.count_nonzero(found[..., 3] > 127) > 0.4 * whole:
            return found
    return rgba


def _labelled(size: Array, pose: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Size and camera pose of a box as labels give it: off by a decimetre and a twentieth."""
    scale = 1 + np.clip(rng.normal(0, 0.03, 3), -0.08, 0.08)
    shift = rng.normal(0, [0.07, 0.06, 0.03])
    turn = se3.rotation_z(rng.normal(0, 0.02))
    moved = pose @ se3.from_rotation_translation(turn, shift)
    return size * scale, moved
