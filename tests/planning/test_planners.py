from __future__ import annotations

import numpy as np
import pytest
from recorded_paths import arc, context, observe

from recast.core.foreign import whole
from recast.geometry import se2
from recast.planning import (
    BasePlanner,
    ConstantVelocity,
    IdmLaneFollower,
    LogReplay,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
)


@pytest.mark.parametrize("planner", [ConstantVelocity(), LogReplay(), IdmLaneFollower()])
def test_all_are_planners_that_read_no_images(planner: Planner) -> None:
    assert isinstance(planner, Planner)
    assert not planner.needs_images
    planner.reset(context(arc()))
    plan = planner.plan(observe((0, 0, 0), 10.0))
    plan.validate()
    np.testing.assert_allclose(plan.waypoints[-1, :2], [40.0, 0.0], atol=0.5)


def test_constant_velocity_is_straight_ahead_in_the_ego_frame() -> None:
    planner = ConstantVelocity()
    planner.reset(context(arc()))
    plan = planner.plan(observe((3, 4, 1.0), 5.0))
    np.testing.assert_allclose(plan.waypoints[:, 0], 0.5 * np.arange(1, 41))
    np.testing.assert_array_equal(plan.waypoints[:, 1:], 0.0)


def test_log_replay_gives_the_logged_poses_from_anywhere() -> None:
    log = arc(curvature=0.01)
    planner = LogReplay()
    planner.reset(context(log))
    ego = (1.0, -2.0, 0.3)
    plan = planner.plan(observe(ego, 5.0, seconds=2.0))
    np.testing.assert_allclose(
        se2.compose(ego, plan.waypoints), se2.from_se3(log.poses[21:61]), atol=1e-9
    )
    assert plan.info["waypoints_beyond_log"] == 0


def test_log_replay_says_where_the_log_ends_and_goes_straight_on() -> None:
    log = arc(speed=8.0, seconds=3.0)
    planner = LogReplay()
    planner.reset(context(log))
    plan = planner.plan(observe((0, 0, 0), 8.0, seconds=1.0))
    assert plan.info["waypoints_beyond_log"] == 20
    np.testing.assert_allclose(np.diff(plan.waypoints[:, 0]), 0.8, atol=1e-6)


@pytest.mark.parametrize("planner", [LogReplay(), IdmLaneFollower()])
def test_planning_before_reset_is_named(planner: Planner) -> None:
    with pytest.raises(RuntimeError, match="call reset first"):
        planner.plan(observe((0, 0, 0), 1.0))


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [(np.zeros((8, 3)), r"expected \(40, 3\)"), (np.full((40, 3), np.nan), "waypoint 0")],
)
def test_plans_are_checked(waypoints: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Plan(waypoints).validate()


class Bare:
    """What a planner must have, and one optional member."""

    name, needs_images, camera_names = "bare", True, ("front",)

    def reset(self, context: PlanningContext) -> None: ...

    def plan(self, observation: PlannerInput) -> Plan:
        return Plan(np.zeros((40, 3)))


class Derived(BasePlanner):
    name, needs_images = "derived", True

    def plan(self, observation: PlannerInput) -> Plan:
        return Plan(np.zeros((40, 3)))


def test_optional_members_have_defaults() -> None:
    for planner, cameras in ((Bare(), ("front",)), (Derived(), None)):
        assert isinstance(planner, Planner)
        made = whole(planner, BasePlanner)
        assert (made is planner) is isinstance(planner, BasePlanner)
        assert made.camera_names == made.choose_cameras({}) == cameras
        assert made.wanted_views == () and made.device is None and made.record_fields == {}
        assert not made.replays_log and not made.shared
        made.finish_rollout()
        assert np.all(made.plan(None).waypoints == 0)  # type: ignore[arg-type]


def test_members_of_another_class_are_used() -> None:
    class Own(Bare):
        record_fields, shared, done = {"weights": "v2"}, True, False

        def choose_cameras(self, mounts: object) -> dict[str, str]:
            return {"mine": "left"}

        def finish_rollout(self) -> None:
            self.done = True

    planner = Own()
    made = whole(planner, BasePlanner)
    assert made.record_fields == {"weights": "v2"} and made.shared
    assert made.choose_cameras({}) == {"mine": "left"}
    made.finish_rollout()
    assert planner.done


def test_a_slip_in_an_optional_name_is_warned_about() -> None:
    class Slipped(Bare):
        wanted_veiws = ()

    with pytest.warns(UserWarning, match=r"Slipped has wanted_veiws.* is it wanted_views\?"):
        whole(Slipped(), BasePlanner)
    with pytest.warns(UserWarning, match=r"has finish_rolout.* is it finish_rollout\?"):

        class Also(BasePlanner):
            name = "also"

            def finish_rolout(self) -> None: ...
