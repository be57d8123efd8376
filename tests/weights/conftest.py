"""A hub on loopback, an entry of the table for it, and a folder for weights."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from huggingface_hub import constants, file_download  # noqa: F401  # before a test forks

from recast.weights import PUBLISHED, Licence, Weights, WeightsSource
from weights.hub import Content, Hub

MIT = Licence("MIT", "https://example.org/mit")
FILES: dict[str, Content] = {
    "config.json": b'{"model": "toy"}',
    "deep/weights.safetensors": random.Random(1).randbytes(20_000),
    "README.md": b"not asked for",
}


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


def entry(*sources: WeightsSource, name: str = "toy", **more: object) -> Weights:
    """An entry of the table."""
    return Weights(name, "tests", ("--generator",), 0.1, sources, "generator", **more)  # type: ignore[arg-type]


@pytest.fixture
def toy(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> Weights:
    """An entry "toy" of a repository that the hub has, on its main branch."""
    hub.commit("someone/toy", FILES)
    weights = entry(WeightsSource("someone/toy", ("config.json", "deep/*.safetensors"), MIT))
    monkeypatch.setitem(PUBLISHED, "toy", weights)  # type: ignore[arg-type]
    return weights
