"""NeuroNCAP's scenario files: every member checked, and the same random runs as there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import DrivingLog, Trajectory, read_log
from recast.logs.importers.nuscenes import KEY_FRAMES, load_nuscenes
from recast.planning import ConstantVelocity
from recast.simulation import (
    LoggedMotion,
    RolloutSetup,
    Scenario,
    TimedPath,
    read_scenario,
    run_rollout,
)
from recast_bridges.neuroncap.scenario_file import read_ncap_scenario
from recast_bridges.neuroncap.scenarios import import_ncap_scenario, ncap_runs
from support.tiny_nuscenes import KEY_US, SCENE, START_US, write_tiny_nuscenes
from support.tiny_served import TIMES, make_log

OFFSET = np.array([650.0, 1600.0, 0.0])
FIRST_US = int(TIMES[0]) + 40_000  # key frames begin after the first ego pose, as in nuScenes
FRAMES = (
    FIRST_US + np.array([0, 500, 1010, 1490, 2000, 2500, 3050, *range(3500, 19_000, 500)]) * 1000
)
BASE = make_log()
LOG = replace(
    BASE,
    tracks={
        **BASE.tracks,
        "dc762bf1bc694d3e8141bf592f9b1456": replace(
            BASE.tracks["car-a"], track_id="dc762bf1bc694d3e8141bf592f9b1456"
        ),
    },
    world_offset=OFFSET,
    metadata={KEY_FRAMES: " ".join(map(str, FRAMES.tolist()))},
)
BLACK = "dc762bf1bc694d3e8141bf592f9b1456"

GOOD = """\
general:
  start-pose: "original"
  start_velo: "original"
  start-frame: 3
  time-step: 0.5
  priming-steps: 2
  duration: 7.0
  smooth-actors: true
  start-jitter: 1
actors:
  - uuids:
      - car-a  # a comment
      - dc762bf1bc694d3e8141bf592f9b1456
    flip-uuids: [car-a]
    mode: "override"
    times: [-1.0, 4.0, 20.0]
    is_target_actor: true
    initial-yaw: -2.1
    exclusive-group: "1"
    positions:
      - [665.0, 1620.0, -0.05]
      - [700.0, 1600.0, 0.0]
      - [700.0, 1600.0, 0.0]
    jitter:
      times: [0.0, 0.0, 0.0]
      longitudinal: 1.0
      lateral: 0.5
      long-lat-angle: -2.1
      yaw-jitter: 0.3
  - uuid: car-b
    mode: override
    times: [0.0, 20.0]
    positions: [[680.0, 1590.0, 0.0], [680.0, 1590.0, 0.0]]
    jitter: {longitudinal: 2.0, long_lat_angle: 0.4, uniform: false}
"""


def write(tmp_path: Path, text: str = GOOD) -> Path:
    path = tmp_path / "side" / "0103.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def as_neuroncap_draws(seed: int) -> Mapping[str, Any]:
    """The order of NeuroNCAP's draws, written down once more by hand for the file above."""
    start = max(0, 3 + int(np.random.default_rng(seed).integers(-1, 2)))
    rng, found = np.random.default_rng(seed), {"start": start}
    for actor in rng.permutation([{"name": "first"}, {"name": "second"}]):
        if actor["name"] == "first":
            found["uuid"] = str(rng.choice(["car-a", BLACK]))
            found["along"], found["across"] = rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5)
            found["turn"] = rng.uniform(-0.3, 0.3)
        else:
            found["second along"] = rng.normal(scale=2.0)
    return found


