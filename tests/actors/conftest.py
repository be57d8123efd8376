"""A made-up street with one car, and the actor made from it."""

from __future__ import annotations

import pytest

from recast.actors import (
    Actor,
    Asset,
    BoxLidarSegmenter,
    Observation,
    TemplateGenerator,
    observe,
    register,
)
from recast.logs import DrivingLog
from recast.splats import Gaussians
from support import made_up_actors as made_up


@pytest.fixture(scope="session")
def red_car() -> Gaussians:
    return made_up.car()


@pytest.fixture(scope="session")
def street(red_car: Gaussians) -> DrivingLog:
    return made_up.street_log(red_car)


@pytest.fixture(scope="session")
def observation(street: DrivingLog) -> Observation:
    return observe(street, "7", segmenter=BoxLidarSegmenter())


@pytest.fixture(scope="session")
def asset(observation: Observation) -> Asset:
    return TemplateGenerator(spacing=0.04).generate(observation, seed=0)


@pytest.fixture(scope="session")
def actor(asset: Asset, observation: Observation, street: DrivingLog) -> Actor:
    return register(asset, observation, street, street.tracks["7"])
