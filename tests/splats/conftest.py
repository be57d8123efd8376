"""The compiled rasterizer, one instruction set after the other."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from recast.splats import native


@pytest.fixture(params=["avx512", "avx2", "portable"])
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Run the test on each instruction set that this machine has."""
    info = native.info()
    if request.param not in info.isas:
        pytest.skip(f"{request.param} not available: {info.reason or 'this machine has no such'}")
    native.set_isa(request.param)
    yield request.param
    native.set_isa(info.isa)


@pytest.fixture
def compiled() -> None:
    """Skip where there is no compiled rasterizer."""
    if not native.info().available:
        pytest.skip(native.info().reason)
