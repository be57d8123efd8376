"""The generator `auto`: what the package has of its own, for the evidence to choose from."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from recast.actors.generate import ActorGenerator, Asset, candidates_of
from recast.actors.image_to_3d_generator import recast_mini_generator
from recast.actors.observation import Observation
from recast.actors.template import TemplateGenerator


class AutoGenerator:
    """Offers the template's vehicles and those of the small image-to-3D model.

    Args:
        generators: whose vehicles are offered instead.
    """

    name = "auto"

    def __init__(self, generators: Sequence[ActorGenerator] | None = None) -> None:
        self.generators = generators or (TemplateGenerator(), recast_mini_generator())

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """See `OffersCandidates`."""
        return [
            make
            for generator in self.generators
            for make in candidates_of(generator, observation, seed)
        ]

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The first one's vehicle, where there is no evidence to choose by."""
        return self.generators[0].generate(observation, seed)
