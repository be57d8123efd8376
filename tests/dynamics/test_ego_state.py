from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from recast.dynamics import EgoState, make_state
from recast.dynamics import state as ego

VALUES = np.arange(1.0, 12.0)


def test_every_column_has_a_name() -> None:
    state = EgoState(VALUES)
    for column, name in enumerate(ego.COLUMNS):
        assert getattr(state, name) == state[column] == VALUES[column]
    np.testing.assert_array_equal(state.pose, VALUES[ego.POSE])
    assert EgoState(make_state([0, 0, 0], 5.0)).speed == 5.0


def test_it_is_the_array_that_planners_know() -> None:
    state = EgoState(VALUES)
    assert isinstance(state, np.ndarray)
    assert np.asarray(state).tobytes() == VALUES.tobytes()
    assert type(np.asarray(state)) is np.ndarray
    assert state.shape == (11,) and state.tolist() == VALUES.tolist() and len(state) == 11
    for plain in (state[ego.POSE], state[None], state * 2, np.stack([state, state])):
        assert type(plain) is np.ndarray
    assert isinstance(state[ego.VX], float)
    assert state[ego.VX] + 1.0 == VALUES[ego.VX] + 1.0


def test_it_holds_a_copy() -> None:
    values = VALUES.copy()
    state = EgoState(values)
    state[ego.X] = -1.0
    assert values[ego.X] == VALUES[ego.X]
    values[ego.Y] = 99.0
    assert state.y == VALUES[ego.Y]


def test_it_travels() -> None:
    for back in (pickle.loads(pickle.dumps(EgoState(VALUES))), copy.deepcopy(EgoState(VALUES))):
        assert isinstance(back, EgoState) and back.tolist() == VALUES.tolist()


@pytest.mark.parametrize("shape", [(10,), (1, 11), ()])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"EgoState: expected \(11,\)"):
        EgoState(np.zeros(shape))
