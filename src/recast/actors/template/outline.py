"""The body style by the vehicle's outline in the photograph, where no LiDAR tells its shape."""

from __future__ import annotations

import numpy as np

from recast.actors.observation import Observation
from recast.actors.template.body import Body
from recast.actors.template.cloud import build_cloud
from recast.actors.template.placement import place
from recast.actors.template.proportions import STYLES, candidate_styles

_SPACING = 0.048  # metres: a silhouette of some 80 pixels tells a sedan from an estate
_OVERLAP_WEIGHT = 60.0  # as in `place`


def style_by_outline(observation: Observation, rng: np.random.Generator) -> str:
    """The plausible style whose silhouette, placed as well as it goes, fits the mask best.

    Cost: what its overlap with the mask lacks, plus the style's prior for class and box.
    """
    priors = candidate_styles(observation.category, observation.size)
    chosen, least = "", np.inf
    for style, prior in sorted(priors.items(), key=lambda item: item[1]):
        if prior >= least or len(priors) == 1:
            return chosen or style
        body = Body(observation.size, STYLES[style])
        sketch = build_cloud(body, _SPACING, rng).points
        overlap = place(body, sketch, _SPACING, observation, np.zeros((0, 3))).overlap
        cost = prior + _OVERLAP_WEIGHT * (1 - overlap)
        if cost < least:
            chosen, least = style, cost
    return chosen
