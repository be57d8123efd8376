"""Short refinements and films: tests of runs and studies are not about how good they are."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import pytest

import recast.runs.actor
from recast.actors.refine import Steps, refine

SHORT = Steps(shape=12, paint=4, free=16, look_every=4)


@pytest.fixture(scope="package", autouse=True)
def short_work() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recast.runs.actor, "refine", partial(refine, steps=SHORT))
        patch.setattr(recast.runs.actor, "_TURNTABLE_VIEWS", 4)
        yield
