"""Images: exact depth and masks, plausible light, the same bytes for the same seed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from recast.geometry import boxes, se3
from recast.synthetic.rendering import SKY, RayScene, render_camera
from synthetic.rendering.shapes import CAMERA, box, camera_at, nothing, plane, pose, sky


def render(scene: RayScene, poses: dict | None = None, seed: int = 0, **changes: object):
    arguments = {"camera": CAMERA, "world_from_camera": camera_at(0, 0, 2), "exposure": 1.0}
    arguments.update(changes)
    return render_camera(
        scene,
        changes.pop("sky", sky()),
        arguments["camera"],
        arguments["world_from_camera"],
        poses or {},
        rng=np.random.default_rng(seed),
        exposure=arguments["exposure"],
        hidden=changes.get("hidden", ()),
        street=changes.get("street", True),
    )


@pytest.fixture(scope="module")
def street() -> RayScene:
    return RayScene(plane(), {"car": box(material="paint"), "wall": box((0.5, 8, 5))})


def test_depth_of_the_ground_is_exact(street: RayScene) -> None:
    depth = render(street).depth
    rows = np.arange(CAMERA.height) + 0.5
    expected = 2.0 / ((rows - CAMERA.cy) / CAMERA.fy)
    below = (rows > CAMERA.cy) & (expected < 190)
    assert below.sum() > 15
    assert np.allclose(depth[below], expected[below, None], rtol=2e-5)
    assert np.all(np.isinf(depth[rows < CAMERA.cy]))


def test_masks_agree_with_projected_boxes(street: RayScene) -> None:
    world_from_box = pose(12, 1, yaw=0.4)
    frame = render(street, {"car": world_from_box})
    corners = boxes.corners([4.0, 1.8, 1.5], se3.inverse(camera_at(0, 0, 2)) @ world_from_box)
    pixels, _ = CAMERA.project(corners)
    hull = cv2.convexHull(pixels.astype(np.float32))
    inside = np.array(
        [
            [cv2.pointPolygonTest(hull, (x + 0.5, y + 0.5), True) for x in range(CAMERA.width)]
            for y in range(CAMERA.height)
        ]
    )
    assert np.all(frame.instance[inside > 0.05] == 1)
    assert not np.any(frame.instance[inside < -0.05] == 1)


def test_alpha_is_the_share_that_is_not_sky(street: RayScene) -> None:
    frame = render(street, {"wall": pose(10, 0, 2.5)})
    assert np.all(frame.alpha[frame.instance != SKY] > 0)
    sky_inside = frame.instance == SKY
    assert np.all(frame.alpha[sky_inside] < 1)
    assert np.all(frame.alpha[:2] == 0) and np.all(frame.alpha[-2:] == 1)
    edge = frame.alpha[(frame.alpha > 0) & (frame.alpha < 1)]
    assert len(edge) > 5 and np.allclose(edge * 5, np.round(edge * 5), atol=1e-5)


def test_shadow_is_darker_than_sunlit_ground() -> None:
    scene = RayScene(plane(), {"wall": box((8, 0.4, 4))})
    # The sun stands to the left (+y): the wall's shadow falls to the right of it.
    frame = render(scene, {"wall": pose(12, 3, 2.0)}, sky=sky(elevation=45, clouds=0.0))
    ground = frame.rgb.astype(float).mean(axis=2)
    pixel = lambda x, y: CAMERA.project(  # noqa: E731
        se3.apply(se3.inverse(camera_at(0, 0, 2)), np.array([[x, y, 0.0]]))
    )[0][0].astype(int)
    shaded, lit = pixel(12, 1.5), pixel(12, -3.5)
    assert ground[shaded[1], shaded[0]] < 0.75 * ground[lit[1], lit[0]]


def test_same_seed_same_bytes(street: RayScene) -> None:
    first, again, other = (render(street, {"car": pose(8, 0)}, seed) for seed in (3, 3, 4))
    for name in ("rgb", "depth", "instance", "alpha"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
    assert first.depth.tobytes() == other.depth.tobytes()  # exact whatever the samples of light
    assert first.rgb.tobytes() != other.rgb.tobytes()


def test_noise_between_seeds_is_low(street: RayScene) -> None:
    first, other = (render(street, {"car": pose(8, 0)}, seed).rgb.astype(float) for seed in (1, 2))
    assert np.sqrt(np.mean((first - other) ** 2)) < 3.0
    assert np.mean(np.abs(first - other) > 25) < 0.002


def test_longer_exposure_is_nowhere_darker(street: RayScene) -> None:
    frames = [render(street, {"car": pose(8, 0)}, exposure=e).rgb for e in (0.5, 1.0, 2.0)]
    for darker, brighter in pairwise(frames):
        # Clipping before the average of a pixel's samples may cost a level.
        assert np.all(brighter.astype(int) >= darker.astype(int) - 1)
        assert brighter.mean() > darker.mean() + 10


def test_textures_move_with_their_object() -> None:
    scene = RayScene(nothing(), {"crate": box((2, 2, 2), (0.4, 0.2, 0.1), "brick")})
    move = se3.from_rotation_translation(np.eye(3), [5.0, -3.0, 1.0])
    still = render(scene, {"crate": pose(5, 0, 2)}, sky=sky(clouds=0.0))
    moved = render(
        scene,
        {"crate": move @ pose(5, 0, 2)},
        world_from_camera=move @ camera_at(0, 0, 2),
        sky=sky(clouds=0.0),
    )
    inside = still.alpha == 1
    difference = np.abs(still.rgb.astype(int) - moved.rgb.astype(int))[inside]
    assert still.rgb[inside].std() > 8  # there is a texture at all
    assert np.mean(difference > 2) < 0.01


def test_vehicles_alone_keep_their_colour_at_edges() -> None:
    scene = RayScene(nothing(), {"crate": box((2, 2, 2), (0.6, 0.03, 0.03))})
    frame = render(scene, {"crate": pose(7, 0, 2, yaw=0.3)}, world_from_camera=camera_at(0, 0, 3))
    edge = (frame.alpha > 0) & (frame.alpha < 1)
    assert edge.sum() > 10
    assert np.all(frame.rgb[frame.alpha == 0] == 0)
    red, blue = frame.rgb[edge][:, 0].astype(int), frame.rgb[edge][:, 2].astype(int)
    assert np.all(red > blue + 40)  # no sky mixed in


@pytest.mark.parametrize("place", [(7, 0), (5, 3), (1.5, 0.5), (-6, 0), (40, -15)])
def test_vehicles_alone_are_where_rays_meet_them(place: tuple[float, float]) -> None:
    scene = RayScene(nothing(), {"car": box()})
    poses, world_from_camera = {"car": pose(*place, yaw=0.3)}, camera_at(0, 0, 1.5)
    frame = render(scene, poses, world_from_camera=world_from_camera)
    rays = CAMERA.rays(CAMERA.pixel_grid().reshape(-1, 2))
    length = np.linalg.norm(rays, axis=1)
    hits = scene.cast(
        world_from_camera[:3, 3], (rays / length[:, None]) @ world_from_camera[:3, :3].T, poses
    )
    assert np.mean(frame.instance.ravel() == hits.instance) > 0.999  # rounding at outlines
    both = (frame.instance.ravel() == 1) & (hits.instance == 1)
    assert np.allclose(frame.depth.ravel()[both], (hits.distance / length)[both], rtol=1e-4)


def test_nothing_at_all() -> None:
    frame = render(RayScene(nothing(), {}))
    assert not frame.rgb.any() and not frame.alpha.any() and np.all(frame.instance == SKY)


def test_paint_reflects_the_sky_more_than_matter_does() -> None:
    poses = {"box": pose(8, 0, 1, yaw=0.5)}
    low = {"world_from_camera": camera_at(0, 0, 2.5)}
    dark = (0.01, 0.01, 0.01)
    images = [
        render(RayScene(plane(), {"box": box((4, 3, 2), dark, m)}), poses, **low)
        for m in ("paint", "matte")
    ]
    inside = images[0].instance == 1
    assert images[0].rgb[inside].mean() > 1.3 * images[1].rgb[inside].mean()


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": replace(CAMERA, width=0)},
        {"camera": replace(CAMERA, fx=-1.0)},
        {"world_from_camera": np.eye(3)},
        {"world_from_camera": np.full((4, 4), np.nan)},
        {"exposure": 0.0},
        {"exposure": np.nan},
    ],
)
def test_what_cannot_be_is_refused(street: RayScene, changes: dict) -> None:
    with pytest.raises(ValueError):
        render(street, **changes)


def test_one_pixel_image(street: RayScene) -> None:
    tiny = replace(CAMERA, width=1, height=1)
    assert render(street, camera=tiny).rgb.shape == (1, 1, 3)


def test_what_the_camera_looks_through_still_shades(street: RayScene) -> None:
    poses = {"car": pose(12, 1, yaw=0.4)}
    whole, bare = render(street, poses), render(street)
    hidden = render(street, poses, hidden=["car"])
    np.testing.assert_array_equal(hidden.depth, bare.depth)
    np.testing.assert_array_equal(hidden.instance, bare.instance)
    ground = np.isfinite(bare.depth)
    darker = bare.rgb.astype(int)[ground] - hidden.rgb[ground]
    assert (darker.max(axis=1) > 30).sum() > 20, "the shadow"
    seen = whole.instance == 0
    lit = np.abs(whole.rgb.astype(int) - hidden.rgb).max(axis=2)[seen]
    assert np.median(lit) <= 2 and (lit > 12).mean() < 0.1, "beside the car it is the same picture"


def test_a_vehicle_alone_has_the_light_of_its_street(street: RayScene) -> None:
    poses = {"car": pose(12, 1), "wall": pose(12, 4, 2.5, yaw=np.pi / 2)}
    whole = render(street, poses)
    alone = render(street, poses, hidden=["wall"], street=False)
    car = whole.instance == 1
    np.testing.assert_allclose(alone.depth[car], whole.depth[car], rtol=1e-5)
    assert np.all(np.isinf(alone.depth[alone.alpha == 0]))
    assert not np.any(alone.rgb[alone.alpha == 0])
    inside = car & (alone.alpha == 1) & (whole.alpha == 1)
    lit = np.abs(whole.rgb.astype(int) - alone.rgb).max(axis=2)[inside]
    assert np.median(lit) <= 6, "only the samples differ"
