"""The path tracer agrees with the light of one bounce in the open, and finds more where it is shut.

Skipped where mitsuba does not run; what is said then is tested everywhere.
"""

from __future__ import annotations

import subprocess

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.synthetic.rendering import RayScene, render_camera
from recast.synthetic.rendering.lighting import sample_light, sky_light
from recast.synthetic.rendering.rays import normalise
from recast.synthetic.rendering.shading import path_light, working_llvm
from recast.synthetic.rendering.surface_points import surface_points
from recast.synthetic.surface import concatenate
from synthetic.rendering.shapes import CAMERA, box, camera_at, nothing, plane, pose, sky


@pytest.fixture(scope="module")
def mitsuba() -> None:
    pytest.importorskip("mitsuba")
    try:
        working_llvm()
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("height", [0.0, 1.0])
def test_light_in_the_open_agrees(mitsuba: None, height: float) -> None:
    # Level ground sees only the sky; the box's sides see sunlit ground as well.
    scene = RayScene(plane((0.2, 0.2, 0.2), "matte"), {"box": box((3, 3, 2))})
    posed, light = scene.posed({"box": pose(0, 0, 1.0)}), sky_light(sky(clouds=0.6))
    rng = np.random.default_rng(0)
    if height:
        origins = np.tile([-9.0, 0.0, height], (4000, 1)).astype(np.float32)
        directions = np.tile([1.0, 0.0, 0.0], (4000, 1)).astype(np.float32)
    else:
        origins = np.tile([30.0, 0.0, 2.0], (4000, 1)).astype(np.float32)
        directions = np.tile([0.0, 0.0, -1.0], (4000, 1)).astype(np.float32)
    hits = posed.cast(origins, directions)
    _, points = surface_points(posed, origins, directions, hits)
    samples = rng.random((2, len(points), 2), np.float32)
    ours = sample_light(light, points, samples[0], samples[1]).sky.mean(axis=0)
    theirs = path_light(light, points, rng).mean(axis=0)
    assert np.allclose(theirs, ours, rtol=0.06)


def test_sky_is_turned_the_right_way(mitsuba: None) -> None:
    light = sky_light(sky(clouds=0.5))
    rng = np.random.default_rng(0)
    ground, air = RayScene(plane(), {}).posed({}), RayScene(nothing(), {}).posed({})
    origins = rng.uniform(-5, 5, (64, 3)).astype(np.float32) + np.float32([0, 0, 20])
    directions = np.tile(np.float32([0, 0, -1]), (64, 1))
    _, points = surface_points(ground, origins, directions, ground.cast(origins, directions))
    # Normals to many sides, nothing around but sky.
    points.posed = air
    points.normal[:] = normalise(rng.normal(size=(64, 3)).astype(np.float32))
    points.flat[:] = points.normal
    rounds = rng.random((1000, 64, 2), np.float32)
    ours = np.mean([sample_light(light, points, r, r).sky for r in rounds], axis=0)
    theirs = np.mean([path_light(light, points, rng) for _ in range(80)], axis=0)
    assert np.allclose(theirs, ours, rtol=0.1)
    assert np.corrcoef(ours[:, 1], theirs[:, 1])[0, 1] > 0.98


def test_image(mitsuba: None) -> None:
    roof = box((12, 8, 0.3), (0.5, 0.5, 0.5)).transformed(pose(8, 0, 4))
    scene = RayScene(concatenate([plane(), roof]), {"car": box(material="paint")})

    def render(quality: str, seed: int = 0):
        return render_camera(
            scene,
            sky(),
            CAMERA,
            camera_at(0, 0, 2),
            {"car": pose(9, 1)},
            rng=np.random.default_rng(seed),
            quality=quality,
        )

    standard, traced, again = render("standard"), render("mitsuba"), render("mitsuba")
    assert traced.rgb.tobytes() == again.rgb.tobytes()
    assert traced.depth.tobytes() == standard.depth.tobytes()
    difference = traced.rgb.astype(float) - standard.rgb
    assert np.abs(difference).mean() < 8
    assert traced.rgb.tobytes() != standard.rgb.tobytes()


def test_missing_mitsuba_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object, **options: object) -> subprocess.CompletedProcess:
        return subprocess.CompletedProcess([], 1)

    monkeypatch.setattr(subprocess, "run", fail)
    with pytest.raises(InputError, match=r"not installed.*recast-sim\[mitsuba\]"):
        working_llvm.__wrapped__()


def test_wrong_llvm_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def abort_trial(command: list[str], **options: object) -> subprocess.CompletedProcess:
        return subprocess.CompletedProcess(command, 0 if command[-1] == "import mitsuba" else -6)

    monkeypatch.setattr(subprocess, "run", abort_trial)
    with pytest.raises(InputError, match=r"LLVM.*libllvm19"):
        working_llvm.__wrapped__()


def test_unknown_quality_is_refused() -> None:
    with pytest.raises(ValueError, match="quality"):
        render_camera(
            RayScene(plane(), {}),
            sky(),
            CAMERA,
            camera_at(0, 0, 2),
            {},
            rng=np.random.default_rng(0),
            quality="best",
        )
