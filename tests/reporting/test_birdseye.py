from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.reporting import BirdseyeStyle, draw_frames, draw_still, drawing
from recast.reporting.drawing import Canvas, CanvasView, dashed
from recast.reporting.plots import planned_paths, series
from reporting.made_up_rollouts import cut_in, straight_map, turned

SMALL = BirdseyeStyle(film_width=480, film_height=160, still_width=800, still_max_height=400)
number = st.floats(-200, 200)


def count(image: np.ndarray, colour: drawing.Colour) -> int:
    return int(np.all(image == colour, axis=-1).sum())


@given(x=number, y=number, heading=st.floats(-4, 4), scale=st.floats(0.5, 20), px=number, py=number)
def test_view_round_trip(
    x: float, y: float, heading: float, scale: float, px: float, py: float
) -> None:
    view = CanvasView(np.array([x, y]), heading, scale, 640, 360)
    np.testing.assert_allclose(view.pixels(view.world([px, py])), [px, py], atol=1e-9)


def test_view_axes() -> None:
    view = CanvasView(np.array([5.0, 2.0]), np.pi / 2, 10.0, 200, 100)
    np.testing.assert_allclose(view.pixels([5.0, 2.0]), [100, 50])
    np.testing.assert_allclose(view.pixels([5.0, 3.0]), [110, 50])  # world y points right
    np.testing.assert_allclose(view.pixels([4.0, 2.0]), [100, 40])  # its left is up


def test_polygon_covers_its_pixels_and_no_others() -> None:
    canvas = Canvas(CanvasView(np.zeros(2), 0.0, 10.0, 100, 60), (0, 0, 0))
    canvas.polygon([[-2, -1], [2, -1], [2, 1], [-2, 1]], (255, 0, 0))
    inside = np.zeros((60, 100), bool)
    inside[20:40, 30:70] = True
    red = canvas.image[..., 0]
    assert np.all(red[21:39, 31:69] == 255)
    grown = np.zeros_like(inside)
    grown[18:42, 28:72] = True
    assert np.all(red[~grown] == 0)


def test_shapes_drawn_together_are_those_drawn_one_by_one() -> None:
    rng = np.random.default_rng(2)
    view = CanvasView(np.array([3.0, -2.0]), 0.4, 5.0, 200, 120)
    chains = [rng.uniform(-15, 15, (count, 2)) for count in (3, 7, 4, 5)]  # overlapping
    together, alone = Canvas(view), Canvas(view)
    together.polygons(chains, drawing.EGO)
    together.lines(chains, drawing.PLAN, 2)
    together.polygons([], drawing.GRID)
    for chain in chains:
        alone.polygon(chain, drawing.EGO)
    for chain in chains:
        alone.line(chain, drawing.PLAN, 2)
    np.testing.assert_array_equal(together.image, alone.image)


def test_far_points_do_not_spill() -> None:
    canvas = Canvas(CanvasView(np.zeros(2), 0.0, 10.0, 100, 60), (0, 0, 0))
    canvas.line([[1e7, 5e6], [1e8, 9e7]], (255, 255, 255))
    assert canvas.image.max() == 0


@given(length=st.floats(0.1, 50), dash=st.floats(0.2, 5))
def test_dashes_cover_half(length: float, dash: float) -> None:
    pieces = dashed([[0.0, 0.0], [length / 3, 0.0], [length, 0.0]], dash)
    covered = sum(float(piece[-1, 0] - piece[0, 0]) for piece in pieces)
    assert length / 2 - 1e-9 <= covered <= length / 2 + dash / 2 + 1e-9


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (300.0, -120.0, 2.4)])
def test_film_shows_every_car_wherever_it_is(pose: tuple[float, float, float]) -> None:
    rollout = turned(cut_in(steps=20), pose)
    frames = list(draw_frames(rollout, None, None, SMALL))
    assert len(frames) == 21
    scale = SMALL.film_width / 90.0
    ego = rollout.ego_size[0] * rollout.ego_size[1] * scale**2
    for image in frames:
        assert image.shape == (160, 480, 3) and image.dtype == np.uint8
        assert count(image, drawing.EGO) > 0.4 * ego
        assert count(image, drawing.ACTOR) > 0.3 * ego
        assert count(image, drawing.PLAN) > 20


