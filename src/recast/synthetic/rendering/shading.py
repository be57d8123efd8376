"""From light to image: many bounces, path traced; radiance that leaves surfaces, edges, and sRGB.

Only the light that arrives, at the points that the camera sees; textures, coats, haze and tone stay
as they are. Faces are taken as diffuse in their own colours.
"""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.geometry.colour import linear_to_srgb
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.lighting import (
    HAZE_LENGTH,
    PI,
    PLANE_TOLERANCE,
    Light,
    SkyLight,
    incoming,
    sun_cosine,
)
from recast.synthetic.rendering.rays import (
    STREET,
    BoolArray,
    Float32Array,
    PosedScene,
    RayMesh,
    cosine_directions,
    dot,
    normalise,
    outer,
    rows,
    scale,
    scaled,
)
from recast.synthetic.rendering.surface_points import LUMINANCE, TABLE, SurfacePoints, textured
from recast.synthetic.surface import Surface

VARIANT = "llvm_ad_rgb"
LIBRARY = "DRJIT_LIBLLVM_PATH"
"""Environment variable that tells mitsuba which LLVM to load."""

_TRIAL = f"""
import mitsuba
mitsuba.set_variant({VARIANT!r})
scene = mitsuba.load_dict({{"type": "scene", "shape": {{"type": "sphere"}}}})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, -3), mitsuba.Vector3f(0, 0, 1))
assert scene.ray_test(ray)[0]
"""
_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/opt/homebrew/opt/llvm/lib",
)
SAMPLES = 8
"""Paths a point."""
BOUNCES = 4
"""Segments of a path, the one from the point included."""
_MAP_ROWS = 256

_streets: WeakKeyDictionary[RayMesh, Any] = WeakKeyDictionary()


@lru_cache(maxsize=1)
def working_llvm() -> str | None:
    """Path of an LLVM that mitsuba runs with; None where its own choice works.

    Tried in processes of their own, as a wrong LLVM aborts the process.

    Raises:
        InputError: mitsuba is not installed, or runs with no LLVM found.
    """
    command = [sys.executable, "-c", "import mitsuba"]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        remedy = "pip install 'recast-sim[mitsuba]'"
        raise InputError("quality 'mitsuba'", "mitsuba", "is not installed", remedy)
    tried: list[str | None] = [None] if os.environ.get(LIBRARY) else [*_libraries(), None]
    for library in tried:
        environment = dict(os.environ) | ({} if library is None else {LIBRARY: library})
        trial = subprocess.run(
            [sys.executable, "-c", _TRIAL], env=environment, capture_output=True, check=False
        )
        if trial.returncode == 0:
            return library
    problem = "mitsuba runs with none of the libraries found"
    remedy = f"install LLVM 16 or newer (Debian: apt install libllvm19) or set {LIBRARY}"
    raise InputError("quality 'mitsuba'", "LLVM", problem, remedy)


def _libraries() -> list[str]:
    """LLVM libraries of version 16 and later, newest first; older ones are known to abort."""
    found: dict[int, str] = {}
    for folder in _FOLDERS:
        for path in sorted(Path(folder).glob("libLLVM*")):
            version = re.search(r"libLLVM[-.](?:so\.)?(\d+)", path.name)
            if version and int(version[1]) >= 16:
                found[int(version[1])] = str(path)
    return [found[version] for version in sorted(found, reverse=True)]


