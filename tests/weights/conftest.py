"""A hub on loopback, an entry of the table for it, and a folder for weights."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from huggingface_hub import constants, file_download  # noqa: F401  # before a test forks

from recast.weights import PUBLISHED, Weights, WeightsSource
from weights.hub import FILES, MIT, Hub, entry


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    """The hub, which all requests go to; no other variable or file of the user counts."""
    hub = Hub()
    hub.start()
    for name in ("HF_ENDPOINT", "HF_TOKEN", "HUGGING_FACE_HUB_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "token"))
    monkeypatch.setattr(constants, "DOWNLOAD_CHUNK_SIZE", 1000)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)  # between tries of a cut transfer
    monkeypatch.setenv("RECAST_WEIGHTS_MIRROR", hub.address)
    monkeypatch.setenv("RECAST_WEIGHTS", str(tmp_path / "weights"))
    yield hub
    hub.stop()


@pytest.fixture
def toy(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> Weights:
    """An entry "toy" of a repository that the hub has, on its main branch."""
    hub.commit("someone/toy", FILES)
    weights = entry(WeightsSource("someone/toy", ("config.json", "deep/*.safetensors"), MIT))
    monkeypatch.setitem(PUBLISHED, "toy", weights)  # type: ignore[arg-type]
    return weights
