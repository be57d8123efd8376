"""Scenario files in a run: their contents belong to its configuration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from recast.core.errors import InputError
from recast.runs.arms import Arm
from recast.runs.config import RunConfig, resolve_config
from recast.runs.run_folder import RunFolder
from recast.simulation import MOTIONS

TEXT = """\
version: 1
name: near
motion: stationary
settings:
  a: {min_gap: 12, braking: 6.0, reserve: 2.0}
"""


def start(out: Path, config: RunConfig) -> RunFolder:
    log, store = out.parent / "log", str(out.parent / "store")
    return RunFolder.create_or_resume(out, config.resolved(), log, "hash", store)


def resolve(motions: list[str], config_file: Path | None = None) -> RunConfig:
    return resolve_config("0", motions, config_file, None, {}, {})


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.yaml"
    path.write_text(TEXT)
    return path


def test_names_and_files_together(own: Path) -> None:
    config = resolve(["cut-in-a", str(own)])
    assert config.motions == ("cut-in-a", "near-a")
    assert config.motion("near-a").min_gap == 12.0
    assert config.motion("cut-in-a") is MOTIONS["cut-in-a"]


def test_a_run_resumes_while_the_file_says_the_same(own: Path, tmp_path: Path) -> None:
    start(tmp_path / "run", resolve([str(own)]))
    own.write_text("# mine\n" + TEXT.replace("12", "12.0"))  # other words, same scenario
    start(tmp_path / "run", resolve([str(own)]))
    own.write_text(TEXT.replace("12", "13"))
    with pytest.raises(InputError, match=r"own_motions\.near-a\.settings\.a\.min_gap"):
        start(tmp_path / "run", resolve([str(own)]))


def test_the_record_of_a_run_needs_no_file(own: Path, tmp_path: Path) -> None:
    config = resolve([str(own)])
    start(tmp_path / "run", config)
    own.unlink()
    assert resolve([], tmp_path / "run" / "run.json") == config
    assert resolve(["near-a"], tmp_path / "run" / "run.json").motions == ("near-a",)


def test_two_files_must_not_say_two_things_under_one_name(own: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(TEXT)
    assert resolve([str(own), str(other)]).motions == ("near-a",)
    other.write_text(TEXT.replace("12", "13"))
    with pytest.raises(InputError, match="another scenario is already called near-a"):
        resolve([str(own), str(other)])


def test_runs_without_own_scenarios_say_so() -> None:
    assert resolve(["cut-in"]).resolved()["own_motions"] == {}


def test_a_faulty_record_is_refused() -> None:
    with pytest.raises(ValueError, match="own_motions"):
        RunConfig(track="0", motions=("x-a",), own_motions={"x-a": {"version": 1}})


HOSTILE = ["../../../victim", "/victim", "a\0b", "a\nb", "x" * 300, "\u202eni-tuc", "<script>", ""]


@pytest.mark.parametrize("name", [*HOSTILE, "near-b"])
def test_the_name_of_an_own_scenario_is_the_one_it_describes(
    own: Path, tmp_path: Path, name: str
) -> None:
    """Names become folders, so a configuration file must not choose others."""
    config = resolve([str(own)]).model_dump(mode="json")
    config |= {"motions": [name], "own_motions": {name: config["own_motions"]["near-a"]}}
    file = tmp_path / "config.json"
    file.write_text(json.dumps(config))
    with pytest.raises(InputError) as caught:
        resolve([], file)
    assert caught.value.field == "own_motions"
    assert "holds the scenario 'near-a'" in caught.value.problem


@pytest.mark.parametrize("motions", [["moonwalk-a"], ["../../victim"]])
def test_a_motion_that_nothing_describes_is_refused(tmp_path: Path, motions: list[str]) -> None:
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"version": 2, "track": "0", "motions": motions}))
    with pytest.raises(InputError, match="neither built in"):
        resolve([], file)


@pytest.mark.parametrize("member", ["motions", "planners", "arms"])
def test_what_is_named_twice_is_refused(tmp_path: Path, member: str) -> None:
    values: dict[str, Any] = {
        "version": 2,
        "track": "0",
        "motions": ["cut-in-a"],
        "planners": ["idm-follower"],
        "arms": [Arm.native().model_dump()],
    }
    file = tmp_path / "config.json"
    file.write_text(json.dumps(values))
    assert resolve([], file).motions == ("cut-in-a",)
    file.write_text(json.dumps({**values, member: values[member] * 2}))
    with pytest.raises(InputError, match="twice"):
        resolve([], file)
