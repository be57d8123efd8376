"""Places at times: what the script says, what files say, and the start that it asks for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.planning import ConstantVelocity
from recast.simulation import (
    RolloutSetup,
    StartSituation,
    TimedPath,
    motion_of_record,
    prepare,
    read_scenario,
    run_rollout,
    scenario_numbers,
    scenario_record,
)
from support.tiny_served import MOVING, PARKED, TIMES, make_log

LOG = make_log()
PATH = ((-1.0, 10.0, 0.0, 3.0), (1.0, 14.0, 2.0, -3.0), (2.0, 14.0, 2.0, 0.5))
MOTION = TimedPath("a", PATH, 4.0, "mine", "Turns and stands.")

GOOD = """\
version: 1
name: mine
motion: timed-path
description: Turns and stands.
settings:
  a:
    start_after: 4.0
    path:
    - [-1.0, 10.0, 0.0, 3.0]
    - [1.0, 14.0, 2.0, -3.0]
    - [2.0, 14.0, 2.0, 0.5]
"""


def test_places_and_headings_are_linear_and_the_velocity_stays_outside() -> None:
    states = MOTION.script(_situation(), 30, 0.1)
    wanted = [[12, 1], [13, 1.5], [14, 2], [14, 2], [14, 2]]
    np.testing.assert_allclose(states[[0, 5, 10, 15, 30], :2], wanted, atol=1e-12)
    # The short way from 3 to -3 leads over pi.
    turn = 2 * np.pi - 6.0
    np.testing.assert_allclose(states[5, 2], 3.0 + 0.75 * turn - 2 * np.pi, atol=1e-12)
    np.testing.assert_allclose(states[30, 2], 0.5, atol=1e-12)
    np.testing.assert_allclose(states[[0, 9], 3], np.hypot(2, 1), atol=1e-12)
    np.testing.assert_array_equal(states[10:, 3], 0)
    motion = TimedPath("b", ((1.0, 5.0, 0.0, 0.0), (2.0, 7.0, 0.0, 0.0)))
    early = motion.script(_situation(), 30, 0.1)
    np.testing.assert_allclose(early[[0, 30], 0], [3.0, 9.0], atol=1e-12)


def _situation() -> StartSituation:
    return None  # type: ignore[return-value]  # a path depends on nothing


def test_files_and_records(tmp_path: Path) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(GOOD)
    assert read_scenario(path) == (MOTION,)
    assert motion_of_record(scenario_record(MOTION)) == MOTION
    assert scenario_numbers(MOTION) == ["start_after 4 s", "path 3 rows"]
    path.write_text(GOOD.replace("    start_after: 4.0\n", ""))
    assert read_scenario(path) == (replace(MOTION, start_after=None),)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("start_after: 4.0", "start_after: -1", "my.yaml:7: start_after: is negative; give 0 to"),
        ("    path:", "    pth:", "my.yaml:8: pth: is not known; did you mean path?"),
        ("[1.0, 14.0, 2.0, -3.0]", "[1.0]", "my.yaml:10: path: has a row that is a list of"),
        ("[1.0, 14.0, 2.0, -3.0]", "x", "my.yaml:10: path: has a row that is 'x'; give 2"),
        ("[1.0, 14.0,", "[1.0, yes,", "my.yaml:10: path: is 'yes'; give -1e+07 to 1e+07 m"),
        ("[1.0, 14.0,", "[1.0, 1e8,", "my.yaml:10: path: is 1e+08; give -1e+07 to 1e+07 m"),
        ("[1.0, 14.0,", "[-1.0, 14.0,", "path: its times do not increase; give each row a later"),
        (GOOD[GOOD.index("    path:") :], "    path: 3\n", "my.yaml:8: path: is the number 3;"),
        (GOOD[GOOD.index("    - [1.0") :], "", "my.yaml:8: path: has 1 rows; give 2 rows"),
        (GOOD[GOOD.index("    path:") :], "", "my.yaml:6: path: is missing; give 2 rows"),
    ],
)  # fmt: skip
def test_errors_name_file_line_and_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    path = tmp_path / "my.yaml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_scenario(path)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_rollout_starts_when_the_target_says() -> None:
    ahead = ((0.0, 50.0, 0.0, 0.0), (5.0, 90.0, 0.0, 0.0))
    motion = TimedPath("a", ahead, 2.5)
    prepared = prepare(RolloutSetup(LOG, MOVING, motion, steps=20))
    assert prepared.start_timestamp_us == TIMES[0] + 2_500_000
    np.testing.assert_allclose(prepared.actor[[0, 20], 0], [50.0, 66.0], atol=1e-9)
    given = RolloutSetup(LOG, MOVING, motion, steps=20, start_timestamp_us=int(TIMES[10]))
    assert prepare(given).start_timestamp_us == TIMES[10]
    # Of a further actor it does not count.
    further = RolloutSetup(LOG, PARKED, replace(motion, start_after=1.0), steps=20)
    beside = replace(motion, path=((0.0, 30.0, -3.0, 0.0), (5.0, 40.0, -3.0, 0.0)))
    setup = replace(further, actors={MOVING: beside})
    assert prepare(setup).start_timestamp_us == TIMES[0] + 1_000_000
    rollout = run_rollout(setup, ConstantVelocity())
    assert rollout.steps_run == 20
    late = RolloutSetup(LOG, MOVING, replace(motion, start_after=99.0), steps=20)
    with pytest.raises(
        InputError, match="starts 99 s after the first ego pose, but the log has 20 s"
    ):
        prepare(late)
