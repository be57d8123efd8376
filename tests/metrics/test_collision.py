"""Overlap of boxes and NC."""

import numpy as np
from hypothesis import strategies as st

from recast.metrics.driving import no_collision

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
