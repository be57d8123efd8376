"""Where things stand in their own frames, and how they face."""

import numpy as np
import pytest

from recast.synthetic import scenery
from recast.synthetic.surface import MATERIAL_INDEX, Surface


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def share_facing(surface: Surface, direction: tuple[float, float, float], material: str) -> float:
    """Share of a material's area whose outside looks along a direction."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    cross = np.cross(b - a, c - a)[surface.materials == MATERIAL_INDEX[material]]
    area = np.linalg.norm(cross, axis=1)
    return float(area[cross @ np.array(direction) > 0.9 * area].sum() / area.sum())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("style", scenery.BUILDING_STYLES)
def test_building_stands_behind_its_front_plane(style: str, seed: int) -> None:
    low, high = scenery.building(rng(seed), 20.0, 14.0, style).bounds()
    assert -1.6 <= low[1] <= 0.0
    assert low[0] >= -10.0 - 0.5 and high[0] <= 10.0 + 0.5
    assert 14.0 <= high[1] <= 14.0 + 0.6
    assert high[2] > 2.7


@pytest.mark.parametrize("style", scenery.BUILDING_STYLES)
def test_building_has_glass_to_the_street(style: str) -> None:
    surface = scenery.building(rng(1), 20.0, 14.0, style)
    assert share_facing(surface, (0, -1, 0), "window") > 0.2


@pytest.mark.parametrize("style", scenery.BUILDING_STYLES)
def test_storeys_make_a_building_taller(style: str) -> None:
    heights = [
        np.mean([scenery.building(rng(k), 18.0, 14.0, style, n).bounds()[1, 2] for k in range(6)])
        for n in (1, 3, 6)
    ]
    assert heights[0] + 4 < heights[1] < heights[2] - 6


@pytest.mark.parametrize("style", scenery.BUILDING_STYLES)
@pytest.mark.parametrize(("width", "depth"), [(4.0, 4.0), (4.0, 60.0), (120.0, 4.0)])
def test_odd_plots_can_be_built_on(style: str, width: float, depth: float) -> None:
    surface = scenery.building(rng(3), width, depth, style)
    surface.validate()
    low, high = surface.bounds()
    assert low[0] >= -width / 2 - 0.6 and high[0] <= width / 2 + 0.6
    assert low[1] >= -1.6 and high[1] <= depth + 0.6


def test_roofs_close_buildings_from_above() -> None:
    for style in scenery.BUILDING_STYLES:
        for seed in range(6):
            surface = scenery.building(rng(seed), 14.0, 12.0, style)
            a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
            cross = np.cross(b - a, c - a)
            high = surface.vertices[surface.faces][:, :, 2].mean(axis=1) > 2.2
            seen = 0.5 * cross[high & (cross[:, 2] > 0), 2].sum()
            assert seen >= 14.0 * 12.0 * 0.99, f"{style}, seed {seed}"


@pytest.mark.parametrize("style", scenery.TREE_STYLES)
@pytest.mark.parametrize("height", [1.5, 7.0, 25.0])
def test_tree_is_as_tall_as_asked(style: str, height: float) -> None:
    for seed in range(4):
        low, high = scenery.tree(rng(seed), height, style).bounds()
        assert 0.85 * height <= high[2] <= 1.08 * height
        assert np.abs([low[:2], high[:2]]).max() <= 0.5 * height


def test_crown_is_ragged_at_its_edge() -> None:
    surface = scenery.tree(rng(1), 8.0)
    leaf = surface.materials == MATERIAL_INDEX["foliage"]
    points = surface.vertices[surface.faces[leaf]].reshape(-1, 3)
    top = points[points[:, 2] > 4.0]
    angle = np.arctan2(top[:, 1], top[:, 0])
    reach = [
        np.hypot(*top[(angle >= a) & (angle < a + 0.2), :2].T).max()
        for a in np.arange(-np.pi, np.pi - 0.2, 0.2)
    ]
    assert np.std(reach) > 0.04 * np.mean(reach)


@pytest.mark.parametrize(
    "make",
    [
        lambda length: scenery.hedge(rng(), length),
        lambda length: scenery.guard_rail(rng(), length),
        lambda length: scenery.pole_line(rng(), length),
        *[lambda length, s=s: scenery.fence(rng(), length, s) for s in scenery.FENCE_STYLES],
        *[lambda length, s=s: scenery.wall(rng(), length, 2.0, s) for s in scenery.WALL_STYLES],
    ],
)
def test_long_things_run_from_zero_to_their_length(make) -> None:
    for length in (5.0, 33.3):
        low, high = make(length).bounds()
        assert -0.3 <= low[0] <= 0.05
        assert length - 0.05 <= high[0] <= length + 0.3
        assert max(-low[1], high[1]) < 1.1


def test_guard_rail_faces_the_road() -> None:
    low, _ = scenery.guard_rail(rng(), 10.0).bounds()
    assert low[1] < 0.0
    assert scenery.guard_rail(rng(), 10.0).bounds()[1, 1] > 0.1, "posts are behind the beam"


def test_lamp_reaches_over_the_road() -> None:
    low, high = scenery.lamp_post(rng(), height=9.0, reach=2.0).bounds()
    assert -2.9 < low[1] < -2.0
    assert high[1] < 0.3
    assert 8.9 < high[2] < 9.2


@pytest.mark.parametrize("kind", scenery.SIGN_KINDS)
def test_signs_face_oncoming_traffic(kind: str) -> None:
    surface = scenery.road_sign(rng(), kind)
    assert share_facing(surface, (-1, 0, 0), "sign") == pytest.approx(1.0)
    low, high = surface.bounds()
    assert 2.2 < high[2] < 5.0
    assert low[0] > -0.3 and high[0] < 0.3


@pytest.mark.parametrize(
    ("kind", "colour"),
    [("stop", "red"), ("yield", "red"), ("parking", "blue"), ("direction", "green")],
)
def test_signs_have_their_colour(kind: str, colour: str) -> None:
    surface = scenery.road_sign(rng(), kind)
    colours = surface.colours[surface.materials == MATERIAL_INDEX["sign"]]
    channel = {"red": 0, "green": 1, "blue": 2}[colour]
    others = [k for k in range(3) if k != channel]
    assert np.any(colours[:, channel] > 2 * colours[:, others].max(axis=1).clip(0.03))


def test_speed_signs_differ_by_their_number() -> None:
    shapes = {scenery.road_sign(rng(), "speed", n).vertices.tobytes() for n in (30, 50, 80, 100)}
    assert len(shapes) == 4


@pytest.mark.parametrize("state", scenery.SIGNAL_STATES)
def test_signal_lights_the_lamp_of_its_state(state: str) -> None:
    surface = scenery.traffic_signal(rng(), state)
    lit = surface.colours[surface.materials == MATERIAL_INDEX["signal"]]
    if state == "off":
        assert len(lit) == 0
        return
    assert len(lit) > 0
    r, g, _ = lit.mean(axis=0)
    assert {"red": r > 5 * g, "amber": 5 * g > r > g, "green": g > r}[state]
    height = surface.vertices[surface.faces[surface.materials == MATERIAL_INDEX["signal"]]][..., 2]
    order = {"red": 3.25, "amber": 2.95, "green": 2.65}
    assert height.mean() == pytest.approx(order[state], abs=0.05)


def test_signal_arm_reaches_left_over_the_road() -> None:
    low, high = scenery.traffic_signal(rng(), "green", 6.0).bounds()
    assert 5.5 < high[1] < 6.5
    assert low[1] > -0.6
    arm = scenery.traffic_signal(rng(), "green", 6.0).vertices
    assert arm[arm[:, 1] > 1.0, 2].min() > 5.0, "lorries pass under it"


def test_container_has_the_standard_size() -> None:
    low, high = scenery.container(rng(), 6.06).bounds()
    np.testing.assert_allclose(high - low, [6.06, 2.44, 2.59], atol=0.05)
    np.testing.assert_allclose(low, [-3.03, 0.0, 0.0], atol=0.03)


def test_hoarding_leaves_room_to_walk_below() -> None:
    for seed in range(4):
        points = scenery.hoarding(rng(seed), 8.0, 3.0).vertices
        assert points[points[:, 1] < 0, 2].min() > 2.0
        assert points[:, 0].max() - points[:, 0].min() == pytest.approx(8.0, abs=0.1)


@pytest.mark.parametrize("style", scenery.BUILDING_STYLES)
def test_front_wall_is_drawn_once_and_has_holes(style: str) -> None:
    for seed in range(6):
        surface = scenery.building(rng(seed), 20.0, 14.0, style)
        a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
        cross = np.cross(b - a, c - a)
        in_plane = np.all(np.abs(surface.vertices[surface.faces][..., 1]) < 1e-9, axis=1)
        centre = (a + b + c) / 3
        wall = in_plane & (cross[:, 1] < 0) & (centre[:, 2] < surface.bounds()[1, 2])
        cells = np.stack([a, b, c], axis=1)[wall][..., [0, 2]]
        x, z = np.meshgrid(np.linspace(-9.9, 9.9, 60), np.linspace(0.3, 6.0, 20))
        points = np.stack([x.ravel(), z.ravel()], axis=1)[:, None, None]
        turn = np.roll(cells, -1, axis=1) - cells
        to = points - cells
        side = turn[..., 0] * to[..., 1] - turn[..., 1] * to[..., 0]
        covers = np.all(side > 1e-9, axis=2).sum(axis=1)
        assert covers.max() <= 1, f"seed {seed}: walls lie on each other"
        assert np.mean(covers == 0) > 0.05, f"seed {seed}: no holes"
