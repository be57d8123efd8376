"""OpenSCENARIO: what is written is what was meant, and comes back."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, write_log
from recast.logs.hdmap import HdMap
from recast.logs.types import Track, Trajectory
from recast.planning import ConstantVelocity
from recast.simulation import (
    MOTIONS,
    Rollout,
    RolloutSetup,
    load_rollout,
    prepare,
    run_rollout,
    save_rollout,
)
from recast_bridges.openx import (
    Played,
    export_openx,
    largest_difference,
    played_rollout,
    played_scenario,
    read_openscenario,
    write_openscenario,
)
from recast_bridges.openx.opendrive import LeftOutLinks
from recast_bridges.openx.openscenario import Entity
from support.road_lanes import lane
from support.synthetic_drives import drive

ROUNDING = 1e-9  # metres, seconds: some ulps of a world of kilometres, and of angles at a box's end
HOSTILE = '"><x a="${b}" \x01\u2028&/ä\U0001f697\n%41'


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    """A climbing curve far from the origin, with a walker who is labelled for 2 s in between."""
    made = drive(seconds=12, curvature=0.01, slope=0.05, world_from_start=(2000.0, -900.0, 2.0))
    times = made.world_from_rig.timestamps_us[[30, 50]]
    poses = np.stack(
        [se3.from_rotation_translation(np.eye(3), [2000.0, y, 1.0]) for y in (-880, -878)]
    )
    walker = Track(HOSTILE, "pedestrian", np.array([0.5, 0.6, 1.8]), Trajectory(times, poses))
    return replace(made, tracks={**made.tracks, HOSTILE: walker})


@pytest.fixture(scope="module")
def rollout(log: DrivingLog) -> Rollout:
    setup = RolloutSetup(log, "7", MOTIONS["cut-in-a"], steps=80, traffic="replay")
    return run_rollout(setup, ConstantVelocity())


def test_a_rollout_comes_back(rollout: Rollout, log: DrivingLog, tmp_path: Path) -> None:
    played = played_rollout(rollout, log)
    write_openscenario(tmp_path / "a.xosc", played)
    back = read_openscenario(tmp_path / "a.xosc")
    metres, seconds = largest_difference(played, back)
    assert metres < ROUNDING and seconds == 0
    ego, target, *others = back.entities
    steps = rollout.steps_run
    assert np.allclose(ego.times, 0.1 * np.arange(steps + 1), 0, ROUNDING)
    assert np.allclose(ego.poses, rollout.world_from_rig, 0, ROUNDING)
    assert np.allclose(target.boxes, rollout.world_from_actor, 0, ROUNDING)
    assert np.allclose(target.size, rollout.actor_size) and target.category == "car"
    assert ego.track_id is None and target.track_id == "7"
    assert [one.track_id for one in others] == [HOSTILE] == list(rollout.other_actors)
    assert back.duration == pytest.approx(0.1 * steps)


def test_who_is_seen_for_a_while_comes_and_goes(
    rollout: Rollout, log: DrivingLog, tmp_path: Path
) -> None:
    played = played_rollout(rollout, log)
    ego, target, walker = played.entities
    seen = replace(walker, times=walker.times[10:31], poses=walker.poses[10:31])
    write_openscenario(tmp_path / "a.xosc", replace(played, entities=(ego, target, seen)))
    entities = read_openscenario(tmp_path / "a.xosc").entities
    back = next(one for one in entities if one.track_id == HOSTILE)
    assert np.allclose(back.times, seen.times, 0, ROUNDING)
    assert np.allclose(back.boxes, seen.boxes, 0, ROUNDING)
    root = ET.parse(tmp_path / "a.xosc").getroot()
    (deleted,) = root.findall("Storyboard/Init/Actions/GlobalAction/EntityAction")
    name = deleted.get("entityRef")
    assert name is not None and root.find(f".//Private[@entityRef='{name}']") is None
    events = root.findall(f".//Maneuver[@name='{name}-maneuver']/Event")
    assert [event.get("name") for event in events] == [
        f"{name}-appears",
        f"{name}-path",
        f"{name}-leaves",
    ]
    kinds = [e.tag for event in events[::2] for e in event.find(".//EntityAction") or ()]
    assert kinds == ["AddEntityAction", "DeleteEntityAction"]


def test_names_cannot_leave_their_attribute(
    rollout: Rollout, log: DrivingLog, tmp_path: Path
) -> None:
    played = replace(played_rollout(rollout, log), name=HOSTILE, description=HOSTILE)
    write_openscenario(tmp_path / "a.xosc", played, "map.xodr")
    text = (tmp_path / "a.xosc").read_text()
    assert "$" not in text and "<x" not in text and "\x01" not in text
    root = ET.fromstring(text)
    assert not root.findall(".//x")
    assert len(root.findall("Entities/ScenarioObject")) == len(played.entities)


def test_a_scenario_leaves_the_ego_to_be_driven(log: DrivingLog, tmp_path: Path) -> None:
    setup = RolloutSetup(log, "7", MOTIONS["cut-in-a"], steps=60)
    prepared, played = prepare(setup), played_scenario(setup)
    write_openscenario(tmp_path / "a.xosc", played)
    back = read_openscenario(tmp_path / "a.xosc")
    assert max(largest_difference(played, back)) < ROUNDING
    ego, target = back.entities
    assert len(ego.times) == 1 and ego.speed == pytest.approx(prepared.ego[3])
    assert np.allclose(ego.poses[0, :2, 3], prepared.ego[:2], 0, ROUNDING)
    assert np.allclose(target.boxes, prepared.world_from_actor, 0, ROUNDING)
    with pytest.raises(InputError, match="export a rollout"):
        played_scenario(RolloutSetup(log, "9", MOTIONS["idm-a"], steps=60))


def test_steep_and_banked_poses_come_back(tmp_path: Path) -> None:
    """Heading, pitch and roll of any turn, straight up too, where heading and roll are one."""
    rng = np.random.default_rng(1)
    poses = se3.exp(rng.normal(size=(50, 6)) * [100, 100, 10, 2, 2, 2])
    poses[0, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    size, centre = np.array([4.0, 2.0, 1.5]), np.array([1.2, 0.0, 0.75])
    car = Entity("1", "truck", size, centre, np.arange(50) * 0.1, poses, 3.0)
    played = Played("", "", 4.9, (car,))
    write_openscenario(tmp_path / "a.xosc", played)
    assert max(largest_difference(played, read_openscenario(tmp_path / "a.xosc"))) < 1e-7
    moved = replace(car, poses=car.poses @ se3.exp(np.array([0.3, 0, 0, 0, 0, 0])))
    assert largest_difference(played, replace(played, entities=(moved,)))[0] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("<OpenSCENARIO>", '<!DOCTYPE a [<!ENTITY b "c">]><OpenSCENARIO>', "DOCTYPE"),
        ("<OpenSCENARIO>", "<OpenSCENARIO><", "cannot be read"),
        ("OpenSCENARIO>", "OpenDRIVE>", "is OpenDRIVE"),
        ('name="ego"', 'name="track-7"', "given twice"),
        ('name="track-7"', 'name="elsewhere"', "not the name of a track"),
        ('time="0.1"', 'time="7"', "do not increase"),
        ('time="0.1"', 'time="$t"', "not 0 to"),
        ('time="0.1"', 'time="nan"', "not 0 to"),
        (' length="', ' length="-', "length"),
        ("<BoundingBox>", "<Other>", "cannot be read"),
        (' h="', ' g="', "lacks h"),
    ],
)
def test_broken_scenarios(
    rollout: Rollout, log: DrivingLog, tmp_path: Path, old: str, new: str, line: str
) -> None:
    write_openscenario(tmp_path / "a.xosc", played_rollout(rollout, log))
    text = (tmp_path / "a.xosc").read_text()
    assert old in text
    (tmp_path / "b.xosc").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=line):
        read_openscenario(tmp_path / "b.xosc")


def test_a_folder_is_written_and_compared(
    rollout: Rollout, log: DrivingLog, tmp_path: Path
) -> None:
    hdmap = HdMap({"a/1": lane("a/1", 0.6, (0, 0, 0.3))}, ())
    played = played_rollout(rollout, log)
    exported, roads = export_openx([played, played], hdmap, tmp_path / "out", "map")
    assert [one.file for one in exported] == [f"{rollout.name}.xosc", f"{rollout.name}-1.xosc"]
    assert all(one.metres < ROUNDING and one.entities == 3 for one in exported)
    assert roads is not None and (roads.lanes, roads.left_out) == (1, LeftOutLinks(0, 0))
    assert roads.metres < 0.01
    # Of lanes in OpenDRIVE, the centreline is the middle; this one has 2 m and 1.5 m beside it.
    assert roads.centreline_metres == pytest.approx(0.25, abs=0.01)
    root = ET.parse(tmp_path / "out" / exported[0].file).getroot()
    assert root.find("RoadNetwork/LogicFile[@filepath='map.xodr']") is not None
    assert (tmp_path / "out" / "map.xodr").is_file()
    assert export_openx([played], None, tmp_path / "none")[1] is None


def test_the_command(
    rollout: Rollout, log: DrivingLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_log(log, tmp_path / "log")
    save_rollout(rollout, tmp_path / "states")
    command = ["scenario", "export", str(tmp_path / "log"), "--out", str(tmp_path / "out")]
    assert main(command) == 2 and "rollout" in capsys.readouterr().err
    what = ["--motion", "cut-in-a", "--track", "7", "--steps", "60"]
    assert main([*command, *what, "--rollout", str(tmp_path / "states")]) == 0
    assert "road users; read back" in capsys.readouterr().out
    back = read_openscenario(tmp_path / "out" / f"{rollout.name}.xosc")
    own = played_rollout(load_rollout(tmp_path / "states"), log)
    assert max(largest_difference(own, back)) < 1e-3  # the log was stored in between
    assert (tmp_path / "out" / "cut-in-a.xosc").is_file()