def path_light(light: SkyLight, points: SurfacePoints, rng: np.random.Generator) -> Float32Array:
    """Irradiance over pi (N, 3) of all but the sun's own rays at N points. Raises InputError:
    mitsuba is not installed, or does not run here."""
    mitsuba = _mitsuba()
    count = len(points) * SAMPLES
    if not count:
        return np.zeros((0, 3), np.float32)
    scene = mitsuba.load_dict(_scene(mitsuba, points.posed, light))
    path = mitsuba.load_dict({"type": "path", "max_depth": BOUNCES, "rr_depth": 64})
    sampler = mitsuba.load_dict({"type": "independent"})
    sampler.seed(int(rng.integers(2**31)), count)

    point = np.repeat(np.arange(len(points)), SAMPLES)
    # SAMPLES strata in one coordinate: neighbouring samples are of one point.
    samples = rng.random((count, 2), np.float32)
    samples[:, 0] = (samples[:, 0] + np.arange(count, dtype=np.float32) % SAMPLES) / SAMPLES
    directions = cosine_directions(rows(points.normal, point), samples)
    origins = rows(points.origin, point)
    rays = mitsuba.RayDifferential3f(
        mitsuba.Point3f(np.ascontiguousarray(origins.T)),
        mitsuba.Vector3f(np.ascontiguousarray(directions.T)),
    )
    radiance = np.asarray(path.sample(scene, sampler, rays)[0], np.float32)
    # A path that meets the sun's glow by chance would leave a speck.
    radiance = np.minimum(radiance.T, np.float32(4 * light.white))
    return radiance.reshape(len(points), SAMPLES, 3).mean(axis=1)


@lru_cache(maxsize=1)
def _mitsuba() -> Any:
    library = working_llvm()
    if library is not None:
        os.environ[LIBRARY] = library
    mitsuba = importlib.import_module("mitsuba")
    mitsuba.set_variant(VARIANT)
    # Logs are rendered by several processes already.
    importlib.import_module("drjit").set_thread_count(1)
    return mitsuba


def _scene(mitsuba: Any, posed: PosedScene, light: SkyLight) -> dict[str, Any]:
    scene = posed.scene
    shapes: dict[str, Any] = {}
    if len(scene.static):
        # By the street's hierarchy, which scenes with other shapes of the same people share.
        street = scene.mesh(STREET)
        if street not in _streets:
            _streets[street] = _mesh(mitsuba, scene.static, scene.static.vertices)
        shapes["street"] = _streets[street]
    for index, (name, pose) in enumerate(sorted(posed.poses.items())):
        model = scene.models[name]
        if len(model):
            vertices = se3.apply(pose, model.vertices)
            shapes[f"model{index}"] = _mesh(mitsuba, model, vertices)
    sun = {
        "type": "directional",
        "direction": (-light.sun_direction).tolist(),
        "irradiance": {"type": "rgb", "value": light.sun.tolist()},
    }
    lights = {"sky": _environment(mitsuba, light)}
    if light.sun_direction[2] > 0:
        lights["sun"] = sun
    return {"type": "scene", **shapes, **lights}


def _mesh(mitsuba: Any, surface: Surface, vertices: np.ndarray) -> Any:
    properties = mitsuba.Properties()
    reflectance = {"type": "mesh_attribute", "name": "face_color"}
    diffuse = {"type": "diffuse", "reflectance": reflectance}
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "bsdf": diffuse})
    mesh = mitsuba.Mesh("surface", len(vertices), len(surface), props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = surface.faces.astype(np.uint32).ravel()
    mesh.add_attribute("face_color", 3, surface.colours.ravel())
    parameters.update()
    return mesh


def _environment(mitsuba: Any, light: SkyLight) -> dict[str, Any]:
    """The table of the sky as mitsuba wants it: rows from the zenith down, y up, turned to z up."""
    polar = (np.arange(_MAP_ROWS) + 0.5) / _MAP_ROWS * np.pi
    azimuth = (np.arange(2 * _MAP_ROWS) + 0.5) / _MAP_ROWS * np.pi
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    level = np.sin(polar)
    directions = np.stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.cos(polar)], -1)
    sky = light.radiance(directions.reshape(-1, 3).astype(np.float32), diffuse=True)
    return {
        "type": "envmap",
        "bitmap": mitsuba.Bitmap(np.ascontiguousarray(sky.reshape(_MAP_ROWS, 2 * _MAP_ROWS, 3))),
        "to_world": mitsuba.ScalarTransform4f().rotate([1, 0, 0], 90),
    }


