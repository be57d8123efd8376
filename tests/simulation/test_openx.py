"""OpenSCENARIO and OpenDRIVE: what is written is what was meant, and comes back."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_drives import drive

from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, write_log
from recast.logs.hdmap import HdMap, Lane
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
from recast.simulation.openx import (
    Played,
    export_openx,
    largest_difference,
    played_rollout,
    played_scenario,
    read_opendrive,
    read_openscenario,
    write_opendrive,
    write_openscenario,
)
from recast.simulation.openx.entities import Entity

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
    setup = RolloutSetup(log, "7", MOTIONS["cut-in-a"], steps=80, keep_other_actors=True)
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
    assert {one.track_id for one in others} == {"9", HOSTILE} == set(rollout.other_actors)
    assert back.duration == pytest.approx(0.1 * steps)


def test_who_is_seen_for_a_while_comes_and_goes(
    rollout: Rollout, log: DrivingLog, tmp_path: Path
) -> None:
    write_openscenario(tmp_path / "a.xosc", played_rollout(rollout, log))
    entities = read_openscenario(tmp_path / "a.xosc").entities
    walker = next(one for one in entities if one.track_id == HOSTILE)
    start = rollout.start_timestamp_us
    first, last = (walker.times[[0, -1]] * 1e6 + start).round().astype(int)
    there = log.tracks[HOSTILE].trajectory
    assert (first, last) == tuple(there.timestamps_us)
    assert np.allclose(walker.boxes[5], there.at(first + 500_000), 0, ROUNDING)
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


def lane(name: str, angle: float, start: tuple[float, float, float], **links: object) -> Lane:
    """30 m of a circle, or of a line, climbing; 2 m wide to the left and 1.5 m to the right."""
    s = np.linspace(0, 30, 16)
    heading = start[2] + angle * s / 30
    step = np.stack([np.cos(heading), np.sin(heading)], axis=1) * 2.0
    line = np.array(start[:2]) + np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    height = 0.05 * s[:, None] + 3
    sides = [np.c_[line + by * left, height] for by in (0, 2.0, -1.5)]
    outline = np.concatenate([sides[1][:, :2], sides[2][::-1, :2]])
    return Lane(name, *sides, outline, 13.9, **links)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def hdmap() -> HdMap:
    """One lane into another, which parts into two, of which one joins a third."""
    lanes = [
        lane("a/1", 0.0, (0, 0, 0.3), successors=("b&2",)),
        lane("b&2", 0.6, (28.66, 8.87, 0.3), successors=("c", "d")),
        lane("c", 0.5, (50, 30, 0.9), successors=("f",)),
        lane("d", -0.5, (50, 30, 0.9)),
        lane("e", 0.5, (90, 30, 0.9), successors=("f",)),
        lane("f", 0.0, (70, 55, 0.9)),
        lane("g", 0.0, (120, 30, 0.9), successors=("e",)),
    ]
    return HdMap({one.lane_id: one for one in lanes}, ())


def test_lanes_come_back(hdmap: HdMap, tmp_path: Path) -> None:
    assert write_opendrive(tmp_path / "a.xodr", hdmap, HOSTILE) == 0
    back = read_opendrive(tmp_path / "a.xodr")
    assert list(back) == list(hdmap.lanes)
    assert {key: one.successors for key, one in back.items()} == {
        key: own.successors for key, own in hdmap.lanes.items()
    }
    for key, own in hdmap.lanes.items():
        assert np.allclose(back[key].centreline, own.centreline, 0, ROUNDING)
        assert back[key].speed_limit == own.speed_limit
        # At right angles to the curve, while these boundaries lie so to their circle's chords.
        assert np.allclose(back[key].widths, [2.0, 1.5], 0, 0.02)


def test_lanes_that_part_and_join_lie_in_a_junction(hdmap: HdMap, tmp_path: Path) -> None:
    write_opendrive(tmp_path / "a.xodr", hdmap, "map")
    root = ET.parse(tmp_path / "a.xodr").getroot()
    (junction,) = root.findall("junction")
    number = junction.get("id")
    roads = {road.get("id"): road for road in root.findall("road")}
    inside = {road.get("name") for road in roads.values() if road.get("junction") == number}
    assert inside == {"c", "d", "e"} and number not in roads
    pairs = {(one.get("incomingRoad"), one.get("connectingRoad")) for one in junction}
    assert pairs == {("1", "2"), ("1", "3"), ("6", "4")}
    for name, tag in (("b%262", "successor"), ("g", "successor"), ("f", "predecessor")):
        link = root.find(f"road[@name='{name}']/link/{tag}")
        assert link is not None and link.get("elementId") == number


def test_what_parts_and_joins_at_once_is_left_out(hdmap: HdMap, tmp_path: Path) -> None:
    """A lane of a junction that parts again itself is an ordinary road."""
    lanes = dict(hdmap.lanes)
    lanes["c"] = replace(lanes["c"], successors=("f", "h"))
    lanes["h"] = lane("h", 0.0, (70, 80, 0.9))
    left_out = write_opendrive(tmp_path / "a.xodr", HdMap(lanes, ()), "map")
    back = read_opendrive(tmp_path / "a.xodr")
    kept = sum(len(one.successors) for one in back.values())
    assert left_out > 0 and kept + left_out == sum(len(o.successors) for o in lanes.values())
    assert all(set(one.successors) <= set(lanes[key].successors) for key, one in back.items())


def test_reference_lines_are_smooth(hdmap: HdMap, tmp_path: Path) -> None:
    """Each piece ends where and in the direction in which the next one begins."""
    write_opendrive(tmp_path / "a.xodr", hdmap, "map")
    for road in ET.parse(tmp_path / "a.xodr").getroot().findall("road"):
        pieces = road.findall("planView/geometry")
        ends = []
        for piece in pieces:
            poly = {k: float(v) for k, v in piece[0].attrib.items() if k != "pRange"}
            p = np.linspace(0, 1, 2001)
            u, v = (sum(poly[f"{c}{a}"] * p**i for i, c in enumerate("abcd")) for a in "UV")
            length = np.hypot(np.diff(u), np.diff(v)).sum()
            assert length == pytest.approx(float(piece.get("length", "")), rel=1e-6)
            turned = np.arctan2(v[-1] - v[-2], u[-1] - u[-2])
            ends.append(float(piece.get("hdg", "")) + turned)
        starts = [float(piece.get("hdg", "")) for piece in pieces]
        # The last of 2000 chords of a cubic that turns by 0.05 differs from its end by 1e-4.
        assert np.allclose(ends[:-1], starts[1:], 0, 1e-4)
        assert float(road.get("length", "")) == pytest.approx(
            sum(float(piece.get("length", "")) for piece in pieces)
        )


def test_a_folder_is_written_and_compared(
    rollout: Rollout, log: DrivingLog, hdmap: HdMap, tmp_path: Path
) -> None:
    played = played_rollout(rollout, log)
    exported, roads = export_openx([played, played], hdmap, tmp_path / "out", "map")
    assert [one.file for one in exported] == [f"{rollout.name}.xosc", f"{rollout.name}-1.xosc"]
    assert all(one.metres < ROUNDING and one.entities == 4 for one in exported)
    assert roads is not None and (roads.lanes, roads.links_left_out) == (7, 0)
    assert roads.metres < ROUNDING
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
