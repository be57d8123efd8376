"""Ports are used again: what an earlier test met there does not count."""

from __future__ import annotations

import pytest

from recast_bridges.alpasim import driver_session


@pytest.fixture(autouse=True)
def _no_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_session, "_VERSIONS", {})