MIRROR_ROUGHNESS = 0.1
"""Up to here a surface mirrors; beyond, its reflection is a blur like its diffuse light."""
HIGHLIGHT_ROUGHNESS = np.float32(0.2)
"""Least width of the sun's highlight: a mirror's would be a few pixels far beyond white."""
HIGHLIGHT_LIMIT = np.float32(20.0)
"""Most that the lobe of the highlight may be, 1/sr."""
WHITE_LEVEL = 0.78
"""What a white level surface in the open becomes before the tone curve, at exposure 1."""
CLIP = 4.0
"""Radiance, in units of a white surface, at which a pixel's samples saturate before averaging."""

SATURATION = np.float32(1.12)
"""Cameras render colours a little stronger than they are."""
_TABLE_SIZE = 4096

OFFSETS = np.array([[-1, -3], [3, -1], [1, 3], [-3, 1]], np.float64) / 8
"""Places of the further rays in a pixel, from its centre: a rotated grid."""
COLOUR_STEP = np.float32(0.04)
"""Difference of two face colours that makes an edge."""
CONTRAST = np.float32(0.15)
"""Difference of what two mirrors show, in square roots of white, that makes an edge."""
LEAST_LIKENESS = np.float32(0.2)
"""Sum of weights that neighbours must have for light to be borrowed from them."""


def fresnel(points: SurfacePoints) -> Float32Array:
    """Reflectance (N, 3) of materials with a specular part; metals take the colour of the face.

    Schlick, "An inexpensive BRDF model for physically-based rendering" (1994).
    """
    base = TABLE.specular[points.material][:, None]
    metallic = TABLE.metallic[points.material][:, None]
    base = base * np.where(metallic, points.colour, np.float32(1))
    grazing = (1 - points.cosine) ** 5
    # Rough surfaces hide themselves at grazing angles.
    grazing *= 1 - TABLE.roughness[points.material]
    return base + (1 - base) * grazing[:, None]


def reflected(light: SkyLight, points: SurfacePoints, arriving: Light) -> Float32Array:
    """Radiance (N, 3) that a perfect coat on the points would reflect, sun included.

    Args:
        points: all of materials that have a specular part.
        arriving: the light at the points: sun seen, and blurred surroundings.
    """
    radiance = arriving.sky.copy()
    mirror = np.flatnonzero(TABLE.roughness[points.material] <= MIRROR_ROUGHNESS)
    coat = points.take(mirror)
    directions = mirror_directions(coat.view, coat.normal, coat.flat)
    radiance[mirror] = incoming(points.posed, light, coat.origin, directions)
    radiance += _highlight(light, points, arriving.sun)
    return radiance


def mirror_directions(view: Float32Array, normal: Float32Array, flat: Float32Array) -> Float32Array:
    """Unit directions (N, 3) of `view` mirrored at `normal`, kept outside the face `flat`."""
    directions = view - scaled(normal, 2 * dot(view, normal))
    below = np.minimum(dot(directions, flat) - np.float32(0.01), 0)
    directions -= scaled(flat, 2 * below)
    return normalise(directions)


def _highlight(light: SkyLight, points: SurfacePoints, sun: Float32Array) -> Float32Array:
    """The sun in a slightly rough surface (N, 3): lobe of Blinn (1977), energy kept."""
    towards = light.sun_direction.astype(np.float32)
    half = normalise(towards - points.view + np.float32(1e-6))
    width = np.maximum(TABLE.roughness[points.material], HIGHLIGHT_ROUGHNESS) ** 2
    exponent = 2 / width**2 - 2
    cosine = np.clip(dot(points.normal, half), 0, 1)
    lobe = np.minimum((exponent + 2) / (8 * PI) * cosine**exponent, HIGHLIGHT_LIMIT)
    facing = points.normal @ towards > 0
    return outer(lobe * facing * sun, light.sun)


