"""The compiled kernel beside numpy, and rays in packets beside single ones."""

from __future__ import annotations

import numpy as np
import pytest

from recast import kernel
from recast.synthetic.rendering import CameraFrame, RayScene, compiled, render_camera
from recast.synthetic.rendering import rays as single
from recast.synthetic.rendering.compiled import packets_work
from recast.synthetic.rendering.rays import NO_HIT, RayMesh, _Spheres
from recast.synthetic.surface import Surface, concatenate
from synthetic.rendering.shapes import CAMERA, box, camera_at, plane, pose, sky

pytestmark = pytest.mark.skipif(kernel.find() is None, reason="the kernel was not built")
POSES = {"car": pose(8, 0, yaw=0.4), "other": pose(14, 3, yaw=-1.0), "wall": pose(11, -3, 2)}


def scene() -> RayScene:
    """A street with a house of glass, two painted cars and a wall."""
    house = box((6, 4, 5), (0.3, 0.3, 0.3), "glass").transformed(pose(16, -5, 2.5, 0.2))
    cars = {"car": box(material="paint"), "other": box(colour=(0.1, 0.3, 0.6), material="paint")}
    return RayScene(concatenate([plane(), house]), {**cars, "wall": box((0.5, 4, 4))})


def frame(of: RayScene, seed: int = 0) -> CameraFrame:
    rng = np.random.default_rng(seed)
    return render_camera(of, sky(), CAMERA, camera_at(0, 0, 2), POSES, rng=rng)


def rms(first: CameraFrame, second: CameraFrame) -> float:
    return float(np.sqrt(np.mean((first.rgb.astype(float) - second.rgb) ** 2)))


def test_frames_are_those_of_numpy_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(single, "packets_work", lambda: False)
    street = scene()
    ours = frame(street)
    assert len(np.unique(ours.instance)) == 5  # street, three models, sky
    monkeypatch.setattr(compiled, "library", lambda: None)
    numpy = frame(street)
    for name in ("rgb", "depth", "instance", "alpha"):
        assert getattr(ours, name).tobytes() == getattr(numpy, name).tobytes(), name


def test_spheres_are_entered_where_numpy_says(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    spheres = _Spheres([(rng.uniform(-20, 20, 3), rng.uniform(1, 4)) for _ in range(5)])
    origins = rng.uniform(-30, 30, (40_000, 3)).astype(np.float32)
    directions = rng.normal(size=(40_000, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ours = spheres.entered(origins, directions)
    monkeypatch.setattr(compiled, "library", lambda: None)
    numpy = spheres.entered(origins, directions)
    both = np.isfinite(ours) & np.isfinite(numpy)
    assert both.sum() > 300
    # Squares of up to 100 m, rounded, decide: a graze of a sphere may go either way.
    assert np.mean(np.isfinite(ours) != np.isfinite(numpy)) < 1e-3
    assert np.allclose(ours[both], numpy[both], atol=100 * 8 * np.finfo(np.float32).eps)


def test_arrays_that_the_kernel_would_misread_are_refused() -> None:
    with pytest.raises(ValueError, match="contiguous"):
        compiled.address(np.zeros((4, 4), np.float32)[:, 1])
    with pytest.raises(ValueError, match="float64"):
        compiled.address(np.zeros((4, 4)))


def crumpled(rng: np.random.Generator) -> Surface:
    corners = rng.uniform(-5, 5, (400, 1, 3)) + rng.uniform(-1, 1, (400, 3, 3))
    faces = np.arange(1200).reshape(400, 3)
    return Surface.make(corners.reshape(-1, 3), faces, (0.5, 0.5, 0.5), "matte")


needs_packets = pytest.mark.skipif(not packets_work(), reason="embreex carries no library we know")


@needs_packets
@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("count", [1, 37, 5000])
def test_packets_meet_what_single_rays_meet(
    coherent: bool, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(count)
    surface = crumpled(rng)
    packets = RayMesh(surface)
    monkeypatch.setattr(single, "packets_work", lambda: False)
    reference = RayMesh(surface)
    origins = rng.uniform(-8, 8, (count, 3)).astype(np.float32)
    directions = rng.normal(size=(count, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    limit = rng.uniform(0, 10, count).astype(np.float32)
    for far in (None, limit):
        ours = packets.first_hits(origins, directions, far, coherent=coherent)
        theirs = reference.first_hits(origins, directions, far)
        # A ray through an edge, or one that ends on a face, may go either way.
        same = ours.face == theirs.face
        assert same.mean() > 0.998
        hit = same & (ours.face >= 0)
        assert np.all(ours.distance[same & ~hit] == NO_HIT)
        # Corners of up to 14 m at a slant of up to a hundred lose seven bits.
        for name in ("distance", "u", "v"):
            assert np.allclose(getattr(ours, name)[hit], getattr(theirs, name)[hit], atol=2e-4)
        assert far is None or np.all(ours.distance[hit] < far[hit])
    blocked = packets.occluded(origins, directions, coherent=coherent)
    assert np.mean(blocked == reference.occluded(origins, directions)) > 0.998
    assert count < 50 or 0.1 < blocked.mean() < 0.9


@needs_packets
def test_frames_by_packets_differ_less_than_two_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    packets = frame(scene())
    again = frame(scene())
    assert packets.rgb.tobytes() == again.rgb.tobytes()
    monkeypatch.setattr(single, "packets_work", lambda: False)
    street = scene()
    reference, other = frame(street), frame(street, seed=1)
    noise = rms(reference, other)
    assert 0 < noise < 4
    assert rms(packets, reference) < noise
    same = packets.instance == reference.instance
    assert same.mean() > 0.999
    near = same & (reference.depth < 50)
    assert np.allclose(packets.depth[near], reference.depth[near], rtol=1e-4)


@needs_packets
def test_packets_take_only_float32_rays() -> None:
    mesh = RayMesh(box())
    with pytest.raises(ValueError, match="origins"):
        mesh.occluded(np.zeros((2, 3)), np.ones((2, 3), np.float32))
