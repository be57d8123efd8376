from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.actors import Observation, SegmentationTarget
from recast.actors.grounded_segmenter import (
    BoxPrompt,
    Detection,
    DetectionRule,
    choose_box,
    logged_rectangle,
    rectangle_overlap,
    text_prompt,
)
from recast.geometry import se3

LOGGED = np.array([20.0, 10.0, 120.0, 60.0])
RULE = DetectionRule()


def shifted(pixels: float, score: float, label: str = "a car") -> Detection:
    """A detection as large as the logged rectangle, so far to its right."""
    return Detection(LOGGED + np.array([pixels, 0, pixels, 0]), score, label)


def chosen(*detections: Detection, rule: DetectionRule = RULE) -> BoxPrompt:
    return choose_box(detections, LOGGED, rule, "a car.")


def test_the_overlap_counts_more_than_the_score() -> None:
    neighbour, own = shifted(40, 0.95), shifted(10, 0.3)
    prompt = chosen(neighbour, own)
    assert prompt.detected
    assert np.array_equal(prompt.box, own.box)
    assert "0.30" in prompt.reason


@pytest.mark.parametrize("order", [1, -1])
def test_the_score_decides_between_equal_overlaps(order: int) -> None:
    doubtful, sure = shifted(2, 0.3), shifted(4, 0.9)  # overlaps 0.96 and 0.92
    assert np.array_equal(chosen(*[doubtful, sure][::order]).box, sure.box)
    strict = dataclasses.replace(RULE, tie=0.0)
    assert np.array_equal(chosen(*[doubtful, sure][::order], rule=strict).box, doubtful.box)


def test_the_logged_box_stands_in_where_nothing_is_detected() -> None:
    for prompt in (chosen(), chosen(shifted(0, 0.2))):
        assert not prompt.detected
        assert np.array_equal(prompt.box, LOGGED)
        assert "no object was detected as 'a car.'" in prompt.reason


def test_the_logged_box_stands_in_where_nothing_overlaps() -> None:
    prompt = chosen(shifted(60, 0.9), shifted(-70, 0.9))
    assert not prompt.detected
    assert np.array_equal(prompt.box, LOGGED)
    assert "none of the 2 objects detected" in prompt.reason
    assert "best: 0.25" in prompt.reason


def test_a_detection_of_the_whole_picture_is_not_the_vehicle() -> None:
    everything = Detection(np.array([0.0, 0.0, 200.0, 150.0]), 0.9, "a car")
    assert not chosen(everything).detected


coordinates = st.floats(0, 100, allow_nan=False)
rectangles = st.tuples(coordinates, coordinates, coordinates, coordinates).map(
    lambda v: np.array([min(v[0], v[2]), min(v[1], v[3]), max(v[0], v[2]), max(v[1], v[3])])
)


@given(rectangles, rectangles)
def test_overlap_is_symmetric_and_a_share(first: np.ndarray, second: np.ndarray) -> None:
    value = rectangle_overlap(first, second)
    assert 0 <= value <= 1 + 1e-12
    assert value == pytest.approx(rectangle_overlap(second, first))


def test_overlap_by_hand() -> None:
    assert rectangle_overlap(LOGGED, LOGGED) == 1.0
    assert rectangle_overlap(LOGGED, LOGGED + np.array([50, 0, 50, 0])) == pytest.approx(1 / 3)
    assert rectangle_overlap(LOGGED, LOGGED + 200) == 0.0


def test_prompts() -> None:
    assert text_prompt("car") == "a car."
    assert text_prompt("truck") == "a truck."
    assert text_prompt("Construction_Vehicle") == "a construction vehicle."
    assert text_prompt("") == "a vehicle."


def test_the_logged_rectangle_lies_around_the_mask(observation: Observation) -> None:
    target = SegmentationTarget(
        observation.rgba[..., :3],
        observation.camera,
        observation.camera_from_object,
        observation.size,
        observation.points.astype(np.float64),
        np.zeros((0, 3)),
    )
    rows, columns = np.nonzero(observation.rgba[..., 3] > 127)
    mask = np.array([columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0])
    assert rectangle_overlap(logged_rectangle(target), mask) > 0.75
    gone = dataclasses.replace(
        target, camera_from_object=se3.from_rotation_translation(np.eye(3), [0.0, 0.0, -9.0])
    )
    with pytest.raises(ValueError, match="no part of the box"):
        logged_rectangle(gone)
