"""Pedestrians and cyclists: a parametric body, its gait, and what the log shows of both."""

from recast.actors.people.body import PersonShape
from recast.actors.people.generator import PeopleGenerator

__all__ = ["PeopleGenerator", "PersonShape"]
