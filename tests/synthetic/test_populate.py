from __future__ import annotations

import itertools
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import shapely

from recast.core.errors import InputError
from recast.geometry import boxes, se2
from recast.logs import DrivingLog
from recast.synthetic import populate, traffic
from recast.synthetic.populate import (
    START_US,
    WORLD_VERSION,
    make_world,
    world_metadata,
    world_of,
)
from recast.synthetic.traffic import LATERAL_LIMIT, wheelbase
from recast.synthetic.world import Conditions, World, hiding, in_conditions, touching
from support.small_street import small_street, small_world

KINDS = ("urban-straight", "arterial-median", "suburban-curve")


BUILT = ("roundabout-approach",)


@pytest.fixture(scope="module", params=(*KINDS, *BUILT))
def drive(request: pytest.FixtureRequest) -> World:
    """8 s with the target overtaking, passed and leading, and a whole scene with tight bends."""
    if request.param in BUILT:
        return make_world(request.param)
    return small_world(KINDS.index(request.param), 8.0, request.param)


def outlines(world: World) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    rig = se2.from_se3(world.ego.poses)
    middle = se2.compose(rig, np.array([traffic.CENTRE_OFFSET, 0.0, 0.0]))
    found = {"ego": (middle, np.array([traffic.EGO_LENGTH, traffic.EGO_WIDTH]))}
    for key, vehicle in world.vehicles.items():
        found[key] = se2.from_se3(vehicle.trajectory.poses), vehicle.model.size
    return found


def test_poses_are_at_ten_hertz_and_all_cover_the_same_time(drive: World) -> None:
    times = START_US + 100_000 * np.arange(81)
    np.testing.assert_array_equal(drive.ego.timestamps_us, times)
    for vehicle in drive.vehicles.values():
        np.testing.assert_array_equal(vehicle.trajectory.timestamps_us, times)


def test_no_two_boxes_ever_overlap(drive: World) -> None:
    for (a, (pose_a, size_a)), (b, (pose_b, size_b)) in itertools.combinations(
        outlines(drive).items(), 2
    ):
        assert not touching(pose_a, size_a, pose_b, size_b).any(), (a, b)


def test_every_vehicle_stands_on_the_ground_and_follows_a_lane(drive: World) -> None:
    lanes = shapely.union_all(
        [shapely.LineString(lane.centreline[:, :2]) for lane in drive.street.map.lanes.values()]
    )
    for vehicle in drive.vehicles.values():
        poses = vehicle.trajectory.poses
        np.testing.assert_allclose(poses[:, 2, 3], vehicle.model.size[2] / 2)
        if vehicle.parked:
            assert np.all(poses == poses[0])
            continue
        planar = se2.from_se3(poses)
        # With both axles on the line, the middle cuts the bend: bends are of 10 m or more.
        allowed = 0.15 + wheelbase(float(vehicle.model.size[0])) ** 2 / (8 * 10.0)
        assert shapely.distance(shapely.points(planar[:, :2]), lanes).max() < allowed
        moved = np.diff(planar[:, :2], axis=0)
        turn = se2.wrap_angle(np.arctan2(moved[:, 1], moved[:, 0]) - planar[:-1, 2])
        assert np.abs(turn).max() < 0.15


def test_the_ego_drives_smoothly_inside_the_drivable_area(drive: World) -> None:
    area = shapely.unary_union([shapely.Polygon(p) for p in drive.street.map.drivable_area])
    poses = se2.from_se3(drive.ego.poses)
    corners = boxes.bev_corners(outlines(drive)["ego"][0], traffic.EGO_LENGTH, traffic.EGO_WIDTH)
    assert shapely.contains(area, shapely.points(corners.reshape(-1, 2))).all()
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / 0.1
    yaw_rate = np.diff(np.unwrap(poses[:, 2])) / 0.1
    assert np.abs(speed * yaw_rate).max() <= LATERAL_LIMIT
    assert np.abs(np.diff(speed) / 0.1).max() < 2.0
    assert speed.min() > 3.0


def test_the_target_is_ahead_in_sight_and_seen_from_some_sides_only(drive: World) -> None:
    found = outlines(drive)
    rig = se2.from_se3(drive.ego.poses)
    target, size = found["target"]
    seen = se2.relative(rig, target)
    assert seen[:, 0].min() > 5.0
    assert seen[:, 0].max() < 30.0
    bearing = np.abs(np.arctan2(seen[:, 1], seen[:, 0]))
    assert np.mean(bearing < np.deg2rad(25)) > 0.7, "in the front camera"
    from_target = se2.relative(target, rig)
    assert np.all(from_target[:, 0] < 0), "its front is never seen"
    for key, (poses, other) in found.items():
        if key not in ("ego", "target"):
            assert not hiding(found["ego"][0][:, :2], target, size, poses, other).any(), key


