from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.metrics import rollout_metrics
from recast.reporting import NotMade, ReportInputs, RolloutPart, write_video
from recast.reporting.birdseye import Birdseye, MapLayer
from recast.reporting.moments import camera_towards, find_moments, moment_strip
from recast.reporting.page import Media, PageAssets
from recast.simulation.rollout import Rollout
from reporting.made_up_rollouts import cut_in, straight_map

ARMS = {"native": "Native", "recast": "Replaced", "oracle": "Truth"}


def part(rollout: Rollout, scored: bool = True) -> RolloutPart:
    metrics = rollout_metrics(rollout, straight_map()) if scored else NotMade()
    return RolloutPart(rollout.arm, rollout, metrics)


def with_brakes(arm: str, brake: float, at: int) -> Rollout:
    """Drives as `cut_in` does, and brakes from a step on."""
    rollout = cut_in(arm, steps=40, cut=False)
    time = np.maximum(np.arange(41) - at, 0) * 0.1
    ego = rollout.ego.copy()
    ego[:, 0] -= brake * time**2 / 2
    return dataclasses.replace(rollout, ego=ego)


def test_moments_are_where_the_formulas_put_them() -> None:
    parts = [part(cut_in("native", steps=40)), part(cut_in("recast", brake=1.5, steps=40))]
    found = {words: m.step for m in find_moments(parts, ARMS) for words in m.reasons}
    # The braking plan falls back by 0.75 t^2: 12 m at its end. The braking ego is behind by
    # 0.015 k (k - 1) / 2 metres after k steps: 0.42 m after 8, 0.54 m after 9.
    assert found["the plans diverge: Native and Replaced"] == 0
    assert found["the paths diverge: Native and Replaced"] == 9
    native = parts[0].metrics
    assert not isinstance(native, NotMade)
    assert found["contact: Native"] == native.collision.first_step == 23
    assert native.ttc.per_cycle[5] == 0.0, "after the contact, which is not the plan's fault"
    least = native.ttc.per_cycle[:5].min()
    assert found[f"worst plan, meets the actor after {least:.1f} s: Native"] == 20


def test_the_paths_part_between_the_first_pair_to_do_so() -> None:
    rollouts = [cut_in("native", steps=40), with_brakes("recast", 2.0, 20)]
    parts = [part(r, scored=False) for r in (*rollouts, with_brakes("oracle", 2.0, 10))]
    # 0.01 n^2 > 0.5 at n = 8 steps of braking
    [moment] = [m for m in find_moments(parts, ARMS) if "paths" in " ".join(m.reasons)]
    assert moment.step == 18 and moment.time == 1.8
    assert "the paths diverge: Native and Truth" in moment.reasons


def test_what_falls_together_is_one_moment_and_arms_that_agree_have_the_smallest_gap() -> None:
    far = cut_in("native", steps=20)
    far = dataclasses.replace(far, actor=far.actor + np.array([60.0, 0.0, 0.0, 0.0]))
    twins = [part(far), part(dataclasses.replace(far, arm="recast"))]
    [moment] = find_moments(twins, ARMS)
    gap = Birdseye(far, MapLayer(None)).curves.gap
    assert moment.step == int(np.argmin(gap))
    assert moment.reasons == (f"smallest gap, {gap.min():.1f} m: Native",)
    both = [part(cut_in(arm, steps=40)) for arm in ("native", "recast")]
    reasons = [words for m in find_moments(both, ARMS) for words in m.reasons]
    assert "contact: Native and Replaced" in reasons
    assert not any("part:" in words for words in reasons)


def test_rollouts_that_did_not_come_about_have_no_moments() -> None:
    assert find_moments([RolloutPart("native", NotMade("killed"))], ARMS) == ()


def test_the_camera_is_the_one_that_looks_there() -> None:
    headings = {"front": 0.0, "left": np.pi / 2, "rear": np.pi}
    assert camera_towards(headings, headings, 0.3) == "front"
    assert camera_towards(headings, headings, -3.0) == "rear"
    assert camera_towards(["a", "b"], {}) == "a"
    assert camera_towards([], headings) is None


def test_the_strip_shows_every_arm_at_every_moment(tmp_path: Path) -> None:
    greys = {"native": 40, "recast": 120}
    rollouts = {
        "native": cut_in("native", steps=40),
        "recast": cut_in("recast", brake=1.5, steps=12),  # ended before the contact
    }
    parts = []
    for arm, rollout in rollouts.items():
        films = {}
        for camera, more in (("left", 0), ("front", 60)):
            films[camera] = tmp_path / f"{arm}-{camera}.mp4"
            grey = np.full((48, 96, 3), greys[arm] + more, np.uint8)
            write_video(films[camera], [grey] * rollout.steps_run)
        parts.append(dataclasses.replace(part(rollout), films=films))
    run = ReportInputs("t", "l", ARMS, camera_headings={"left": 1.2, "front": 0.0})
    drawn = {arm: Birdseye(rollout, MapLayer(None)) for arm, rollout in rollouts.items()}
    strip = moment_strip(run, "cut-in", parts, drawn, PageAssets(tmp_path / "out"))
    assert strip.arms == (0, 1)
    assert {column.camera for column in strip.columns} == {"front"}
    last = strip.columns[-1]
    assert "contact: Native" in last.moment.reasons
    assert last.cells[0].tone == "bad" and last.cells[0].note.startswith("contact, ego 9.0 m/s")
    assert last.cells[1].camera == NotMade("this rollout ended at 1.2 s")
    for cell, grey in zip(strip.columns[0].cells, (100, 180), strict=True):
        assert isinstance(cell.camera, Media) and isinstance(cell.birdseye, Media)
        assert (cell.birdseye.width, cell.birdseye.height) == (560, 224)
        image = np.asarray(Image.open(tmp_path / "out" / cell.camera.url))
        assert image.mean() == pytest.approx(grey, abs=4)


def test_a_broken_film_says_so_in_its_cell(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("no film")
    rollout = cut_in("native", steps=40)
    parts = [dataclasses.replace(part(rollout), films={"front": tmp_path / "a.mp4"})]
    run = ReportInputs("t", "l", ARMS)
    strip = moment_strip(
        run, "x", parts, {"native": Birdseye(rollout, MapLayer(None))}, PageAssets(tmp_path / "out")
    )
    [camera] = {column.cells[0].camera for column in strip.columns}
    assert isinstance(camera, NotMade) and "cannot be decoded" in camera.reason
