"""People of the synthetic streets: walking pedestrians and riding cyclists."""

from recast.synthetic.people.place import place_people
from recast.synthetic.people.sample import sample_cyclist, sample_pedestrian

__all__ = ["place_people", "sample_cyclist", "sample_pedestrian"]
