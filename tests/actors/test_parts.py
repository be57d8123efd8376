"""Parts told by colour: designs and placements move to where photographs show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from actors.made_up_views import seen_from
from recast.actors import Observation, TemplateGenerator
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import SurfaceCloud, build_cloud
from recast.actors.template.design import STYLES, VehicleDesign
from recast.actors.template.generator import vehicle_gaussians
from recast.actors.template.materials import VehiclePart
from recast.actors.template.parts import (
    PartEvidence,
    accepted,
    fit_parts,
    knobs,
    paint_colour,
    seen_patches,
    settled,
    to_lab,
)
from recast.actors.template.proportions import Silhouette, TemplatePlacement, find_axles
from recast.actors.template.texture import SurfaceView, view_surface
from recast.geometry.colour import gamma_to_linear
from recast.splats import Gaussians
from support import made_up_actors as made_up

PAINT = np.array([0.45, 0.5, 0.55])
EXACT = TemplatePlacement(np.ones(3), np.array([0.0, 0.0, -made_up.SIZE[2] / 2]), 1.0)


class NoMask(Silhouette):
    """An outline that fits wherever the vehicle is."""

    def overlap(self, placement: TemplatePlacement) -> float:
        return 0.9


def drawn_as(design: VehicleDesign) -> tuple[Gaussians, SurfaceCloud]:
    """A vehicle of a design, nothing photographed, and its patches."""
    body = TemplateBody(made_up.SIZE, design)
    cloud = build_cloud(body, 0.03, np.random.default_rng(0))
    return vehicle_gaussians(body, cloud, gamma_to_linear(PAINT)), cloud


def evidence_of(cloud: SurfaceCloud, view: Observation) -> tuple[SurfaceView, PartEvidence]:
    seen = view_surface(cloud, view, EXACT)
    paint = paint_colour([seen], cloud.on_body & (cloud.part == VehiclePart.PAINT))
    assert np.linalg.norm(paint[1:] - to_lab(PAINT[None])[0, 1:]) < 8
    return seen, PartEvidence.of(view, paint)


def test_lamps_move_to_where_they_are_seen() -> None:
    usual = STYLES["hatchback"]
    high = replace(usual, rear=replace(usual.rear, lamp_low=0.60, lamp_high=0.78))
    vehicle, _ = drawn_as(high)
    body = TemplateBody(made_up.SIZE, usual)
    cloud = build_cloud(body, 0.03, np.random.default_rng(0))
    seen, evidence = evidence_of(cloud, seen_from(vehicle, 160.0))
    patches = seen_patches(cloud, seen, evidence, EXACT)
    rear = fit_parts(body, [patches], usual).design.rear
    assert (rear.lamp_low, rear.lamp_high) == (
        pytest.approx(0.60, abs=0.04),
        pytest.approx(0.78, abs=0.05),
    )
    assert fit_parts(body, [], usual) is body


def test_a_view_is_placed_by_its_parts() -> None:
    """A label that is 8 cm off, and a mask of which nothing is known."""
    vehicle, cloud = drawn_as(STYLES["hatchback"])
    view = seen_from(vehicle, 150.0, shift=0.08)
    seen, evidence = evidence_of(cloud, view)
    patches = seen_patches(cloud, seen, evidence, EXACT)
    body = TemplateBody(made_up.SIZE, STYLES["hatchback"])
    found = settled(EXACT, patches, body, evidence, NoMask(view, cloud.points, 0.03)).placement
    moved = view.camera_from_object[:3, :3] @ (found.shift - EXACT.shift)
    assert moved[0] == pytest.approx(0.08, abs=0.04)


def test_wheels_are_found_from_the_side_not_from_ahead() -> None:
    usual = STYLES["hatchback"]
    apart = replace(usual.proportions, front_axle_x=0.21, rear_axle_x=0.785)
    vehicle, _ = drawn_as(replace(usual, proportions=apart))
    views = [seen_from(vehicle, 12.0), seen_from(vehicle, 95.0)]
    body = TemplateBody(made_up.SIZE, usual)
    first = replace(views[0], further=(views[1],))
    found = find_axles(body, usual, first, [EXACT, EXACT]).proportions
    assert found.front_axle_x == pytest.approx(0.21, abs=0.012)
    assert found.rear_axle_x == pytest.approx(0.785, abs=0.012)
    ahead = find_axles(body, usual, views[0], [EXACT]).proportions
    assert ahead.front_axle_x == usual.proportions.front_axle_x


def test_a_patch_takes_only_its_own_part() -> None:
    colours = np.array([[0.7, 0.1, 0.1], PAINT, [0.1, 0.1, 0.1]])
    view = SurfaceView(colours, np.ones(3), np.tile([1.0, 0, 0], (3, 1)), np.ones(3))
    part, modelled = np.full(3, VehiclePart.PAINT), np.tile(PAINT, (3, 1))
    strict = accepted(view, part, modelled, np.ones(3, bool)).weight
    assert strict[0] == 0 and strict[1] == 1 and strict[2] == 0
    believed = accepted(view, part, modelled, np.zeros(3, bool)).weight
    assert believed.tolist() == [1, 1, 1]


def test_every_number_and_choice_is_a_knob() -> None:
    design = STYLES["suv"]
    names = {(knob.group, knob.names) for knob in knobs()}
    assert {("rear", ("lamp_low",)), ("side", ("pillar_b_x",)), ("front", ("grille",))} <= names
    for knob in knobs():
        for other in knob.moved(design, 0.1):
            assert other != design
            assert knob.cost(design, design) == 0 and knob.cost(other, design) >= 0


def test_a_view_of_something_else_is_left_out_and_told() -> None:
    vehicle, _ = drawn_as(STYLES["hatchback"])
    first, wrong = seen_from(vehicle, 150.0), seen_from(vehicle, 60.0)
    pose = wrong.camera_from_object.copy()
    pose[0, 3] += 1.2  # the box of its neighbour
    shown = replace(first, further=(replace(wrong, camera_from_object=pose),))
    details = TemplateGenerator(0.1, "hatchback").generate(shown, 0).details
    assert (details["left_out"], details["views"]) == (1, 1)
    right = replace(first, further=(wrong,))
    details = TemplateGenerator(0.1, "hatchback").generate(right, 0).details
    assert "left_out" not in details and details["views"] == 2


def test_what_does_not_look_like_the_vehicle_is_told() -> None:
    vehicle, _ = drawn_as(STYLES["hatchback"])
    clean = seen_from(vehicle, 150.0)
    generator = TemplateGenerator(0.05, "hatchback")
    assert "doubts" not in generator.generate(clean, 0).details
    rgba = clean.rgba.copy()
    height, width = rgba.shape[:2]
    rgba[height // 2 :, : width // 2, :3] = [20, 140, 30]  # something green before its side
    told = str(generator.generate(replace(clean, rgba=rgba), 0).details["doubts"])
    assert "another vehicle" in told and "night" not in told
    dark = np.zeros((600, 800, 4), np.uint8)
    dark[..., :3] = 5  # the road at night
    inside = clean.rgba[..., 3] > 127
    top, left = (600 - height) // 2, (800 - width) // 2
    dark[top : top + height, left : left + width][inside] = clean.rgba[inside] // [25, 25, 25, 1]
    camera = replace(
        clean.camera,
        width=800,
        height=600,
        cx=clean.camera.cx + left,
        cy=clean.camera.cy + top,
    )
    night = replace(clean, rgba=dark, camera=camera)
    assert "night" in str(generator.generate(night, 0).details["doubts"])