def shade(
    light: SkyLight, points: SurfacePoints, arriving: Light, pixel_angle: float
) -> Float32Array:
    """Radiance (N, 3): textured diffuse part, emission, reflection, seen through haze.

    Args:
        pixel_angle: radians between neighbouring rays, for the detail of textures.
    """
    radiance = outer(arriving.sun * sun_cosine(light, points) / PI, light.sun)
    radiance += arriving.sky
    glowing = np.flatnonzero(TABLE.emission[points.material] > 0)
    emission = TABLE.emission[points.material[glowing]] * np.float32(light.white)
    radiance[glowing] += emission[:, None]
    radiance *= textured(points, pixel_angle)
    index = np.flatnonzero(TABLE.specular[points.material] > 0)
    coat = points.take(index)
    share = fresnel(coat)
    bare = np.where(TABLE.metallic[coat.material], np.float32(0), 1 - share.max(axis=1))
    light_there = Light(rows(arriving.sun, index), rows(arriving.sky, index))
    share *= reflected(light, coat, light_there)
    share += scaled(rows(radiance, index), bare)
    radiance[index] = share
    clear = np.exp(points.distance / np.float32(-HAZE_LENGTH))
    scale(radiance, clear)
    radiance += outer(1 - clear, light.haze)
    return radiance


def filmic(linear: Float32Array) -> Float32Array:
    """Film-like curve from scene-linear to display-linear [0, 1]: toe, straight part, shoulder.

    The rational form of K. Narkowicz, "ACES filmic tone mapping curve" (2015), with its toe raised
    from 0.03 to 0.12: cameras on cars keep shadows readable.
    """
    curve = linear * (2.51 * linear + 0.12) / (linear * (2.43 * linear + 0.59) + 0.14)
    return np.clip(curve, 0, 1)


def _table() -> NDArray[np.float32]:
    level = (np.linspace(0, 1, _TABLE_SIZE) ** 2 * 16).astype(np.float32)
    return (linear_to_srgb(filmic(level)) * 255).astype(np.float32)


_CURVE = _table()


def develop(radiance: Float32Array, white: float, exposure: float) -> NDArray[np.uint8]:
    """Image (..., 3) uint8 of linear radiance (..., 3).

    Args:
        white: radiance of a white level surface in the open.
        exposure: factor on the light; 1 is right for the day.
    """
    scale = np.float32(exposure * WHITE_LEVEL / white / 16)
    grey = radiance @ LUMINANCE
    vivid = radiance * SATURATION + ((1 - SATURATION) * grey)[..., None]
    position = np.sqrt(np.clip(vivid * scale, 0, 1)) * np.float32(_TABLE_SIZE - 1)
    below = np.minimum(position.astype(np.int32), _TABLE_SIZE - 2)
    value = np.take(_CURVE, below)
    value += (np.take(_CURVE, below + 1) - value) * (position - below)
    return (value + np.float32(0.5)).astype(np.uint8)


def edge_pixels(
    points: SurfacePoints,
    pixels: NDArray[np.int64],
    radiance: Float32Array,
    white: float,
    height: int,
    width: int,
) -> NDArray[np.int64]:
    """Pixels (row major) whose surface differs from that of a neighbour.

    Differs in instance, material, normal, distance or colour, and for mirrors in what they show.
    """
    count = height * width
    inverse = np.reciprocal(np.maximum(points.distance, np.float32(1e-3)))
    grey = points.colour @ np.array([0.5, 0.9, 0.25], np.float32)
    mirror = (TABLE.specular[points.material] > 0) & (
        TABLE.roughness[points.material] <= MIRROR_ROUGHNESS
    )
    shown: Float32Array = np.sqrt(np.minimum(radiance[:, 1] / np.float32(white), 2))
    shown = np.where(mirror, shown, np.float32(0)).astype(np.float32, copy=False) / CONTRAST
    edge = compiled.edges(
        points, inverse, grey, shown, compiled.index_plane(pixels, height, width), COLOUR_STEP
    )
    if edge is not None:
        return edge
    # Sky keeps zeros: its normal differs from all.
    flat_planes = np.zeros((8, count), np.float32)
    flat_planes[0:3, pixels] = points.flat.T
    for plane, values in enumerate((inverse, grey, shown), 3):
        flat_planes[plane, pixels] = values
    flat_planes[6, pixels] = points.material
    flat_planes[7, pixels] = points.instance
    planes = flat_planes.reshape(8, height, width)
    marked = np.zeros((height, width), bool)
    for axis in (0, 1):
        first = (slice(None),) * axis + (slice(None, -1),)
        second = (slice(None),) * axis + (slice(1, None),)
        differs = _differ(planes[:, *first], planes[:, *second])
        marked[first] |= differs
        marked[second] |= differs
    return np.flatnonzero(marked)


