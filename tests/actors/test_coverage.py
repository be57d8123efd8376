"""What of a vehicle a camera sees was seen, mirrored or invented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.actors.actor import NOTHING, Coverage, CoverageMeter
from recast.geometry import se2, se3
from recast.scene import SceneActor, SkyMap, StreetScene
from recast.scene.street_scene import SceneRasterizer
from recast.splats import CLASSIC, MIP, Gaussians, LowPass
from recast.splats.gaussians import C0
from support.box_world import CAMERA, FACES, MOUNTS, SIZE, box_log, box_shares, scene

CAMERA_FROM_WORLD = se3.inverse(MOUNTS["front"].rig_from_camera)
WHOLE = scene(tuple(FACES), box_log())


SHARES = box_shares(WHOLE)


def pose(x: float, y: float, heading: float) -> np.ndarray:
    return se2.to_se3(np.array([x, y, heading]), SIZE[2] / 2)


def blobs(count: int, rng: np.random.Generator, low: list[float], high: list[float]) -> Gaussians:
    return Gaussians(
        torch.from_numpy(rng.uniform(low, high, (count, 3))).float(),
        torch.from_numpy(rng.normal(size=(count, 4))).float(),
        torch.from_numpy(rng.uniform(-4.0, -1.5, (count, 3))).float(),
        torch.from_numpy(rng.uniform(-3.0, 5.0, count)).float(),
        torch.from_numpy(rng.normal(size=(count, 4, 3))).float(),
    )


def crowded(low_pass: LowPass) -> StreetScene:
    """The vehicle with a shadow among blobs, some of another vehicle."""
    rng = np.random.default_rng(4)
    street = blobs(3000, rng, [-5.0, -12.0, -1.0], [40.0, 12.0, 6.0])
    shadow = blobs(40, rng, [-2.0, -1.0, -0.8], [2.0, 1.0, -0.7])
    other = SceneActor(
        "8",
        blobs(200, rng, [-1.0] * 3, [1.0] * 3),
        SIZE,
        WHOLE.actors["7"].trajectory,
        low_pass=MIP,
    )
    vehicle = replace(WHOLE.actors["7"], low_pass=low_pass, shadow=shadow)
    return replace(WHOLE, background=street, actors={"7": vehicle, "8": other})


def drawn_whole(street: StreetScene, poses: dict[str, np.ndarray]) -> np.ndarray:
    """Areas (3,) by the whole image, everything black but the vehicle's shares."""

    def black(gaussians: Gaussians) -> Gaussians:
        return replace(gaussians, sh=torch.full((len(gaussians), 1, 3), -9.0))

    vehicle, other = street.actors["7"], street.actors["8"]
    coloured = replace(vehicle.gaussians, sh=((SHARES.columns - 0.5) / C0)[:, None])
    assert vehicle.shadow is not None
    vehicle = replace(vehicle, gaussians=coloured, shadow=black(vehicle.shadow))
    painted = replace(
        street,
        background=black(street.background),
        sky=SkyMap.constant(torch.zeros(3)),
        actors={"7": vehicle, "8": replace(other, gaussians=black(other.gaussians))},
    )
    image = SceneRasterizer(painted, "cpu").render(CAMERA, CAMERA_FROM_WORLD, poses)
    return image.rgb.astype(np.float64).sum(axis=(0, 1))


@pytest.mark.parametrize("low_pass", [CLASSIC, MIP])
@pytest.mark.parametrize(
    "place", [(12.0, 0.0, 0.3), (18.0, 5.0, 2.0), (9.0, -3.6, -1.2), (4.5, 1.5, 0.7)]
)
def test_it_is_what_the_whole_image_shows(
    low_pass: LowPass, place: tuple[float, float, float]
) -> None:
    """In the middle, behind much, half outside, and so near that part is behind the camera."""
    street, poses = crowded(low_pass), {"7": pose(*place), "8": pose(7.0, 0.5, 0.0)}
    wanted = Coverage.of(drawn_whole(street, poses))
    found = CoverageMeter(street, "7", SHARES, "cpu").measure(CAMERA, CAMERA_FROM_WORLD, poses)
    assert wanted.pixels > 20
    assert found.pixels == pytest.approx(wanted.pixels, rel=1e-3)
    for name in ("seen", "mirrored", "invented"):
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), abs=1e-3)


