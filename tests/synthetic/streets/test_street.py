"""What stands along the streets, and that seeds decide all of it."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from recast.core.errors import InputError
from recast.synthetic.streets import SCENES, make_street
from recast.synthetic.surface import MATERIAL_INDEX
from recast.synthetic.world import Street
from synthetic.streets.built import LENGTH, built

CLEAR_HEIGHT = 4.3
VAN = 2.05


def driven_lanes(street: Street) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(k.polygon) for k in street.map.lanes.values()])


def triangles_over(street: Street, region: shapely.Geometry) -> np.ndarray:
    """(T, 3, 3) triangles that stick out of the ground and reach over a region."""
    corners = street.surface.vertices[street.surface.faces]
    corners = corners[corners[:, :, 2].max(axis=1) > 0.03]
    low, high = corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)
    x0, y0, x1, y1 = region.bounds
    near = (high[:, 0] > x0) & (low[:, 0] < x1) & (high[:, 1] > y0) & (low[:, 1] < y1)
    corners = corners[near]
    shapely.prepare(region)
    outlines = shapely.linestrings(corners[:, [0, 1, 2, 0], :2])
    return np.asarray(corners[shapely.intersects(region, outlines)])


@pytest.mark.parametrize("name", SCENES)
class TestEveryKind:
    def test_surface_is_sound_and_within_budget(self, name: str) -> None:
        street = built(name)
        street.surface.validate()
        assert 40_000 < len(street.surface) <= 350_000
        assert street.kind == name
        colours = street.surface.colours
        assert colours.min() >= 0.0 and colours.max() <= 1.0

    def test_nothing_hangs_into_the_lanes(self, name: str) -> None:
        street = built(name)
        over = triangles_over(street, driven_lanes(street).buffer(-0.01))
        assert over[:, :, 2].min(axis=1).min(initial=np.inf) >= CLEAR_HEIGHT

    def test_parking_spots_are_off_the_lanes_and_free(self, name: str) -> None:
        street = built(name)
        lanes = driven_lanes(street)
        area = shapely.union_all([shapely.Polygon(o) for o in street.map.drivable_area])
        for spot in street.parking:
            half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [spot.length / 2, VAN / 2]
            c, s = np.cos(spot.heading), np.sin(spot.heading)
            body = shapely.Polygon(half @ np.array([[c, s], [-s, c]]) + [spot.x, spot.y])
            assert lanes.intersection(body).area == 0.0
            assert body.difference(area).area < 1e-3

    def test_light(self, name: str) -> None:
        sky = built(name).sky
        assert np.linalg.norm(sky.sun_direction) == pytest.approx(1.0)
        assert np.deg2rad(15) < np.arcsin(sky.sun_direction[2]) < np.deg2rad(65)
        assert np.all(sky.sun > 0) and np.all(sky.zenith > 0) and np.all(sky.horizon > 0)

    def test_ground_is_everywhere(self, name: str) -> None:
        """Straight down from above, a ray meets a level triangle, out to 200 m from the road."""
        street = built(name)
        corners = street.surface.vertices[street.surface.faces]
        rng = np.random.default_rng(1)
        origin = street.map.ground.origin
        low, high = origin - 150.0, origin + np.array([560.0, 300.0])
        xy = corners[:, :, :2]
        least, most = xy.min(axis=1), xy.max(axis=1)
        for place in rng.uniform(low, high, (25, 2)):
            near = np.all((least <= place) & (most >= place), axis=1)
            inside = shapely.intersects(shapely.polygons(xy[near]), shapely.Point(place))
            assert np.any(inside & (np.abs(corners[near][:, :, 2]).min(axis=1) < 60.0)), place


def test_the_underpass_has_a_deck_over_the_road() -> None:
    street = built("underpass")
    over = triangles_over(street, driven_lanes(street).buffer(-0.01))
    deck = over[np.ptp(over[:, :, 2], axis=1) < 0.05]
    assert len(deck) and deck[:, :, 2].min() >= CLEAR_HEIGHT


def test_road_materials_and_markings() -> None:
    street = built("urban-straight")
    used = set(street.surface.materials.tolist())
    assert {MATERIAL_INDEX[k] for k in ("asphalt", "concrete", "marking")} <= used
    corners = street.surface.vertices[street.surface.faces]
    paint = corners[street.surface.materials == MATERIAL_INDEX["marking"]]
    area = shapely.union_all([shapely.Polygon(o) for o in street.map.drivable_area]).buffer(0.05)
    np.testing.assert_allclose(paint[:, :, 2], 0.004)
    assert shapely.covers(area, shapely.points(paint.mean(axis=1)[:, :2])).all()
    up = np.cross(paint[:, 1] - paint[:, 0], paint[:, 2] - paint[:, 0])[:, 2]
    assert np.all(up > 0)


def test_many_spots_on_the_parked_street() -> None:
    assert len(built("parked-street").parking) > 40


def test_same_seed_same_bytes() -> None:
    one = built("rural-two-lane")
    rng = np.random.default_rng([SCENES.index("rural-two-lane"), 0])
    two = make_street("rural-two-lane", rng, LENGTH)
    for field in ("vertices", "faces", "normals", "colours", "materials"):
        mine, other = getattr(one.surface, field), getattr(two.surface, field)
        assert mine.tobytes() == other.tobytes()
    assert one.parking == two.parking and one.ego_route == two.ego_route
    for key, lane in one.map.lanes.items():
        assert lane.polygon.tobytes() == two.map.lanes[key].polygon.tobytes()


def test_another_seed_is_another_street() -> None:
    one, two = built("rural-two-lane"), built("rural-two-lane", seed=1)
    assert len(one.surface) != len(two.surface)
    assert not np.allclose(one.sky.sun_direction, two.sky.sun_direction)
    ends = [s.map.lanes[s.ego_route[-1]].centreline[-1] for s in (one, two)]
    assert np.linalg.norm(ends[0] - ends[1]) > 0.1


def test_unknown_name_lists_the_known() -> None:
    with pytest.raises(InputError, match=r"urban-straight.*underpass"):
        make_street("motorway", np.random.default_rng(0), LENGTH)


@pytest.mark.parametrize("length", [0.0, -5.0, 1e4, float("nan")])
def test_impossible_length(length: float) -> None:
    with pytest.raises(InputError, match="length"):
        make_street("urban-straight", np.random.default_rng(0), length)