def test_turning_the_world_does_not_change_the_picture_of_the_cars() -> None:
    here, there = (
        list(draw_frames(turned(cut_in(steps=10), pose), None, None, SMALL))[10]
        for pose in ((0.0, 0.0, 0.0), (300.0, -120.0, 2.4))
    )
    for colour in (drawing.EGO, drawing.ACTOR):
        first, second = (np.all(image == colour, axis=-1) for image in (here, there))
        assert (first != second).sum() < 0.1 * first.sum()


def test_contact_is_marked_only_when_there_is_one() -> None:
    rollout = cut_in(steps=40)
    hit = series(rollout).collision_step
    assert hit is not None
    frames = list(draw_frames(rollout, None, None, SMALL))
    assert count(frames[hit - 1], drawing.COLLISION) == 0
    assert count(frames[hit], drawing.COLLISION) > 30
    assert count(draw_still(rollout, None, None, SMALL), drawing.COLLISION) > 30
    braking = cut_in(steps=40, brake=1.5)
    assert series(braking).collision_step is None
    assert count(draw_still(braking, None, None, SMALL), drawing.COLLISION) == 0


def test_the_map_is_drawn_where_it_is() -> None:
    rollout = cut_in(steps=5)
    with_map, without = (
        next(iter(draw_frames(rollout, hd_map, None, SMALL))) for hd_map in (straight_map(), None)
    )
    assert count(without, drawing.DRIVABLE) == 0
    assert count(with_map, drawing.DRIVABLE) > 5000
    assert np.all(with_map[5, 300] != drawing.DRIVABLE)  # 14 m beside the road


def test_recorded_paths_are_drawn_only_if_given() -> None:
    rollout = cut_in(steps=20)
    path = np.stack([np.linspace(10, 60, 50), np.full(50, -6.0)], axis=1)
    images = [draw_still(rollout, None, given, SMALL) for given in (path, None)]
    colour = drawing.dimmed(drawing.ACTOR, 0.45)
    assert count(images[0], colour) > count(images[1], colour) + 50


def test_a_standing_rollout_without_plans_is_drawn() -> None:
    rollout = cut_in(steps=4)
    still = dataclasses.replace(
        rollout,
        ego=np.repeat(rollout.ego[:1], 5, axis=0),
        log_ego=np.repeat(rollout.log_ego[:1], 5, axis=0),
        route=rollout.ego[:1, :2],
        predictions=np.zeros((0, 40, 3)),
        plan_steps=np.zeros(0, np.int64),
        track_id="a\nb",
    )
    assert len(list(draw_frames(still, straight_map(), None, SMALL))) == 5
    assert draw_still(still, None, None, SMALL).shape[1] == 800


def test_planned_paths_start_at_the_ego_and_follow_its_heading() -> None:
    rollout = turned(cut_in(steps=10), (0.0, 0.0, np.pi / 2))
    paths = planned_paths(rollout)
    np.testing.assert_allclose(paths[:, 0], rollout.ego[rollout.plan_steps, :2])
    np.testing.assert_allclose(paths[:, 1] - paths[:, 0], [[0.0, 0.9], [0.0, 0.9]], atol=1e-9)


def test_series_gap_is_the_distance_between_bumpers() -> None:
    rollout = cut_in(steps=10)
    actor = rollout.actor.copy()
    actor[:, :3] = rollout.ego_boxes + np.array([20.0, 0.0, 0.0])
    curves = series(dataclasses.replace(rollout, actor=actor))
    np.testing.assert_allclose(curves.gap, 20.0 - (5.176 + 4.3) / 2)
    assert not curves.contact.any()