def test_runs_are_those_of_neuroncap(tmp_path: Path) -> None:
    runs = ncap_runs(read_ncap_scenario(write(tmp_path)), LOG, 12)
    assert {run.target for run in runs} == {"car-a", BLACK}
    assert len({as_neuroncap_draws(seed)["start"] for seed in range(12)}) == 3
    seconds = (FRAMES - FRAMES[0]) * 1e-6
    cos, sin = np.cos(-2.1), np.sin(-2.1)
    for seed, run in enumerate(runs):
        drawn = as_neuroncap_draws(seed)
        assert (run.seed, run.target) == (seed, drawn["uuid"])
        assert list(run.motions) == [drawn["uuid"], "car-b"]
        first, driven = drawn["start"], drawn["start"] + 2
        target, other = run.motions.values()
        assert isinstance(target, TimedPath) and isinstance(other, TimedPath)
        assert target.start_after == pytest.approx((FRAMES[driven] - TIMES[0]) * 1e-6, abs=1e-6)
        assert run.steps == int((7.0 - (seconds[driven] - seconds[first])) * 10 + 1e-6)
        # Where NeuroNCAP samples it, 14 times over 7 s from the start frame without jitter on.
        samples = np.linspace(0.0, 7.0, 14) + seconds[3]
        offset = drawn["along"] * np.array([cos, sin]) + drawn["across"] * np.array([sin, -cos])
        share = np.clip((samples + 1.0) / 5.0, 0.0, 1.0)[:, None]
        wanted = [665.0, 1620.0] + share * [35.0, -20.0] + offset - OFFSET[:2]
        # Rows that lie on a line were left out; the motion runs through them all the same.
        states = script_at(target, samples - seconds[driven])
        np.testing.assert_allclose(states[:, :2], wanted, rtol=0, atol=2e-6)
        stands = samples >= 4.0
        yaw = -2.1 + drawn["turn"] + (np.pi if drawn["uuid"] == "car-a" else 0.0)
        np.testing.assert_allclose(
            np.exp(1j * states[:, 2]),
            np.where(stands, np.exp(1j * yaw), np.exp(1j * np.arctan2(-20.0, 35.0))),
            rtol=0,
            atol=3e-6,
        )
        along = drawn["second along"] * np.array([np.cos(0.4), np.sin(0.4)])
        place = np.array([30.0, -10.0]) + along
        there = script_at(other, samples - seconds[driven])
        np.testing.assert_allclose(there[:, :2], np.tile(place, (14, 1)), atol=2e-6)
        np.testing.assert_allclose(there[:, 2:], 0.0, atol=1e-12)
        assert len(other.path) == 2 and len(target.path) <= 6


def script_at(motion: TimedPath, times: np.ndarray) -> np.ndarray:
    """States (N, 4) at times, each as the second step of a script with that step."""
    situation: Any = None
    return np.array(
        [
            replace(motion, path=tuple((row[0] - time, *row[1:]) for row in motion.path)).script(
                situation, 1, 0.1
            )[0]
            for time in times
        ]
    )


def test_files_are_scenarios_of_recast(tmp_path: Path) -> None:
    written = import_ncap_scenario(write(tmp_path), LOG, tmp_path / "out", 6)
    assert sorted(seed for one in written for seed in one.seeds) == list(range(6))
    assert {one.path.name for one in written} == {
        "side-0103-car-a.yaml", "side-0103-dc762bf1.yaml"
    }  # fmt: skip
    runs = {run.seed: run for run in ncap_runs(read_ncap_scenario(write(tmp_path)), LOG, 6)}
    for one in written:
        scenarios = read_scenario(one.path)
        assert [scenario.setting for scenario in scenarios] == [f"run-{n}" for n in one.seeds]
        for seed, scenario in zip(one.seeds, scenarios, strict=True):
            assert isinstance(scenario, Scenario) and isinstance(scenario.motion, TimedPath)
            own = runs[seed].motions[one.target]
            assert (scenario.motion.path, scenario.motion.start_after) == (
                own.path, own.start_after,
            )  # fmt: skip
            assert [actor.track_id for actor in scenario.actors] == ["car-b"]
    with pytest.raises(InputError, match="exists already"):
        import_ncap_scenario(write(tmp_path), LOG, tmp_path / "out", 6)


def test_an_imported_run_is_driven(tmp_path: Path) -> None:
    one = import_ncap_scenario(write(tmp_path), LOG, tmp_path / "out", 1)[0]
    (scenario,) = read_scenario(one.path)
    rollout = run_rollout(RolloutSetup(LOG, one.target, scenario, steps=20), ConstantVelocity())
    start = (rollout.start_timestamp_us - TIMES[0]) * 1e-6
    assert start == pytest.approx(scenario.motion.start_after, abs=1e-6)
    # The rollout's world is the dataset's less the offset.
    [wanted] = script_at(scenario.motion, np.array([1.0]))
    np.testing.assert_allclose(rollout.actor[10, :3], wanted[:3], atol=1e-9)