def test_the_side_that_is_shown_counts() -> None:
    meter = CoverageMeter(WHOLE, "7", SHARES, "cpu")

    def of(heading: float) -> Coverage:
        return meter.measure(CAMERA, CAMERA_FROM_WORLD, {"7": pose(12.0, 0.0, heading)})

    rear, left, front = of(0.0), of(np.pi / 2), of(np.pi)
    assert rear.seen > 0.7 and rear.mirrored < 0.05  # the roof was not seen
    assert left.mirrored > 0.7 and left.seen < 0.05
    assert front.invented > 0.95
    assert left.pixels > rear.pixels > 100
    assert rear.seen + rear.mirrored + rear.invented == pytest.approx(1.0)


def test_what_stands_before_it_hides_it() -> None:
    grid = np.stack(np.meshgrid([8.0], np.arange(-4, 4, 0.1), np.arange(-1, 4, 0.1)), -1)
    points = torch.from_numpy(grid.reshape(-1, 3)).float()
    count = len(points)
    wall = Gaussians(
        points,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.full((count, 3), -2.3),
        torch.full((count,), 6.0),
        torch.zeros(count, 1, 3),
    )
    behind = {"7": pose(14.0, 0.0, 0.4)}
    hidden = CoverageMeter(replace(WHOLE, background=wall), "7", SHARES, "cpu")
    assert hidden.measure(CAMERA, CAMERA_FROM_WORLD, behind) == NOTHING
    before = hidden.measure(CAMERA, CAMERA_FROM_WORLD, {"7": pose(5.0, 0.0, 0.4)})
    free = CoverageMeter(WHOLE, "7", SHARES, "cpu")
    assert before == free.measure(CAMERA, CAMERA_FROM_WORLD, {"7": pose(5.0, 0.0, 0.4)})
    right = wall.select(points[:, 1] < 0.0)
    half = CoverageMeter(replace(WHOLE, background=right), "7", SHARES, "cpu")
    share = half.measure(CAMERA, CAMERA_FROM_WORLD, behind).pixels
    assert 0.3 < share / free.measure(CAMERA, CAMERA_FROM_WORLD, behind).pixels < 0.7


def test_out_of_view_and_black_pixels() -> None:
    meter = CoverageMeter(WHOLE, "7", SHARES, "cpu")
    for place in ((-12.0, 0.0, 0.0), (8.0, 30.0, 0.0)):
        assert meter.measure(CAMERA, CAMERA_FROM_WORLD, {"7": pose(*place)}) == NOTHING
    poses = {"7": pose(12.0, 0.0, 0.0)}
    whole = meter.measure(CAMERA, CAMERA_FROM_WORLD, poses)
    shown = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
    assert meter.measure(CAMERA, CAMERA_FROM_WORLD, poses, shown) == NOTHING
    shown[:, : CAMERA.width // 2] = True
    half = meter.measure(CAMERA, CAMERA_FROM_WORLD, poses, shown)
    assert half.pixels == pytest.approx(whole.pixels / 2, rel=0.05)  # exactly from behind
    other = meter.measure(CAMERA, CAMERA_FROM_WORLD, poses, ~shown)
    assert half.pixels + other.pixels == pytest.approx(whole.pixels)


def test_means_are_of_all_pixels() -> None:
    several = [Coverage(300.0, 1.0, 0.0, 0.0), NOTHING, Coverage(100.0, 0.0, 0.5, 0.5)]
    assert Coverage.mean(several) == Coverage(200.0, 0.75, 0.125, 0.125)
    assert Coverage.mean([NOTHING]) == NOTHING
    assert Coverage.of(np.array([0.3, 0.3, 0.3])) == NOTHING  # less than a pixel


def test_shares_of_another_vehicle_are_refused() -> None:
    fewer = SHARES.select(torch.arange(5))
    for track, shares in (("7", fewer), ("8", SHARES)):
        with pytest.raises(ValueError, match="CoverageMeter"):
            CoverageMeter(WHOLE, track, shares)
