"""A small set, a model, and the cache that is built of both: for the tests of the builder."""

from __future__ import annotations

import pytest

from recast.recar.target_cache import TargetCache
from recast.recar.target_maker import ModelSource
from recast.recar.targets import build_targets
from support.target_places import SETTINGS, Places
from support.trellis_folder import write_golden_model
from support.vehicle_pictures import write_vehicles


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Places:
    folder = tmp_path_factory.mktemp("targets")
    return write_vehicles(folder / "set", 3), ModelSource(write_golden_model(folder / "model"))


@pytest.fixture(scope="module")
def built(places: Places, tmp_path_factory: pytest.TempPathFactory) -> TargetCache:
    """Made at once by one process."""
    return build_targets(*places, tmp_path_factory.mktemp("whole") / "cache", SETTINGS)
