from __future__ import annotations

import numpy as np
import pytest

from recast.actors.generate import CONVENTIONS, UNIT_CUBE_Y_UP, AxisConvention


@pytest.mark.parametrize("name", CONVENTIONS)
def test_conventions_are_proper_rotations(name: str) -> None:
    rotation = CONVENTIONS[name].rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_y_up_turns_up_and_forward_where_they_belong() -> None:
    rotation = UNIT_CUBE_Y_UP.rotation()
    np.testing.assert_allclose(rotation @ [0, 1, 0], [0, 0, 1])
    np.testing.assert_allclose(rotation @ [0, 0, 1], [1, 0, 0])


def test_impossible_axes_are_refused() -> None:
    with pytest.raises(ValueError, match="parallel"):
        AxisConvention("wrong", "+z", "-z", declares_front=True).rotation()
    with pytest.raises(ValueError, match="sign and a letter"):
        AxisConvention("wrong", "north", "+z", declares_front=True).rotation()