def _differ(first: Float32Array, second: Float32Array) -> BoolArray:
    dot = first[0] * second[0]
    dot += first[1] * second[1]
    dot += first[2] * second[2]
    hit = (first[3] > 0) | (second[3] > 0)
    differs = (dot < 0.9) & hit
    # The inverse of distance is linear on a plane: a step is an edge, a slope is not.
    steep = np.minimum(first[3], second[3]) < np.float32(0.8) * np.maximum(first[3], second[3])
    differs |= steep & (np.minimum(first[3], second[3]) > 0)
    differs |= np.abs(first[4] - second[4]) > COLOUR_STEP
    differs |= (first[6] == second[6]) & (np.abs(first[5] - second[5]) > 1)
    differs |= first[6] != second[6]
    differs |= first[7] != second[7]
    return differs


def borrow_light(
    points: SurfacePoints,
    pixels: NDArray[np.int64],
    arriving: Light,
    others: SurfacePoints,
    other_pixels: NDArray[np.int64],
    place: Array,
    height: int,
    width: int,
) -> tuple[Light, NDArray[np.int64]]:
    """Light of further points from smoothed light in the 3 x 3 pixels about them.

    Args:
        points, pixels, arriving: points of the centre rays, their pixels, and the light at them.
        others, other_pixels: the further points and the pixel that each lies in.
        place: (2,) where in the pixel, one of `OFFSETS`.

    Returns:
        their light, and the indices of those that found no like surface nearby.
    """
    wide = width + 2
    right, down = (1 if offset > 0 else -1 for offset in place)
    served = compiled.borrow(
        points,
        (arriving.sun, arriving.sky),
        compiled.index_plane(pixels, height, width),
        others,
        other_pixels,
        (right, down),
        (PLANE_TOLERANCE, LEAST_LIKENESS),
    )
    if served is not None:
        sun, sky, alone = served
        return Light(sun, sky), alone
    table = np.zeros(((height + 2) * wide, 10), np.float32)
    row = (pixels // width + 1) * wide + pixels % width + 1
    table[row, 0:3], table[row, 3:6] = points.position, points.normal
    table[row, 6], table[row, 7:] = arriving.sun, arriving.sky
    centre = (other_pixels // width + 1) * wide + other_pixels % width + 1
    borrowed = np.zeros((len(others), 4), np.float32)
    # The four pixels whose centres lie nearest serve most; the rest look further.
    near = ((0, 0), (right, 0), (0, down), (right, down))
    far = [(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y) not in near]
    left = np.arange(len(others))
    for steps in (near, far):
        total, value = _gather(
            table,
            [rows(centre, left) + x + y * wide for x, y in steps],
            others.take(left) if len(left) < len(others) else others,
        )
        found = total >= LEAST_LIKENESS
        index = np.flatnonzero(found)
        borrowed[left[index]] = rows(value, index) / rows(total, index)[:, None]
        left = left[~found]
    return Light(borrowed[:, 0].copy(), np.ascontiguousarray(borrowed[:, 1:])), left


def _gather(
    table: Float32Array, places: list[NDArray[np.int64]], points: SurfacePoints
) -> tuple[Float32Array, Float32Array]:
    """Sums of likeness (N,) and of light times likeness (N, 4) over rows of `table`."""
    tolerance = 1 / (PLANE_TOLERANCE * (1 + np.float32(0.1) * points.distance))
    foot = dot(points.position, points.normal)
    total = np.zeros(len(points), np.float32)
    value = np.zeros((len(points), 4), np.float32)
    for place in places:
        near = rows(table, place)
        weight = np.maximum(dot(near[:, 3:6], points.normal), 0)
        weight *= weight
        weight *= weight
        weight *= weight
        off = (dot(near[:, :3], points.normal) - foot) * tolerance
        weight /= 1 + off * off
        total += weight
        value += scaled(near[:, 6:], weight)
    return total, value
