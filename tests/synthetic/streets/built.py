"""Each kind of street, built once for all tests."""

from __future__ import annotations

from functools import cache

import numpy as np

from recast.synthetic.streets import SCENES, make_street
from recast.synthetic.world import Street

LENGTH = 60.0


@cache
def built(name: str, seed: int = 0) -> Street:
    return make_street(name, np.random.default_rng([SCENES.index(name), seed]), LENGTH)
