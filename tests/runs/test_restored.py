"""A run with a restorer: its record and keys name it, and its faults are no planner's."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from recast.arrays import Image
from recast.cameras import CameraMount
from recast.cli.main import main
from recast.core.errors import InputError, UnreachableError
from recast.planning import ConstantVelocity
from recast.runs.config import RunConfig, resolve_config
from recast.runs.report import facts
from recast.runs.rollouts import is_failure, make_rollout, read_rollout
from recast.runs.sources import Sources
from recast.simulation import MOTIONS, RolloutFailure, RolloutSetup
from recast.simulation.renderer import Restorer, RestoringRenderer
from recast.simulation.scene_renderer import SceneRenderer
from recast_bridges.neuroncap import planner as ncap_planner
from support.fake_neuroncap import image_of, planning
from support.own_parts import Negative
from support.tiny_served import CAMERA, MOVING, RIG_FROM_CAMERA, make_log, make_scene

LOG = make_log()
NEGATIVE = "support.own_parts:Negative"
SETUP = RolloutSetup(LOG, MOVING, MOTIONS["cut-in-a"], steps=10, camera_names=("front",))


class Looking(ConstantVelocity):
    name, needs_images = "looking", True


def drive(restorer: Restorer, folder: Path) -> None:
    mounts = {"front": CameraMount(CAMERA, RIG_FROM_CAMERA)}
    inner = SceneRenderer(make_scene(LOG), mounts, "cpu")
    folder.mkdir()
    make_rollout(SETUP, Looking(), RestoringRenderer(inner, restorer), folder, filmed=False)


def test_the_record_of_a_rollout_names_it(tmp_path: Path) -> None:
    drive(Negative(), tmp_path / "a")
    assert json.loads((tmp_path / "a" / "planner.json").read_text())["restored_by"] == "negative"


class Failing:
    name = "failing"

    def __init__(self, error: Exception) -> None:
        self._error = error

    def restore(self, images: Mapping[str, Image]) -> Mapping[str, Image]:
        raise self._error


def test_a_program_that_is_not_there_ends_the_run_and_leaves_no_result(tmp_path: Path) -> None:
    away = UnreachableError("restorer x", "/v1/infer", "no program listens there", "start it")
    with pytest.raises(UnreachableError, match="no program listens there"):
        drive(Failing(away), tmp_path / "a")
    assert not is_failure(tmp_path / "a")
    drive(Failing(InputError("restorer x", "/v1/infer", "answered 500", "see")), tmp_path / "b")
    failed = read_rollout(tmp_path / "b")
    assert isinstance(failed, RolloutFailure) and "answered 500" in failed.reason


def config(restorer: str | None) -> RunConfig:
    return resolve_config(MOVING, ["cut-in-a"], None, None, {"restorer": restorer}, {})


def test_the_configuration_names_it() -> None:
    assert "restorer" not in config(None).resolved()  # as runs before there was one
    resolved = config(NEGATIVE).resolved()
    assert resolved["restorer"] == NEGATIVE
    assert RunConfig.model_validate(resolved) == config(NEGATIVE)


def test_the_report_says_it() -> None:
    shown = [(one.name, one.value) for one in facts(config(NEGATIVE), LOG)]
    plain = [(one.name, one.value) for one in facts(config(None), LOG)]
    assert [one for one in shown if one not in plain] == [("Restorer", NEGATIVE)]


def test_what_stands_for_it_in_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    word = "harmonizer:localhost:8000"
    assert Sources.of(config(word), "s").restorers == {word: word}
    assert Sources.of(config(None), "s").restorers == {}
    path = tmp_path / "own_restorer.py"
    monkeypatch.syspath_prepend(str(tmp_path))
    found = []
    for text in ("one = 1", "one = 2"):
        path.write_text(text)
        found.append(Sources.of(config("own_restorer:One"), "s").restorers["own_restorer:One"])
    assert found[0] != found[1]
    known = Sources({}, {}, {}, {"own_restorer:One": found[0]})
    assert Sources.of(config("own_restorer:One"), "s", known).restorers == known.restorers


def test_an_unknown_one_is_refused_before_anything_is_made(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--restorer", "nothing", "--out", str(tmp_path / "out")]
    grid = ["bench", "closed-loop", "--scenes", f"{tiny_log_folder}:0"]
    for command in (["run", str(tiny_log_folder), "--track", "0"], grid):
        assert main([*command, *options]) == 2
        said = capsys.readouterr().err
        assert "restorer: nothing: is not known" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_run_with_another_program_and_a_restorer(tiny_log_folder: Path, tmp_path: Path) -> None:
    """Named in its record; a repeated command asks nobody again, without the restorer it does."""
    out = tmp_path / "run"
    with planning() as (fake, address):
        planner = f"neuroncap:{address}"
        words = ["run", str(tiny_log_folder), "--track", "0", "--motion", "advancing-a"]
        words += ["--arm", "native", "--planner", planner, "--steps", "10", "--scale", "0.5"]
        words += ["--iterations", "4", "--threads", "1", "--out"]
        assert main([*words, str(out), "--restorer", NEGATIVE]) == 0
        assert fake.asked == ["alive", "reset", "infer", "infer"]
        assert main([*words, str(out), "--restorer", NEGATIVE]) == 0
        assert len(fake.asked) == 4
        assert main([*words, str(tmp_path / "plain")]) == 0
        assert len(fake.asked) == 8
    config = json.loads((out / "run.json").read_text())["config"]
    assert (config["planners"], config["restorer"]) == ([planner], NEGATIVE)
    (record,) = out.glob("rollouts/*/*/native/planner.json")
    told = json.loads(record.read_text())
    assert told["planner"] == "neuroncap-" + address.replace(":", "-")
    assert told["restored_by"] == "negative"
    with_restorer, without = (image_of(fake.bodies[k]["images"]["CAM_FRONT"]) for k in (0, 2))
    np.testing.assert_array_equal(with_restorer, 255 - without)


def test_a_run_whose_planner_is_not_there_can_be_repeated(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(ncap_planner, "ALIVE_S", 0.1)
    with planning() as (_, address):
        pass
    words = ["run", str(tiny_log_folder), "--track", "0", "--motion", "advancing-a"]
    words += ["--arm", "native", "--planner", f"neuroncap:{address}", "--steps", "10"]
    words += ["--scale", "0.5", "--iterations", "4", "--threads", "1"]
    for _ in range(2):
        assert main([*words, "--out", str(tmp_path / "run")]) == 2
        said = capsys.readouterr().err.splitlines()[-1]
        assert f"planner neuroncap:{address}: /alive: no program listens there" in said
    assert not list((tmp_path / "run").glob("rollouts/**/failure.json"))