def test_the_target_overtakes_is_passed_or_leads() -> None:
    ends = {}
    for kind in KINDS:
        world = small_world(0, 8.0, kind)
        target = se2.from_se3(world.vehicles["target"].trajectory.poses)
        ends[kind] = se2.relative(se2.from_se3(world.ego.poses), target)[[0, -1], :2]
    (x0, y0), (x1, y1) = ends["urban-straight"]
    assert x1 > x0 + 15
    assert abs(y0) == abs(y1) == pytest.approx(3.5, abs=0.1)
    assert ends["arterial-median"][0, 0] > ends["arterial-median"][1, 0] + 15
    np.testing.assert_allclose(ends["suburban-curve"][:, 1], 0.0, atol=0.05)


def test_others_drive_and_park(drive: World) -> None:
    assert 2 <= sum(key.startswith("moving") for key in drive.vehicles) <= 5
    assert any(v.parked for v in drive.vehicles.values()) == bool(drive.street.parking)


def test_a_world_is_its_name_seed_and_duration() -> None:
    first, again, other = small_world(3), small_world(3), small_world(4)
    assert list(first.vehicles) == list(again.vehicles)
    for key, vehicle in first.vehicles.items():
        np.testing.assert_array_equal(
            vehicle.trajectory.poses, again.vehicles[key].trajectory.poses
        )
        np.testing.assert_array_equal(vehicle.model.size, again.vehicles[key].model.size)
    assert not np.array_equal(
        first.vehicles["target"].model.size, other.vehicles["target"].model.size
    )


def test_a_longer_drive_over_a_road_that_ends_is_refused() -> None:
    with pytest.raises(InputError, match="m are needed"):
        populate.populate(small_street(length=0.0), "urban-straight", 0, 20.0)


@pytest.mark.parametrize(
    ("name", "seed", "seconds", "message"),
    [
        ("moon", 0, 8.0, "choose one of urban-straight"),
        ("urban-straight", -1, 8.0, "negative"),
        ("urban-straight", 0, 0.0, "seconds"),
        ("urban-straight", 0, -2.0, "seconds"),
        ("urban-straight", 0, 20.5, "seconds"),
        ("urban-straight", 0, float("nan"), "seconds"),
    ],
)
def test_what_cannot_be_made_is_refused(name: str, seed: int, seconds: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_world(name, seed, seconds)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"dataset": "kitti"}, "only synthetic"),
        ({"world_version": str(WORLD_VERSION + 1)}, "make the log again"),
        ({"seed": "x"}, "does not name a world"),
        ({"scene": "moon"}, "is not known"),
        ({"light": "candle"}, "does not name a world"),
        ({"conditions": "fog"}, "does not name a world"),
    ],
)
def test_only_synthetic_logs_of_this_version_have_a_world(
    small: World, small_log: DrivingLog, changed: dict[str, str], message: str
) -> None:
    metadata = {**world_metadata(small), **changed}
    with pytest.raises(InputError, match=message):
        world_of(replace(small_log, metadata=metadata))


def test_conditions_change_the_light_alone(small: World, small_log: DrivingLog) -> None:
    fair, dusk = (
        world_of(replace(small_log, metadata=world_metadata(replace(small, conditions=name))))
        for name in ("fair", "dusk")
    )
    assert "conditions" not in world_metadata(fair) and dusk.conditions == "dusk"
    assert np.array_equal(fair.street.surface.vertices, dusk.street.surface.vertices)
    assert np.array_equal(fair.ego.poses, dusk.ego.poses) and list(fair.vehicles) == list(
        dusk.vehicles
    )
    skies = {name: in_conditions(fair.street.sky, name, 0.3) for name in get_args(Conditions)}
    assert np.array_equal(dusk.street.sky.zenith, skies["dusk"].zenith)
    changed = {
        name for name, sky in skies.items() if not np.array_equal(sky.sun, skies["fair"].sun)
    }
    assert changed == {"overcast", "low-sun", "dusk"}
    assert np.rad2deg(np.arcsin(skies["low-sun"].sun_direction[2])) == pytest.approx(8.0)


@pytest.mark.parametrize("conditions", get_args(Conditions))
def test_exposure_is_that_of_the_conditions(small: World, conditions: Conditions) -> None:
    world, start = replace(small, conditions=conditions), int(small.ego.timestamps_us[0])
    factors = [world.exposure("front", start + quarter * 1_250_000) for quarter in range(4)]
    factors = np.array([*factors, world.exposure("front")]) / small.exposure("front")
    if conditions == "varying-exposure":  # half a stop up and down in 5 s, right on average
        assert np.allclose(factors, [1, 2**0.5, 1, 2**-0.5, 1])
    else:
        expected = {"dusk": 0.5, "underexposed": 0.45, "overexposed": 1.9}.get(conditions, 1.0)
        assert np.allclose(factors, expected)


def test_the_light_of_a_log_is_that_of_its_oracle(small: World, small_log: DrivingLog) -> None:
    metadata = world_metadata(replace(small, light="mitsuba"))
    made = world_of(replace(small_log, metadata={**small_log.metadata, **metadata}))
    assert made.light == "mitsuba"
    assert made.name == small.name
