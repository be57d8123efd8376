"""The lists of built-in parts: all code exists, and importers are what they are said to be."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from recast.actors.vehicle_files import VEHICLE_SUFFIXES
from recast.core.plugins import (
    GENERATORS,
    IMPORTERS,
    PLANNERS,
    SCENES,
    SEGMENTERS,
    Registry,
    entry_points,
)

KINDS = (PLANNERS, GENERATORS, SEGMENTERS, IMPORTERS, SCENES)
DATA_PAGE = Path(__file__).parents[2] / "docs" / "data.md"


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.kind)
def test_all_code_exists(kind: Registry) -> None:
    readers = {kind.folder, *kind.files.values(), *kind.prefixes.values()} - {""}
    for name in (*kind.names(), *readers):
        assert callable(kind.load(name)), name
    assert kind.experimental <= set(kind.names())


def test_all_commands_and_formats_of_other_packages_can_be_imported() -> None:
    for group in ("recast.commands", "recast.splat_formats"):
        entries = entry_points(group)
        assert len(entries) > 3
        for entry in entries:
            assert entry.load() is not None, entry.name


def test_all_files_of_vehicles_are_read() -> None:
    assert set(GENERATORS.files) == set(VEHICLE_SUFFIXES)


@pytest.mark.parametrize("name", sorted(IMPORTERS.names()))
def test_importers_have_one_signature(name: str) -> None:
    parameters = inspect.signature(IMPORTERS.resolve(name)).parameters
    assert list(parameters)[:4] == ["root", "drive", "labels", "cameras"]
    assert parameters["labels"].default is None and parameters["cameras"].default == ()
    assert all(one.default is not one.empty for one in list(parameters.values())[2:])


def test_the_data_page_marks_experimental_importers() -> None:
    sections = re.split(r"^## ", DATA_PAGE.read_text(), flags=re.M)
    for name in IMPORTERS.names():
        section = next(text for text in sections if f"recast log import {name} " in text)
        assert ("**Experimental" in section) is (name in IMPORTERS.experimental), name
