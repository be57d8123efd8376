"""README's figures: what `benchmarks/readme.py` calls the same, and what not."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from recast.core.files import write_json
from recast.reporting.finding import RunFinding

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "readme.py"


@pytest.fixture(scope="module")
def script() -> Any:
    spec = importlib.util.spec_from_file_location("readme", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """As much of a demo's run folder as the script reads."""
    scores = {"psnr": 14.7, "ssim": 0.4, "mask_iou": 0.71}
    bins = [
        {"low": low, "high": high, "views": 9, "baseline": scores, "candidate": scores}
        for low, high in ((0.0, 30.0), (60.0, 180.0))
    ]
    folder = tmp_path / "run"
    (folder / "report").mkdir(parents=True)
    write_json(folder / "metrics.json", {"truth": {"replaced": {"summary": bins}}})
    found = RunFinding(0, ("It collides at 2.0 m/s.",), 20, "1 s before", "", False)
    found.write(folder / "report")
    return folder


def test_what_was_written_is_the_same_and_other_figures_are_named(
    script: Any, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("# recast\n\n<!-- demo -->\nold\n<!-- /demo -->\n\nmore\n")
    assert script.main([str(run)], readme) == 1
    assert script.main([str(run), "--write"], readme) == 0
    text = readme.read_text()
    assert text.startswith("# recast\n\n<!-- demo -->\n> It collides at 2.0 m/s.\n")
    assert text.endswith("\n<!-- /demo -->\n\nmore\n")
    assert script.main([str(run)], readme) == 0
    capsys.readouterr()
    readme.write_text(text.replace("14.7", "15.9"))
    assert script.main([str(run)], readme) == 1
    assert "demo: 15.9 is now 14.7" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("PSNR 20.0", "PSNR 20.9", True),
        ("PSNR 20.0", "PSNR 21.1", False),
        ("0.04 m", "0.05 m", True),  # one step of the last digit
        ("0.04 m", "0.06 m", False),
        ("2 of 3 collide", "2 of 3 stop", False),
        ("2 of 3", "3 of 3", False),
    ],
)
def test_what_counts_as_the_same(script: Any, old: str, new: str, same: bool) -> None:
    assert (script.differences(old, new) == []) == same
