"""Light of many bounces, path traced by mitsuba: the `quality="mitsuba"` of `render_camera`.

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

from recast.core.errors import InputError
from recast.geometry import se3
from recast.synthetic.rendering.lighting import SkyLight
from recast.synthetic.rendering.rays import (
    STREET,
    Float32Array,
    PosedScene,
    RayMesh,
    cosine_directions,
    rows,
)
from recast.synthetic.rendering.surface_points import SurfacePoints
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
