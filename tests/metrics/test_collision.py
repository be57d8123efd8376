"""Overlap of boxes and NC."""

import numpy as np
from hypothesis import strategies as st

from recast.dynamics import state as columns
from recast.metrics.driving import no_collision, no_collision_at_fault

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
