"""The paper's experiments as they ship: arms, sizes, segments, and the rule for targets."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.metrics.scene_level_images import COLUMNS
from recast.metrics.scene_level_table import PUBLISHED
from recast.runs.arms import parse_arms
from recast.runs.config import resolve_config
from recast.studies import parse_scenes
from recast.studies.grid import PAPER_SEGMENTS, choose_target


def test_the_seven_arms() -> None:
    arms = parse_arms(["paper"])
    assert [arm.name for arm in arms] == list(PUBLISHED)
    assert {arm.street for arm in arms} == {"streetgs", "omnire"}
    assert [arm.name for arm in arms if not arm.generates] == ["streetgs", "omnire"]
    assert all(arm.refine is False for arm in arms if arm.generates)
    assert all(set(values) <= set(COLUMNS) for values in PUBLISHED.values())


def test_the_sizes_reach_both_streets() -> None:
    config = resolve_config("1", (), Path("paper"), None, {"arms": ["paper"]}, {})
    assert (config.planners, config.steps, config.plan_every) == (("gtrs-dense",), 160, 5)
    assert len(config.motions) == 6
    for name in ("streetgs", "omnire"):
        street = config.street(name)
        assert (street.iterations, street.scale) == (30_000, 0.5)
        assert street.cameras == ("front_left", "front", "front_right")
    smaller = resolve_config("1", (), Path("paper"), None, {}, {"iterations": 2000})
    assert smaller.street("omnire").iterations == 2000


def test_nine_segments() -> None:
    assert list(PAPER_SEGMENTS) == ["002", "011", "034", "046", "137", "152", "161", "162", "177"]
    assert len(set(PAPER_SEGMENTS.values())) == 9


def test_the_target_is_the_vehicle_that_most_images_show(
    tiny_log: DrivingLog, tiny_log_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = {"0": 3, "1": 5}
    monkeypatch.setattr("recast.studies.grid.modelled_tracks", lambda log, config: {"0", "1"})
    monkeypatch.setattr(
        "recast.studies.grid.logged_frames", lambda log, track, cameras, rule: [None] * shown[track]
    )
    assert choose_target(tiny_log) == "1"
    [scene] = parse_scenes([f"{tiny_log_folder}:auto"], 0)
    assert scene.track == "1"
    shown["0"] = 5
    assert choose_target(tiny_log) == "0"  # of equals, the first by id
    shown |= {"0": 0, "1": 0}
    with pytest.raises(InputError, match="no vehicle is seen well enough"):
        choose_target(tiny_log)