def test_groups_and_actors_that_drive_as_logged(tmp_path: Path) -> None:
    text = GOOD.replace("uuid: car-b\n", "uuid: car-b\n    exclusive_group: 1\n")
    text = text.replace('exclusive-group: "1"', "exclusive-group: 1")
    runs = ncap_runs(read_ncap_scenario(write(tmp_path, text)), LOG, 20)
    assert {len(run.motions) for run in runs} == {1}
    assert {run.target for run in runs} == {"car-a", BLACK, "car-b"}
    logged = GOOD[: GOOD.index("  - uuid: car-b")] + "  - {uuid: car-b, mode: optimized}\n"
    for run in ncap_runs(read_ncap_scenario(write(tmp_path, logged)), LOG, 3):
        assert isinstance(run.motions["car-b"], LoggedMotion)
    written = import_ncap_scenario(write(tmp_path, logged), LOG, tmp_path / "out", 3)
    assert isinstance(read_scenario(written[0].path)[0], Scenario)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("general:", "generals:", "0103.yaml:1: generals: is not known; did you mean general?"),
        ("  start-frame: 3", "  start_frame: 3.5", ":4: start_frame: is the number 3.5; give a wh"),
        ("  start-frame: 3", "  start-frame: -1", ":4: start_frame: is the number -1; give a num"),
        ("  start-frame: 3", "  start_velo: original", ":4: start_velo: is given twice, first in"),
        ("  start-frame: 3", "  start-velo: original", ":4: start-velo: is given twice; remove on"),
        ("  start-frame: 3", "  startframe: 3", ":4: startframe: is not known; did you mean start"),
        ('start-pose: "original"', "start-pose: override", "start_pose: is 'override'; give"),
        ("time-step: 0.5", "time-step: 0.25", ":5: time_step: is the number 0.25; give 0.5: recas"),
        ("duration: 7.0", "duration: 0.1", ":7: duration: is the number 0.1; give a number from"),
        ("duration: 7.0", "duration: long", ":7: duration: is 'long'; give a number from 0.5"),
        ("smooth-actors: true", "smooth-actors: 1", "smooth_actors: is the number 1; write true o"),
        ("smooth-actors: true", "dim-jitter: 0.2", ":8: dim_jitter: is the number 0.2; give 0: ve"),
        ("smooth-actors: true", "actor-framerate: 0.1", "actor_framerate: is the number 0.1; give"),
        (GOOD[GOOD.index("  - uuids") :], "", ":10: actors: is empty; give a list of 1 to 100"),
        ("      - car-a  # a comment", "      - 12", ":12: uuid: is the number 12; give a track i"),
        ("    mode: override", "    mode: new", "mode: is 'new'; give override or optimized"),
        ("    mode: override", "    uuids: [a]\n    mode: override", "uuids: must be given, or uu"),
        ("    mode: override", "    dims: [1, 2, 3]\n    mode: override", "dims: is a list; leave"),
        ("times: [-1.0, 4.0, 20.0]", "times: [-1.0, 4.0]", "positions: has 3 positions for 2"),
        ("times: [-1.0, 4.0, 20.0]", "times: [4.0, 4.0, 5.0]", ":16: times: do not increase"),
        ("    times: [0.0, 20.0]\n", "", "times: is missing; correct it"),
        ("[700.0, 1600.0, 0.0]", "[700.0, 1600.0]", ":22: positions: is a list; give x, y and z"),
        ("[700.0, 1600.0, 0.0]", "[700.0, .nan, 0.0]", ":22: positions: is '.nan'; give a number"),
        ("is_target_actor: true", "is_target_actor: 1", "is_target_actor: is the number 1; write"),
        ("      longitudinal: 1.0", "      longitudinal: -1.0", "longitudinal: is the number -1"),
        ("      long-lat-angle: -2.1\n", "", "long_lat_angle: is missing; give the angle of"),
        ('exclusive-group: "1"', "exclusive-group: [1]", "exclusive_group: is a list; give"),
        ("mode: override", "mode: !!python/name:os.system x", "has the tag tag:yaml.org,2002:pyth"),
    ],
)  # fmt: skip
def test_a_wrong_member_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as error:
        read_ncap_scenario(write(tmp_path, GOOD.replace(old, new, 1)))
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("uuid: car-b", "uuid: car-z", "uuid car-z: is not a track of drive"),
        ("uuid: car-b", "uuid: car-b\n    is_target_actor: true", "run 0: has 2 targets"),
        ("uuid: car-b", f"uuids: [car-a, {BLACK}]", "the track .* twice"),
        ("start-frame: 3", "start-frame: 200", r"run 0: begins at key frame \d+, but drive has"),
        (
            "priming-steps: 2",
            "priming-steps: 20",
            "begins before the log, or ends within its priming steps",
        ),
    ],
)
def test_runs_that_cannot_be(tmp_path: Path, old: str, new: str, message: str) -> None:
    scenario = read_ncap_scenario(write(tmp_path, GOOD.replace(old, new, 1)))
    with pytest.raises(InputError, match=message):
        ncap_runs(scenario, LOG, 20)


