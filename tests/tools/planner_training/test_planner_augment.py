import numpy as np

from recast.planning import DrivingCommand
from recast.planning.types import ego_status
from recast_tools.planner_training.samples import (
    CLUES,
    COLUMNS,
    augment,
    mirror_clues,
    mirror_columns,
    mirror_image,
    mirror_status,
)
from recast_tools.planner_training.targets import COLUMN_VALUES


def picture() -> np.ndarray:
    image = np.zeros((128, 512, 3), np.uint8)
    image[:64] = 150, 180, 220
    image[64:] = 90, 90, 95
    image[55:85, 240:275] = 180, 30, 30
    return image


def test_it_is_the_generator_s_alone_and_keeps_the_vehicle() -> None:
    seen = []
    for seed in range(40):
        once, again = (augment(picture(), np.random.default_rng(seed)) for _ in range(2))
        np.testing.assert_array_equal(once, again)
        assert once.shape == (128, 512, 3)
        assert once.dtype == np.uint8
        body, road = once[60:80, 248:268].astype(float), once[100:110, 248:268].astype(float)
        redness = [part[..., 0].mean() - part[..., 1:].mean() for part in (body, road)]
        seen.append(redness[0] - redness[1])
    assert min(seen) > 20
    assert np.std(seen) > 5


def test_mirrored_twice_is_as_before() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (128, 512, 3)).astype(np.uint8)
    status, clues = rng.normal(size=8).astype(np.float32), rng.normal(size=len(CLUES))
    np.testing.assert_array_equal(mirror_image(mirror_image(image)), image)
    np.testing.assert_array_equal(mirror_status(mirror_status(status)), status)
    np.testing.assert_allclose(mirror_clues(mirror_clues(clues)), clues, atol=1e-6)
    columns = rng.normal(size=(COLUMNS, len(COLUMN_VALUES))).astype(np.float32)
    np.testing.assert_array_equal(mirror_columns(mirror_columns(columns)), columns)


def test_a_left_turn_becomes_a_right_turn() -> None:
    state = np.zeros(11)
    state[3], state[9] = 5.0, 0.2
    mirrored = state.copy()
    mirrored[9] = -0.2
    np.testing.assert_array_equal(
        mirror_status(ego_status(DrivingCommand.LEFT, state)),
        ego_status(DrivingCommand.RIGHT, mirrored),
    )
    clues = np.arange(1.0, 11.0, dtype=np.float32)
    np.testing.assert_array_equal(mirror_clues(clues), [1, 2, -3, 4, -5, -6, -7, -8, -9, -10])
