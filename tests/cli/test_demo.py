"""`recast demo`: sizes and folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from recast.cli.main import main
from recast.runs.run import FULL, QUICK


@pytest.mark.parametrize(
    ("words", "folder", "size"), [((), "runs/demo", FULL), (("--quick",), "runs/demo-quick", QUICK)]
)
def test_the_quick_demo_is_another_folder_and_smaller(
    words: tuple[str, ...], folder: str, size: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr("recast.runs.run.demo", lambda *args: asked.append(args))
    assert main(["demo", *words, "--seed", "3"]) == 0
    [(out, scene, seed, asked_size, threads, _, generator, planner)] = asked
    assert (out, asked_size) == (Path(folder), size)
    assert (scene, seed, threads, generator, planner) == ("urban-straight", 3, 0, "auto", None)


def test_quick_does_less_of_everything() -> None:
    assert QUICK.seconds < FULL.seconds and QUICK.width < FULL.width
    assert QUICK.iterations < FULL.iterations and QUICK.steps < FULL.steps
    assert len(QUICK.motions) < len(FULL.motions) and QUICK.every > FULL.every
