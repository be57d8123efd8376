"""Logs that no vehicle can have recorded are refused, odd ones told, good ones left alone."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog, OddLogWarning, load_log, plausibility, read_log, write_log
from recast.logs.plausibility import examined
from recast.synthetic import make_world
from support.mutated_logs import CORRECTED, GOOD, REFUSED, TOLD, drive


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    """A good drive."""
    return drive()


def assert_silent(log: DrivingLog) -> None:
    """Nothing is refused, changed or told."""
    assert examined(log, Path("data")) is log
    assert plausibility(log).warnings == ()


@pytest.mark.parametrize("fault", REFUSED)
def test_what_cannot_be_is_refused_with_the_likely_mistake(log: DrivingLog, fault: str) -> None:
    mutate, words = REFUSED[fault]
    with pytest.raises(InputError) as caught:
        examined(mutate(log), Path("data"))
    assert re.search(words, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fault", TOLD)
def test_what_is_odd_is_told(log: DrivingLog, fault: str) -> None:
    mutate, words = TOLD[fault]
    told = plausibility(examined(mutate(log), Path("data"))).warnings
    assert any(re.search(words, sentence) for sentence in told), told


@pytest.mark.parametrize("fault", CORRECTED)
def test_what_is_certain_is_corrected_and_told(log: DrivingLog, fault: str) -> None:
    result = examined(CORRECTED[fault](log), Path("data"))
    for name, track in log.tracks.items():
        poses = result.tracks[name].trajectory.poses
        np.testing.assert_allclose(poses, track.trajectory.poses, atol=1e-12)
    assert {n: one.camera for n, one in result.cameras.items()} == {
        n: one.camera for n, one in log.cameras.items()
    }
    assert any("corrected at import" in told for told in plausibility(result).warnings)


@pytest.mark.parametrize("kind", GOOD)
def test_unusual_drives_are_left_alone(kind: str) -> None:
    assert_silent(GOOD[kind]())


def test_twenty_drives_are_left_alone() -> None:
    rng = np.random.default_rng(41)
    for seed in range(20):
        turn, grade = rng.uniform(-0.2, 0.2), rng.uniform(-0.1, 0.1)
        heading = rng.uniform(-np.pi, np.pi)
        assert_silent(drive(seed, rng.uniform(0.0, 25.0), turn, grade=grade, heading=heading))


@pytest.mark.slow
@pytest.mark.parametrize(
    "street",
    [
        "urban-straight",
        "suburban-curve",
        "signalled-intersection",
        "rural-two-lane",
        "arterial-median",
        "parked-street",
        "roundabout-approach",
        "industrial",
        "underpass",
    ],
)
def test_synthetic_streets_are_left_alone(street: str) -> None:
    from dataclasses import replace

    from recast.logs import Track

    world = make_world(street, 3, 8.0, people=True)
    tracks = {
        name: Track(name, one.model.category, one.model.size, one.trajectory)
        for name, one in world.vehicles.items()
    }
    bare = replace(drive(), cameras={}, lidars={}, tracks=tracks, world_from_rig=world.ego)
    assert_silent(bare)


def test_recorded_drives_are_left_alone(shared: Path) -> None:
    data = shared / "data"
    val = data / "argoverse2" / "val"
    ids = ("3bffdcff-c3a7-38b6-a0f2-64196d130958", "7fab2350-7eaf-3b7e-a39d-6937a4c1bede")
    labels = {ids[0]: {"labels": val / ids[0] / "annotations_with_ego.feather"}}
    logs = [
        *(load_log(val, importer="argoverse2", drive=key, **labels.get(key, {})) for key in ids),
        load_log(data / "waymo_v1", importer="waymo", drive="motion_data_one_scenario"),
        load_log(data / "waymo_v1", importer="waymo", drive="pvps_data_one_frame"),
    ]
    for one in logs:
        assert plausibility(one).warnings == ()


def test_every_way_to_a_log_asks(log: DrivingLog, tmp_path: Path) -> None:
    leaning, _ = REFUSED["ego quaternions xyzw"]
    with pytest.raises(InputError, match=r"leans by \d+ degrees from the world's up"):
        load_log(leaning(log))
    with pytest.raises(InputError, match="leans by"):
        load_log(tmp_path, importer=lambda root, drive: leaning(log), drive="any")
    with pytest.raises(InputError, match="leans by"):
        write_log(leaning(log), tmp_path / "log")
    assert not (tmp_path / "log").exists()
    wide, words = TOLD["length and width exchanged"]
    with pytest.warns(OddLogWarning, match=words):
        load_log(tmp_path, importer=lambda root, drive: wide(log), drive="any")
    write_log(wide(log), tmp_path / "log")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_log(tmp_path / "log")
    with pytest.warns(OddLogWarning, match=words):
        load_log(tmp_path / "log")


def test_a_gap_of_decades_takes_no_memory(log: DrivingLog) -> None:
    trajectory = log.world_from_rig
    times = trajectory.timestamps_us.copy()
    times[-1] += 1_700_000_000_000_000
    stretched = replace(log, world_from_rig=replace(trajectory, timestamps_us=times))
    assert plausibility(stretched, sensors=False).figures.speed < 20.0
