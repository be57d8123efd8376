"""DAC."""

import numpy as np
import pytest

from recast.logs.hdmap import HdMap, Lane, drivable_region
from recast.metrics.driving import drivable_area_compliance

SIZE = [5.0, 2.0]


def square(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)


def drive(lateral):
    poses = np.zeros((11, 3))
    poses[:, 0] = np.linspace(5, 25, 11)
    poses[:, 1] = np.linspace(0, lateral, 11)
    return poses


@pytest.mark.parametrize(("lateral", "wanted"), [(0.0, 1.0), (1.0, 1.0), (1.29, 1.0), (1.31, 0.0)])
def test_corners_may_leave_by_thirty_centimetres(lateral, wanted):
    region = drivable_region(HdMap({}, (square(0, -2, 40, 2),)))
    assert drivable_area_compliance(drive(lateral), SIZE, region, 0.1).dac.value == wanted


def test_reason_names_corner_step_and_distance():
    region = drivable_region(HdMap({}, (square(0, -2, 40, 2),)))
    result = drivable_area_compliance(drive(-4.0), SIZE, region, 0.1)
    assert result.first_step == 4  # 1.6 m right: 0.6 m outside
    assert "right corner 0.60 m outside at step 4 (0.4 s); 3.00 m at the worst" in result.dac.reason


def test_overlapping_outlines_are_a_union():
    """A seam or an overlap between two areas is no edge."""
    region = drivable_region(HdMap({}, (square(0, -2, 15, 2), square(10, -2, 40, 2))))
    assert drivable_area_compliance(drive(0.5), SIZE, region, 0.1).dac.value == 1.0


def test_lanes_count_as_drivable():
    line = np.array([[0.0, 0, 0], [40, 0, 0]])
    lane = Lane(
        "a", line, line + np.array([0, 2, 0]), line - np.array([0, 2, 0]), square(0, -2, 40, 2)
    )
    region = drivable_region(HdMap({"a": lane}, ()))
    assert drivable_area_compliance(drive(0.0), SIZE, region, 0.1).dac.value == 1.0
    assert drivable_area_compliance(drive(3.0), SIZE, region, 0.1).dac.value == 0.0


@pytest.mark.parametrize("hd_map", [None, HdMap({}, ())])
def test_without_a_map_there_is_no_value(hd_map):
    dac = drivable_area_compliance(drive(0.0), SIZE, drivable_region(hd_map), 0.1).dac
    assert not dac.valid and "no drivable area" in dac.reason


def test_self_crossing_outlines_are_mended():
    bow_tie = np.array([[0.0, -2], [40, 2], [40, -2], [0, 2]])
    region = drivable_region(HdMap({}, (bow_tie, square(0, -2, 40, 2))))
    assert drivable_area_compliance(drive(0.0), SIZE, region, 0.1).dac.value == 1.0
