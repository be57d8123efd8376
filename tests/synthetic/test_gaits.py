from __future__ import annotations

import numpy as np
import pytest

from recast.synthetic import gaits
from recast.synthetic.gaits import GEAR, STANCE, WHEEL_RADIUS, Ride, Walk, between, middle_joint
from recast.synthetic.populate import sample_cyclist, sample_pedestrian
from recast.synthetic.world import VehicleModel

LOOK = gaits.PersonLook(1.75, 1.0, (0.5, 0.4, 0.3), (0.1,) * 3, (0.4, 0, 0), (0, 0, 0.3), (0, 0, 0))


@pytest.fixture(scope="module", params=["pedestrian", "cyclist"])
def models(request: pytest.FixtureRequest) -> list[VehicleModel]:
    make = {"pedestrian": sample_pedestrian, "cyclist": sample_cyclist}[request.param]
    return [make(np.random.default_rng(seed)) for seed in range(4)]


def test_the_box_holds_the_body_at_every_phase_and_is_tight(models: list[VehicleModel]) -> None:
    for model in models:
        assert model.articulation is not None
        model.surface.validate()
        ways = np.linspace(0.0, 7.3, 53)
        bounds = np.array([model.articulation.surface_at(way).bounds() for way in ways])
        half = model.size / 2
        assert np.all(np.abs(bounds) <= half + 1e-9)
        # Feet and wheels stand on the ground, and nothing else of the box is far from the body.
        assert np.all(bounds[:, 0, 2] <= -half[2] + 0.02)
        assert np.all(bounds[:, 0].min(axis=0) <= -half + 0.03)
        assert np.all(bounds[:, 1].max(axis=0) >= half - 0.03)


def test_shape_and_triangles_are_the_same_at_any_time(models: list[VehicleModel]) -> None:
    for model in models:
        assert model.articulation is not None
        first, later = model.surface, model.articulation.surface_at(0.4)
        np.testing.assert_array_equal(first.faces, later.faces)
        np.testing.assert_array_equal(first.colours, later.colours)
        again = model.articulation.surface_at(0.4)
        np.testing.assert_array_equal(later.vertices, again.vertices)
        assert np.abs(first.vertices - later.vertices).max() > 0.05


@pytest.mark.parametrize("height", [1.1, 1.75, 1.95])
def test_feet_on_the_ground_do_not_slip(height: float) -> None:
    walk = Walk(gaits.PersonLook(height, 1.0, *[(0.5, 0.5, 0.5)] * 5))
    ways = np.linspace(0.0, 2 * walk.cycle, 161)
    for foot, shift in ((2, 0.0), (5, 0.5)):
        phase = (ways / walk.cycle + shift) % 1.0
        ankles = np.array([walk.poses(way)[foot][:3, 3] for way in ways])
        world = ankles + np.stack([ways, 0 * ways, 0 * ways], axis=1)
        down = phase < STANCE
        landings = np.flatnonzero(np.diff(phase) < 0)
        for standing in np.split(np.arange(len(ways)), landings + 1):
            standing = standing[down[standing]]
            if len(standing) > 1:
                assert np.ptp(world[standing], axis=0).max() < 1e-9, "metres"
        assert ankles[~down, 2].max() > ankles[down, 2].max() + 0.05, "a swinging foot is lifted"
        # No jumps: over two steps a foot never moves more than five times as far as the body.
        assert np.abs(np.diff(world[:, 0])).max() < 5 * (ways[1] - ways[0])


def test_limbs_keep_their_lengths() -> None:
    walk, ride = Walk(LOOK), Ride(LOOK, (0.1, 0.1, 0.5))
    for motion, thighs in ((walk, (0, 3)), (ride, (4, 7))):
        for way in np.linspace(0, motion.cycle, 37):
            poses = motion.poses(way)
            for thigh in thighs:
                hip, knee, ankle = (poses[thigh + k][:3, 3] for k in range(3))
                upper, lower = 0.245 * 1.75, (0.245 if motion is walk else 0.25) * 1.75
                assert np.linalg.norm(knee - hip) == pytest.approx(upper, abs=1e-9)
                assert np.linalg.norm(ankle - knee) == pytest.approx(lower, abs=1e-9)
                assert knee[0] >= min(hip[0], ankle[0]) - 1e-9, "knees bend forward"


def test_wheels_roll_and_feet_stay_on_the_pedals() -> None:
    ride = Ride(LOOK, (0.1, 0.1, 0.5))
    for way in np.linspace(0.0, ride.cycle, 17):
        poses = ride.poses(way)
        rim = poses[1] @ [0.0, 0.0, WHEEL_RADIUS, 1.0]
        turn = way / WHEEL_RADIUS
        centre = poses[1][:3, 3]
        expected = centre + WHEEL_RADIUS * np.array([np.sin(turn), 0.0, np.cos(turn)])
        np.testing.assert_allclose(rim[:3], expected, atol=1e-12)
        for foot, side in ((6, 1.0), (9, -1.0)):
            pedal = poses[3] @ [0.0, 0.0, side * 0.165, 1.0]
            assert np.linalg.norm((poses[foot][:3, 3] - pedal[:3])[[0, 2]]) < 0.12
    assert ride.cycle == pytest.approx(2 * np.pi * WHEEL_RADIUS * GEAR)


def test_a_joint_lies_where_both_limbs_end() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        root, end, towards = rng.normal(size=(3, 3))
        reach = float(np.linalg.norm(end - root))
        upper = rng.uniform(0.3, 0.8) * reach
        lower = rng.uniform(reach - upper, reach + upper)
        joint = middle_joint(root, end, upper, lower, towards)
        assert np.linalg.norm(joint - root) == pytest.approx(upper, rel=1e-9)
        assert np.linalg.norm(end - joint) == pytest.approx(lower, rel=1e-9)
        pose = between(root, joint)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose((pose @ [0, 0, -upper, 1])[:3], joint, atol=1e-9)