def test_a_log_without_key_frames_and_a_target_that_is_logged(tmp_path: Path) -> None:
    scenario = read_ncap_scenario(write(tmp_path))
    with pytest.raises(InputError, match="has no key frames; import the nuScenes scene"):
        ncap_runs(scenario, BASE, 1)
    text = "general: {}\nactors:\n  - {uuid: car-a, mode: optimized}\n"
    with pytest.raises(InputError, match="its target car-a follows its logged trajectory"):
        ncap_runs(read_ncap_scenario(write(tmp_path, text)), LOG, 1)
    for runs in (0, 101):
        with pytest.raises(InputError, match="`runs`: value: is"):
            ncap_runs(scenario, LOG, runs)


def test_the_command_on_an_imported_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tiny_nuscenes(tmp_path / "nuscenes")
    own = load_nuscenes(tmp_path / "nuscenes", SCENE)
    frames = [START_US + KEY_US * number for number in range(5)]
    assert own.metadata[KEY_FRAMES] == " ".join(map(str, frames))
    folder = tmp_path / "log"
    words = ["log", "import", "nuscenes", str(tmp_path / "nuscenes"), "--drive", SCENE]
    assert main([*words, "--out", str(folder)]) == 0
    kept: DrivingLog = read_log(folder)
    assert kept.metadata[KEY_FRAMES] == own.metadata[KEY_FRAMES]
    x, y = (kept.tracks["car"].trajectory.poses[0, :2, 3] + kept.world_offset[:2]).tolist()
    text = f"""\
general: {{start-frame: 1, priming-steps: 0, duration: 1.5}}
actors:
  - {{uuid: car, mode: override, times: [0, 2], positions: [[{x}, {y}, 0], [{x}, {y}, 0]]}}
"""
    path, out = write(tmp_path, text), tmp_path / "imported"
    capsys.readouterr()
    command = ["scenario", "import", "neuroncap", str(path), "--log", str(folder)]
    assert main([*command, "--out", str(out), "--runs", "1"]) == 0
    said = capsys.readouterr().out
    assert said == (
        f"{out}/side-0103-car.yaml: runs 0; target car\n"
        f"  recast run {folder} --track car --motion {out}/side-0103-car.yaml --steps 15 "
        "--out RUN\n"
    )
    (motion,) = read_scenario(out / "side-0103-car.yaml")
    assert isinstance(motion, TimedPath)
    wanted = kept.tracks["car"].trajectory.poses[0, :2, 3]
    np.testing.assert_allclose([row[1:3] for row in motion.path], [wanted] * 2, atol=1e-6)
    assert isinstance(kept.world_from_rig, Trajectory)
    start = (frames[1] - kept.world_from_rig.timestamps_us[0]) * 1e-6
    assert motion.start_after == pytest.approx(start, abs=1e-6)
    assert main([*command, "--out", str(tmp_path / "x"), "--runs", "0"]) == 2
    assert "--runs: value: is 0" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
