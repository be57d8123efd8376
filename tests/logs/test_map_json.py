"""map.json keeps every digit, its bytes are fixed, and broken files say what is wrong."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import GroundHeight, HdMap, Lane
from recast.logs.hdmap import read_map, write_map

GOLDEN = Path(__file__).parents[1] / "golden" / "map.json"


def two_lanes() -> HdMap:
    x = np.array([0.0, 10.0, 20.5])

    def line(y: float) -> np.ndarray:
        return np.column_stack([x, np.full(3, y), 0.1 * x])

    def lane(name: str, y: float, **links: object) -> Lane:
        left, right = line(y + 1.75), line(y - 1.75)
        outline = np.concatenate([right, left[::-1]])[:, :2]
        return Lane(name, line(y), left, right, outline, **links)  # type: ignore[arg-type]

    return HdMap(
        lanes={
            "a": lane("a", 0.0, speed_limit=13.9, successors=("b",), left_neighbour="b"),
            "b": lane("b", 3.5, is_intersection=True, right_neighbour="a"),
        },
        drivable_area=(np.array([[0.0, -2.0], [20.5, -2.0], [20.5, 1 / 3]]),),
        ground=GroundHeight(
            np.array([-1.0, 2.0]), 0.5, np.array([[0.1, np.nan, 0.3], [1 / 3, 0.5, 0.6]])
        ),
        derived=True,
        notes={"lanes": "drawn by hand"},
    )


def test_the_bytes_are_fixed(tmp_path: Path) -> None:
    """A change of these bytes is a change of the format: raise its version then."""
    write_map(two_lanes(), tmp_path / "map.json")
    assert (tmp_path / "map.json").read_bytes() == GOLDEN.read_bytes()


def test_a_map_comes_back_as_it_was(tmp_path: Path) -> None:
    before = two_lanes()
    write_map(before, tmp_path / "map.json")
    after = read_map(tmp_path / "map.json")
    assert (after.derived, dict(after.notes)) == (True, {"lanes": "drawn by hand"})
    assert list(after.lanes) == ["a", "b"]
    for name, lane in before.lanes.items():
        other = after.lanes[name]
        for field in ("centreline", "left_boundary", "right_boundary", "polygon"):
            np.testing.assert_array_equal(getattr(other, field), getattr(lane, field))
        assert (other.speed_limit, other.successors) == (lane.speed_limit, lane.successors)
        assert (other.left_neighbour, other.right_neighbour, other.is_intersection) == (
            lane.left_neighbour,
            lane.right_neighbour,
            lane.is_intersection,
        )
    np.testing.assert_array_equal(after.drivable_area[0], before.drivable_area[0])
    assert after.ground is not None and before.ground is not None
    np.testing.assert_array_equal(after.ground.height, before.ground.height)
    np.testing.assert_array_equal(after.ground.origin, before.ground.origin)


def test_a_map_without_ground(tmp_path: Path) -> None:
    write_map(HdMap({}, ()), tmp_path / "map.json")
    after = read_map(tmp_path / "map.json")
    assert after.ground is None
    assert (after.lanes, after.drivable_area, after.derived) == ({}, (), False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "geojson"}, "format: is 'geojson', not 'recast-map'"),
        ({"version": 7}, "version: is 7, this recast reads 1"),
        ({"drivable_area": [[[0, 1], [2, "far"]]]}, "drivable_area.0.1.1: "),
        ({"drivable_area": [[[0, 1], [2, 3]]]}, "HdMap.drivable_area[0]: expected (N >= 3, 2)"),
        ({"lanes": [{"lane_id": "a"}]}, "lanes.0.speed_limit: Field required"),
        (
            {"ground": {"origin": [0, 0], "cell": 1, "height": [[1], [1, 2]]}},
            "ground.height: rows have",
        ),
        (
            {"ground": {"origin": [0, 0], "cell": 0, "height": [[1]]}},
            "cell: 0.0 is not within 0.001 to",
        ),
        ({"ground": {"origin": [0, 0], "cell": 1, "height": []}}, "GroundHeight.height: expected"),
        (
            {"ground": {"origin": [0, 1e9], "cell": 1, "height": [[1]]}},
            "GroundHeight.origin: 1e+09",
        ),
        (
            {"drivable_area": [[[0, 1], [2, 3], [1e300, 0]]]},
            "drivable_area[0]: 1e+300 is not within",
        ),
        ({"drivable_area": [[[0, 1], [2, 3], [10**400, 0]]]}, "drivable_area.0.2.0: "),
        ({"notes": {"a": "\ud800"}}, "notes['a']: "),
        ({"surprise": 1}, "surprise: Extra inputs"),
    ],
)
def test_broken_maps_say_what_is_wrong(tmp_path: Path, change: dict, message: str) -> None:
    data = json.loads(GOLDEN.read_text())
    (tmp_path / "map.json").write_text(json.dumps({**data, **change}))
    with pytest.raises(InputError) as error:
        read_map(tmp_path / "map.json")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_two_lanes_of_one_name_are_refused(tmp_path: Path) -> None:
    data = json.loads(GOLDEN.read_text())
    (tmp_path / "map.json").write_text(json.dumps({**data, "lanes": data["lanes"] * 2}))
    with pytest.raises(InputError, match="two lanes have the same lane_id"):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed_limit": float("nan")}, "speed_limit: nan"),
        ({"speed_limit": 0.0}, "speed_limit: 0"),
        ({"speed_limit": -3.0}, "speed_limit: -3"),
        ({"centreline": np.full((3, 3), np.nan)}, "centreline: nan is not within"),
        ({"left_boundary": np.zeros((1, 3))}, "left_boundary: expected (N >= 2, 3)"),
        ({"polygon": np.full((3, 2), -np.inf)}, "polygon: -inf is not within"),
        ({"successors": ("c",)}, "refers to lane 'c'"),
        ({"lane_id": "b"}, "lane_id: is 'b'"),
    ],
)
def test_maps_with_impossible_lanes_are_not_written(
    tmp_path: Path, change: dict, message: str
) -> None:
    whole = two_lanes()
    lanes = {**whole.lanes, "a": replace(whole.lanes["a"], **change)}
    with pytest.raises(ValueError) as error:
        write_map(replace(whole, lanes=lanes), tmp_path / "map.json")
    assert message in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cell": 0.0}, "cell: 0.0"),
        ({"cell": float("nan")}, "cell: nan"),
        ({"origin": np.zeros(3)}, "origin: expected (2,)"),
        ({"origin": np.array([0, np.inf])}, "origin: inf"),
        ({"height": np.zeros(4)}, "height: expected (rows, columns)"),
        ({"height": np.array([[np.inf]])}, "height: inf is not within"),
    ],
)
def test_impossible_ground_is_refused(change: dict, message: str) -> None:
    ground = two_lanes().ground
    assert ground is not None
    with pytest.raises(ValueError) as error:
        HdMap({}, (), replace(ground, **change)).validate()
    assert message in str(error.value)
