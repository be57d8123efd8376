"""Overlap of boxes and NC."""

import numpy as np
import pytest
from hypothesis import strategies as st

from recast.dynamics import state as columns
from recast.metrics.driving import (
    no_collision,
    no_collision_at_fault,
    no_phantom_braking,
)

poses = st.tuples(st.floats(-8, 8), st.floats(-8, 8), st.floats(-4, 4))
sizes = st.tuples(st.floats(0.3, 12), st.floats(0.3, 3))
moves = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-4, 4))


def approach(final_gap):
    """The ego drives up to a standing actor and stops `final_gap` metres short of it."""
    ego = np.zeros((21, 3))
    ego[:, 0] = np.minimum(np.arange(21.0), 15.0)
    actor = np.tile([15.0 + final_gap + 5.0, 0.0, np.pi, 0.0], (21, 1))
    return no_collision(ego, [5.0, 2.0], actor, [5.0, 2.0], 0.1)


def test_touching_bumpers_are_no_collision():
    assert approach(0.0).nc.value == 1.0
    assert approach(0.01).first_step is None


def test_first_step_and_reason():
    result = approach(-0.5)
    assert result.nc.value == 0.0
    assert result.first_step == 15
    assert "step 15 (1.5 s)" in result.nc.reason
    np.testing.assert_allclose(result.overlap[15:], 0.5 * 2.0)


def test_a_rear_end_hit_counts_like_any_other():
    ego = np.zeros((11, 3))
    actor = np.stack([np.linspace(-10, -4, 11), *np.zeros((3, 11))], axis=-1)
    assert no_collision(ego, [5.0, 2.0], actor, [5.0, 2.0], 0.1).nc.value == 0.0


def blame(ego_speed, actor_from, actor_to, heading=0.0, actor_speed=5.0):
    """NC at fault of an ego that drives along x from 0, and an actor on a straight line."""
    states = np.zeros((21, 11))
    states[:, columns.X] = ego_speed * 0.1 * np.arange(21)
    states[:, columns.VX] = ego_speed
    actor = np.zeros((21, 4))
    actor[:, :2] = np.linspace(actor_from, actor_to, 21)
    actor[:, 2:] = heading, actor_speed
    centres = states[:, :3] + [1.4, 0.0, 0.0]
    contact = no_collision(centres, [5.0, 2.0], actor, [5.0, 2.0], 0.1)
    assert contact.first_step is not None
    return no_collision_at_fault([contact], states, [actor])


def test_who_moves_into_another_is_at_fault():
    leading = blame(10.0, (12.0, 0.0), (22.0, 0.0))
    assert leading.value == 0.0 and leading.reason.startswith("overlaps")
    assert blame(5.0, (15.0, 0.0), (5.0, 0.0), heading=np.pi).value == 0.0  # oncoming
    assert blame(8.0, (8.0, 4.0), (16.0, 0.5)).value == 0.0  # from the side
    assert blame(8.0, (8.0, 0.0), (8.0, 0.0), actor_speed=0.0).value == 0.0  # standing


def test_who_stands_or_is_hit_from_behind_is_not_at_fault():
    stands = blame(0.0, (15.0, 0.0), (2.0, 0.0), heading=np.pi)
    assert stands.value == 1.0 and stands.reason == "not at fault: the ego stands"
    behind = blame(3.0, (-8.0, 0.0), (8.0, 0.0), actor_speed=8.0)
    assert behind.value == 1.0 and behind.reason == "not at fault: it is hit from behind"
    assert blame(3.0, (-3.2, 0.0), (-3.2, 0.0), actor_speed=0.0).value == 0.0  # backed into nothing


def test_one_contact_at_fault_among_several_decides():
    states, far = np.zeros((3, 11)), np.tile([30.0, 0.0, 0.0, 0.0], (3, 1))
    states[:, columns.VX] = 5.0
    ahead, behind = np.tile([4.5, 0.0, 0.0, 1.0], (3, 1)), np.tile([-2.5, 0.0, 0.0, 9.0], (3, 1))
    actors = [far, behind, ahead]
    hits = [no_collision(states[:, :3], [5.0, 2.0], one, [5.0, 2.0], 0.1) for one in actors]
    assert no_collision_at_fault(hits, states, actors).value == 0.0
    assert no_collision_at_fault(hits[:2], states, actors[:2]).value == 1.0
    assert no_collision_at_fault(hits[:1], states, actors[:1]).reason is None


def braking_for(actor, deceleration=5.0, speed=15.0):
    """No phantom braking of an ego that brakes along x, and an actor (x, y, heading, speed)."""
    times = 0.1 * np.arange(41)
    states = np.zeros((41, 11))
    states[:, columns.VX] = np.maximum(speed - deceleration * times, 0.0)
    states[1:, columns.X] = np.cumsum(states[:-1, columns.VX]) * 0.1
    x, y, heading, moves = actor
    path = np.tile([x, y, heading, moves], (41, 1))
    path[:, 0] += moves * np.cos(heading) * times
    path[:, 1] += moves * np.sin(heading) * times
    route = np.stack([np.linspace(-5.0, 200.0, 400), np.zeros(400)], axis=-1)
    size = [4.6, 1.9]
    return no_phantom_braking(states, [5.2, 2.3], 1.4, [(path, size)], route, 0.1)


@pytest.mark.parametrize(
    ("actor", "causes"),
    [
        ((40.0, 0.0, 0.0, 0.0), True),  # standing ahead
        ((25.0, 0.0, 0.0, 3.0), True),  # slower, ahead
        ((90.0, 0.0, np.pi, 12.0), True),  # oncoming in the ego's lane
        ((22.0, 3.5, -0.25, 4.0), True),  # cutting in
        ((30.0, -8.0, np.pi / 2, 5.0), True),  # crossing
        ((30.0, 3.5, 0.0, 15.0), False),  # in the next lane
        ((60.0, 3.5, np.pi, 12.0), False),  # oncoming in the next lane
        ((120.0, 0.0, 0.0, 0.0), False),  # far ahead
        ((-15.0, 0.0, 0.0, 15.0), False),  # behind
    ],
)
def test_hard_braking_has_a_cause_or_is_a_phantoms(actor, causes):
    metric = braking_for(actor)
    assert metric.value == float(causes)
    told = "brakes with up to 5.0 m/s2 from step 0 (0.0 s), and nothing is ahead"
    assert causes or metric.reason == told
    assert braking_for(actor, deceleration=2.5).value == 1.0


def test_what_cannot_be_told_of_braking():
    states, route = np.zeros((41, 11)), np.zeros((1, 2))
    assert not no_phantom_braking(states, [5.2, 2.3], 1.4, [], route, 0.1).valid
    assert not no_phantom_braking(states[:4], [5.2, 2.3], 1.4, [], route, 0.1).valid
    line = np.stack([np.linspace(0, 99, 100), np.zeros(100)], axis=-1)
    assert no_phantom_braking(states, [5.2, 2.3], 1.4, [], line, 0.1).value == 1.0
