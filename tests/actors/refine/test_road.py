"""The sun and the contact shadow, told by the road around a vehicle."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from actors import made_up_evidence
from recast.actors import Actor
from recast.actors.icp import outer_surface
from recast.actors.insert import contact_shadow
from recast.actors.refine.images import make_layers, shadow_evidence
from recast.scene.light import CastShadow, SceneLight, SunBelief, darkened
from recast.scene.light.sun import AZIMUTHS, DIRECTIONS, directions
from recast.splats import CLASSIC, Gaussians, concatenate
from support import made_up_actors as made_up

AROUND = np.linspace(0, 2 * np.pi, 9)[:-1]
HALF = made_up.SIZE / 2


@pytest.fixture(scope="module")
def parked(actor: Actor, red_car: Gaussians) -> Actor:
    shadow = contact_shadow(-HALF, HALF, -HALF[2])
    return dataclasses.replace(actor, gaussians=red_car, shadow=shadow, low_pass=CLASSIC)


@pytest.fixture(scope="module")
def cast(parked: Actor) -> CastShadow:
    return CastShadow(outer_surface(parked.gaussians).points, parked.shadow, parked.size)


def told_by_pictures(parked: Actor, drawn: Gaussians) -> tuple[np.ndarray, float]:
    """Evidence of pictures of the vehicle and a sheet below it, masks of the vehicle alone."""
    scene = made_up_evidence.empty_street(parked.gaussians, len(AROUND))
    alone = made_up_evidence.evidence(parked.gaussians, AROUND)
    both = made_up_evidence.evidence(concatenate([parked.gaussians, drawn]), AROUND)
    sightings = tuple(
        dataclasses.replace(one, mask=other.mask)
        for one, other in zip(both.sightings, alone.sightings, strict=True)
    )
    evidence = dataclasses.replace(both, sightings=sightings)
    told = shadow_evidence(parked, scene, make_layers(scene, evidence, parked.shadow))
    assert told.sun.shape == (DIRECTIONS,) and np.isfinite(told.sun).all()
    return told.sun, told.darkness


@pytest.mark.parametrize("truth", [AZIMUTHS * 2 + 3, AZIMUTHS * 3 + 11, AZIMUTHS * 2 + 20])
def test_the_shadow_tells_where_the_sun_stands(parked: Actor, cast: CastShadow, truth: int) -> None:
    light = SceneLight.of(made_up_evidence.empty_street(parked.gaussians, len(AROUND)))
    known = dataclasses.replace(light, sun=SunBelief(np.eye(DIRECTIONS)[truth]))
    sheet = cast.sheet(known, known.place(np.eye(4), parked.size), 0.0)
    sun, _ = told_by_pictures(parked, sheet)
    assert abs((sun.argmax() - truth + AZIMUTHS // 2) % AZIMUTHS - AZIMUTHS // 2) <= 1
    belief = light.sun.given(sun)
    found, wanted = belief.probability @ directions()[0], directions()[0][truth]
    assert found @ wanted / np.linalg.norm(found) > np.cos(np.radians(15))


def test_a_fainter_shadow_is_found_fainter(parked: Actor) -> None:
    _, full = told_by_pictures(parked, parked.shadow)
    _, faint = told_by_pictures(parked, darkened(parked.shadow, 0.3))
    assert faint < 0.7 * full


def test_no_shadow_tells_nothing(parked: Actor) -> None:
    nothing = parked.gaussians.select(torch.zeros(0, dtype=torch.int64))
    without = dataclasses.replace(parked, shadow=nothing)
    sun, darkness = told_by_pictures(without, nothing)
    assert not sun.any() and darkness == 1.0


def test_light_left_turns_with_the_vehicle(parked: Actor, cast: CastShadow) -> None:
    """A quarter turn of the vehicle is a quarter of all azimuths."""
    light = SceneLight.of(made_up_evidence.empty_street(parked.gaussians, len(AROUND)))
    place = light.place(np.eye(4), parked.size)
    at = np.random.default_rng(0).uniform(-3, 3, (50, 2))
    ahead, open_sky = cast.left(place, 0.0, at)
    turned, _ = cast.left(place, np.pi / 2, at)
    quarter = AZIMUTHS // 4
    shape = (-1, AZIMUTHS, len(at))
    rolled = np.roll(ahead.reshape(shape), quarter, axis=1).reshape(ahead.shape)
    np.testing.assert_allclose(turned, rolled, atol=1e-6)
    assert ((ahead > 0) & (ahead <= open_sky + 1e-9) & (open_sky <= 1 + 1e-9)).all()
