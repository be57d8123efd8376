"""Vehicles beside the target that are made complete: which, and why others are not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.actors import load_actor
from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.logs.store import write_log
from recast.logs.types import VEHICLES
from recast.reconstruction import SceneConfig
from recast.runs.completion import CompletedVehicles, choose_completed, makeable

CONFIG = SceneConfig(scale=1.0)


def with_track(log: DrivingLog, key: str, **changes: object) -> DrivingLog:
    track = replace(log.tracks[key], **changes)  # type: ignore[arg-type]
    return replace(log, tracks={**log.tracks, key: track})


def moved(log: DrivingLog, key: str, metres: float) -> DrivingLog:
    path = log.tracks[key].trajectory
    poses = np.array(path.poses)
    poses[:, 1, 3] += metres
    return with_track(log, key, trajectory=replace(path, poses=poses))


def test_all_near_and_names(tiny_log: DrivingLog) -> None:
    wanted = CompletedVehicles(("1",))
    assert choose_completed(tiny_log, "0", ("all",), CONFIG) == wanted
    assert choose_completed(tiny_log, "0", ("near",), CONFIG) == wanted
    assert choose_completed(tiny_log, "0", ("1", "0", "all"), CONFIG) == wanted
    assert choose_completed(tiny_log, "0", (), CONFIG) == CompletedVehicles()
    [line] = wanted.explain()
    assert line == "complete beside the target: tracks 1; about a minute of CPU time each"
    assert CompletedVehicles().explain() == []


def test_who_is_far_away_is_not_near_and_who_is_seen_too_little_is_told(
    tiny_log: DrivingLog,
) -> None:
    far = moved(tiny_log, "1", 300.0)  # no point of the sweeps lies in its boxes there
    assert choose_completed(far, "0", ("near",), CONFIG) == CompletedVehicles()
    chosen = choose_completed(far, "0", ("all",), CONFIG)
    assert chosen.tracks == () and dict(chosen.left) == {
        "1": "it has 0 LiDAR points, fewer than 20"
    }
    assert chosen.explain() == [
        "track 1 stays as reconstructed: it has 0 LiDAR points, fewer than 20"
    ]
    with pytest.raises(InputError, match="track 1: it has 0 LiDAR points"):
        choose_completed(far, "0", ("1",), CONFIG)


def test_an_image_too_small_tells(tiny_log: DrivingLog) -> None:
    small = CONFIG.model_copy(update={"scale": 0.05})
    assert "in no image" in dict(choose_completed(tiny_log, "0", ("all",), small).left)["1"]


def test_people_are_completed_by_generators_that_make_them(tiny_log: DrivingLog) -> None:
    walker = with_track(tiny_log, "0", category="pedestrian", size=np.array([1.85, 1.28, 2.0]))
    assert choose_completed(walker, "1", ("all",), CONFIG).tracks == ("0",)
    told = dict(choose_completed(walker, "1", ("all",), CONFIG, ["template"]).left)
    assert told == {"0": "it is a pedestrian, which template does not make"}
    with pytest.raises(InputError, match="is a pedestrian, which template does not make"):
        choose_completed(walker, "1", ("0",), CONFIG, ["template"])
    with pytest.raises(InputError, match="track 9: is not in the log; give all, near, or one"):
        choose_completed(tiny_log, "0", ("9",), CONFIG)
    group = with_track(tiny_log, "1", category="pedestrian")
    assert "of a group" in dict(choose_completed(group, "0", ("all",), CONFIG).left)["1"]


def test_trailers_and_motorcycles_stay_and_are_told(tiny_log: DrivingLog) -> None:
    for category in ("trailer", "motorcyclist"):
        log = with_track(tiny_log, "1", category=category)
        chosen = choose_completed(log, "0", ("near",), CONFIG)
        assert chosen.tracks == ()
        assert chosen.left == (("1", f"it is a {category}, which auto does not make"),)
    waymo = with_track(tiny_log, "1", size=np.array([2.2, 0.8, 1.5]))  # its label is "vehicle"
    [(track, why)] = choose_completed(waymo, "0", ("all",), CONFIG).left
    assert (track, why) == ("1", "has a box of 2.20 x 0.80 x 1.50 m: a motorcycle?")
    twizy = with_track(tiny_log, "1", size=np.array([2.34, 1.2, 1.5]))
    [(_, why)] = choose_completed(twizy, "0", ("all",), CONFIG).left
    assert "seen too little" in why  # not by its box


def test_who_makes_whom() -> None:
    assert makeable(["auto"]) == ("car", "van", "truck", "bus", "pedestrian", "cyclist")
    assert makeable(["auto", "people"]) == ("pedestrian", "cyclist")
    assert makeable(["template"]) == ("car", "van", "truck", "bus")
    assert makeable(["template", "people"]) == ()
    assert makeable(["library:folder"]) == makeable(["./car.ply"]) == VEHICLES


@pytest.mark.parametrize(
    ("category", "generator"),
    [
        ("pedestrian", "template"),
        ("cyclist", "parametric"),
        ("misc", "auto"),
        ("car", "people"),
        ("trailer", "auto"),
        ("motorcyclist", "auto"),
    ],
)
def test_a_target_that_no_generator_makes_is_refused_before_anything_is_written(
    category: str,
    generator: str,
    tiny_log: DrivingLog,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_log(with_track(tiny_log, "0", category=category), tmp_path / "log")
    words = ["run", str(tmp_path / "log"), "--track", "0", "--planner", "idm-follower"]
    words += ["--generator", generator]
    assert main([*words, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert f"track 0: is {category}: {generator} makes" in said and said.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.whole
def test_a_run_with_everybody(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The parked van is complete, too, and stays where it stands; each is made once for the log."""
    words = ["run", str(tiny_log_folder), "--track", "0", "--motion", "advancing-a"]
    words += ["--steps", "10", "--iterations", "30", "--scale", "1", "--planner", "idm-follower"]
    words += ["--generator", "template", "--threads", "1", "--complete", "all"]
    for kind in ("none", "idm"):
        out = tmp_path / kind
        assert main([*words, "--traffic", kind, "--out", str(out)]) == 0
        assert "complete beside the target: tracks 1" in capsys.readouterr().out
        record = json.loads((out / "run.json").read_text())
        assert record["config"]["complete"] == ["all"]
        assert {"actor/replaced", "actor/replaced/1"} <= set(record["artefacts"])
        folder = out / "rollouts" / "advancing-a" / "idm-follower" / "replaced"
        states = json.loads((folder / "states" / "rollout.json").read_text())
        assert states["other_actors"] == (["1"] if kind == "idm" else [])
        page = (out / "report" / "index.html").read_text()
        assert "Complete, too" in page and ("Traffic" in page) == (kind == "idm")
    again = [record["artefacts"][f"actor/replaced{key}"] for key in ("", "/1")]
    first = json.loads((tmp_path / "none" / "run.json").read_text())["artefacts"]
    assert again == [first["actor/replaced"], first["actor/replaced/1"]]


@pytest.mark.whole
def test_a_run_with_a_complete_pedestrian(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pedestrian crosses, complete and walking; a cyclist of the traffic is complete, too."""
    words = ["log", "synth", "--scene", "urban-straight", "--seed", "51", "--people"]
    words += ["--seconds", "5", "--width", "240", "--height", "160", "--workers", "1"]
    assert main([*words, "--out", str(tmp_path / "log")]) == 0
    words = ["run", str(tmp_path / "log"), "--track", "pedestrian-5", "--motion", "crossing-a"]
    words += ["--steps", "20", "--iterations", "150", "--planner", "idm-follower", "--threads", "1"]
    words += ["--complete", "cyclist-1", "--traffic", "replay"]
    assert main([*words, "--out", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().out
    assert "complete beside the target: tracks cyclist-1" in said
    assert "person of track pedestrian-5 by auto" in said
    for name, category in (("replaced", "pedestrian"), ("replaced~~cyclist-1", "cyclist")):
        actor = load_actor(tmp_path / "run" / "actors" / name / "actor")
        assert actor.gait is not None and actor.provenance.generator == "people"
        assert actor.category == category
    films = tmp_path / "run" / "report" / "films"
    assert any("replaced" in film.name for film in films.iterdir())
