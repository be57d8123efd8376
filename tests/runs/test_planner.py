"""The planner of a run: when its rollouts are made again, and what is refused before training."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.planning import ConstantVelocity, Planner
from recast.runs.config import RunConfig
from recast.runs.rollouts import run_mounts
from recast.runs.sources import planner_source

PLUGIN = """
from recast.planning import ConstantVelocity

class Backward(ConstantVelocity):
    name, needs_images, camera_names = "backward", True, ("rear",)
"""


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    (tmp_path / "looking_plugin.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    yield "looking_plugin"
    sys.modules.pop("looking_plugin", None)


def _looker(*names: str) -> Planner:
    planner = ConstantVelocity()
    planner.needs_images = True
    planner.camera_names = names  # type: ignore[attr-defined]
    return planner


def test_other_weights_make_other_rollouts(tmp_path: Path) -> None:
    assert planner_source("idm-follower") == "idm-follower"
    assert planner_source("some.module:Planner") == "some.module:Planner"
    assert planner_source("navsim:some.module:Agent") == "navsim:some.module:Agent"
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "weights.safetensors").write_bytes(b"\x00\x01")
    one, two = (planner_source(str(tmp_path / name)) for name in ("one", "two"))
    assert one == two != str(tmp_path / "one")
    (tmp_path / "two" / "weights.safetensors").write_bytes(b"\x00\x02")
    assert planner_source(str(tmp_path / "two")) != one


def test_a_camera_that_the_log_lacks_ends_in_one_line_before_anything_is_written(
    plugin: str, tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    args = ["run", str(tiny_log_folder), "--track", "0", "--motion", "advancing-a"]
    assert main([*args, "--out", str(out), "--planner", f"{plugin}:Backward"]) == 2
    said = " ".join("".join(capsys.readouterr()).split())
    assert "planner backward: camera rear: is needed but missing; render it" in said
    assert not out.exists()


def test_the_cameras_of_a_run(tiny_log: DrivingLog) -> None:
    config = RunConfig(track="0", motions=("cut-in-a",))
    assert list(run_mounts(tiny_log, ConstantVelocity(), config)) == list(tiny_log.cameras)
    virtual = run_mounts(tiny_log, _looker("nuplan_f0"), config)
    assert list(virtual) == [*tiny_log.cameras, "nuplan_f0"]
    camera = virtual["nuplan_f0"].camera
    scale = config.scene.scale
    assert (camera.width, camera.height) == (round(1920 * scale), round(1080 * scale))
    assert not camera.is_rectified
    with pytest.raises(InputError, match="camera front: is needed but missing"):
        run_mounts(tiny_log, _looker("front"), config)


def test_a_time_limit_of_plans() -> None:
    config = RunConfig(track="0", motions=("cut-in-a",))
    assert config.resolved()["plan_limit_s"] is None
    limited = config.model_copy(update={"plan_limit_s": 0.5})
    assert limited.resolved()["plan_limit_s"] == 0.5
    with pytest.raises(ValueError, match="plan_limit_s"):
        RunConfig(track="0", motions=("cut-in-a",), plan_limit_s=0.0)
