from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from recast.metrics import COLUMNS, rollout_metrics
from recast.reporting import NotMade, RolloutPart, ScenarioPart, tables
from recast.reporting.inputs import ReportInputs
from recast.reporting.plots import series
from recast.reporting.summary import (
    checks,
    driving_note,
    headline,
    outcomes,
    rollout_events,
    same_endings,
    truth_gaps,
)
from recast.scene.street_scene import ViewGaps
from recast.simulation import RolloutFailure
from recast.simulation.scene_renderer import RolloutGaps
from reporting.made_up_rollouts import cut_in, straight_map

ARMS = {"native": "Native", "recast": "Replaced"}


def scenario(setting: str = "a") -> ScenarioPart:
    parts = []
    for rollout in (cut_in("native", steps=40), cut_in("recast", steps=40, brake=1.5, cut=False)):
        rollout = dataclasses.replace(rollout, setting=setting)
        metrics = rollout_metrics(rollout, straight_map())
        parts.append(RolloutPart(rollout.arm, rollout, metrics))
    return ScenarioPart("Cut-in", "", tuple(parts))


def cell(line: tables.Line, key: str) -> tables.TableCell:
    return line.cells[list(COLUMNS).index(key)]


def test_every_metric_has_a_definition() -> None:
    assert set(tables.DEFINITIONS) == set(COLUMNS)
    assert all(heading.definition for heading in tables.headings())


def test_a_collision_is_told_as_one() -> None:
    native, recast = scenario().rollouts
    assert not isinstance(native.metrics, NotMade) and not isinstance(recast.metrics, NotMade)
    line = tables.rollout_line("Native", 0, native.metrics)
    assert cell(line, "nc").text == "fail" and cell(line, "nc").tone == "bad"
    assert "2.3 s" in (cell(line, "nc").note or "")
    assert cell(line, "ttc").text == "0.00\u00a0s" and cell(line, "ttc").tone == "bad"
    line = tables.rollout_line("Replaced", 1, recast.metrics)
    assert cell(line, "nc").text == "pass" and cell(line, "nc").tone == "good"


def test_without_a_map_dac_has_no_number_but_a_reason() -> None:
    metrics = rollout_metrics(cut_in(steps=10), None)
    dac = cell(tables.rollout_line("Native", 0, metrics), "dac")
    assert dac.text == "-" and "drivable" in (dac.note or "")


def test_aggregate_counts_and_differences() -> None:
    scenarios = [scenario("a"), scenario("b")]
    native, recast, difference = tables.aggregate_lines(scenarios, ARMS)
    assert cell(native, "nc").text == "0 of 2"
    assert cell(recast, "nc").text == "2 of 2"
    assert cell(difference, "nc").text == "+100.0\u00a0points"
    assert "2 cut short" in (native.sub or "") and "cut" not in (recast.sub or "")
    assert native.sub == "idm-lane-follower; 2 of 2 rollouts scored, 16 plans, 2 cut short"
    assert difference.sub == "mean over 2 of 2 pairs, 16 plans each"


def test_failed_and_cut_rollouts_are_told_and_pairs_end_together() -> None:
    # In b native is cut before the contact at step 23 that it would have had, in c it failed.
    planner = "idm-lane-follower"
    failure = RolloutFailure("x", "native", "0", "cut-in", "c", planner, "ValueError", "no plan")
    scenarios = [
        scenario("a"),
        ScenarioPart("b", "", (part("native", "b", 20), part("recast", "b", 40))),
        ScenarioPart("c", "", (RolloutPart("native", failure), part("recast", "c", 40))),
    ]
    native, recast, difference = tables.aggregate_lines(scenarios, ARMS)
    assert (
        native.sub == "idm-lane-follower; 2 of 3 rollouts scored, 12 plans, 2 cut short, 1 failed"
    )
    assert recast.sub == "idm-lane-follower; 3 of 3 rollouts scored, 24 plans, 2 cut short"
    assert cell(native, "nc").text == "1 of 2"  # as far as it went
    # a: +1; b: neither has a contact in the first 20 steps
    assert cell(difference, "nc").text == "+50.0\u00a0points"
    assert difference.sub == "mean over 2 of 3 pairs, 12 plans each, 1 compared only up to a cut"
    told = " ".join(headline(ReportInputs("t", "drive 13", ARMS, scenarios=tuple(scenarios))))
    assert "Native: 1 of 2 (2 cut short, 1 failed)" in told


def part(arm: str, setting: str, steps: int) -> RolloutPart:
    rollout = dataclasses.replace(cut_in(arm, steps=steps), setting=setting)
    return RolloutPart(arm, rollout, rollout_metrics(rollout, straight_map()))


def test_events_name_time_and_cause() -> None:
    native, recast = scenario().rollouts
    events = rollout_events(native, series(native.rollout))  # type: ignore[arg-type]
    contact = next(event for event in events if event.text.startswith("contact"))
    assert np.isclose(contact.time, 2.3) and contact.tone == "bad"
    assert any("recorded road ends" in event.text for event in events)
    assert [event.time for event in events] == sorted(event.time for event in events)
    events = rollout_events(recast, series(recast.rollout))  # type: ignore[arg-type]
    assert not any(event.tone == "bad" for event in events)
    assert any("smallest gap" in event.text for event in events)


def test_outcomes_headline_and_checks() -> None:
    run = ReportInputs("t", "drive 13", ARMS, scenarios=(scenario(),), hd_map=straight_map())
    [(title, (native, recast))] = outcomes(run)
    assert title == "Cut-in"
    assert native.tone == "bad" and native.text == "contact at 2.3 s; cut at 4.0 s"
    assert recast.tone == "good" and recast.text.startswith("no contact, smallest gap")
    told = " ".join(headline(run))
    assert "drive 13" in told and "Native: 0 of 1" in told and "Replaced: 1 of 1" in told
    by_name = {check.name: check for check in checks(run)}
    assert by_name["Map"].tone == "warn"
    assert by_name["Rollouts"].found == "1 of 2 ran their full length"
    assert by_name["Held-out images"].found == "not evaluated"


def with_truth() -> tuple[ReportInputs, ScenarioPart]:
    """Both arms and a truth that drives as the second does, only a little harder."""
    first = scenario()
    rollout = cut_in("oracle", steps=40, brake=1.6, cut=False)
    truth = RolloutPart("oracle", rollout, rollout_metrics(rollout, straight_map()))
    part = dataclasses.replace(first, rollouts=(*first.rollouts, truth))
    arms = {**ARMS, "oracle": "truth"}
    return ReportInputs("t", "l", arms, scenarios=(part,), truth_arm="oracle"), part


def test_same_driving_is_noticed() -> None:
    assert driving_note(scenario(), ARMS) is None
    first = scenario().rollouts[0]
    twin = dataclasses.replace(first, arm="recast")
    note = driving_note(ScenarioPart("Cut-in", "", (first, twin)), ARMS)
    assert note is not None and "exactly alike with all arms" in note
    assert driving_note(ScenarioPart("Cut-in", "", (first,)), ARMS) is None
    run, part = with_truth()
    alike = dataclasses.replace(part.rollouts[1], arm="oracle")
    some = dataclasses.replace(part, rollouts=(*part.rollouts[:2], alike))
    assert driving_note(some, run.arms) == "The ego drove exactly alike with Replaced and truth."


def test_the_truth_measures_and_is_not_judged() -> None:
    run, part = with_truth()
    *_, between, native, recast = tables.aggregate_lines([part], run.arms, "oracle")
    assert between.label == "Replaced minus Native"
    assert native.label == "Native minus truth" and recast.label == "Replaced minus truth"
    assert (native.sub or "").startswith("gap to the truth")
    assert cell(recast, "nc").tone == "good" and cell(native, "nc").tone == "plain"
    assert cell(native, "dac").tone == cell(recast, "dac").tone == "plain"  # equal: nobody wins
    [(_, (_, _, truth))] = outcomes(run)
    assert truth.tone == "plain"
    assert "Native and Replaced, and with truth" in " ".join(headline(run))
    [told] = same_endings(run, [part], "oracle")
    assert told.endswith("(collision or not): 0 of 1 with Native, 1 of 1 with Replaced.")


def test_gap_to_the_truth_is_the_distance_between_the_egos() -> None:
    run, part = with_truth()
    truth, native = part.rollouts[2].rollout, part.rollouts[0].rollout
    away = np.abs(truth.ego[:, 0] - native.ego[:, 0])  # type: ignore[union-attr]
    told = truth_gaps(run, part)
    assert told is not None
    assert f"Native {away.mean():.2f} m on average, {away.max():.2f} m at most" in told
    assert truth_gaps(dataclasses.replace(run, truth_arm=None), part) is None


@pytest.mark.parametrize(("worst", "tone"), [(0.02, "good"), (0.05, "warn"), (0.1, "bad")])
def test_the_worst_moment_of_all_rollouts_says_how_much_no_image_shows(
    worst: float, tone: str
) -> None:
    few, most = ViewGaps(0.001, 0.001), ViewGaps(worst - 0.005, 0.005)
    parts = [
        dataclasses.replace(part("native", "a", 40), gaps=RolloutGaps(few, few, 0.5)),
        dataclasses.replace(part("recast", "a", 40), gaps=RolloutGaps(few, most, 1.5)),
    ]
    run = ReportInputs("t", "l", ARMS, scenarios=(ScenarioPart("a", "", tuple(parts)),))
    by_name = {check.name: check for check in checks(run)}
    check = by_name["Street that no image shows, at most"]
    assert check.tone == tone and check.found == f"{worst:.1%} (0.5% empty), 1.5 s after the start"
    none = dataclasses.replace(run, scenarios=(ScenarioPart("a", "", (part("native", "a", 40),)),))
    assert not any("no image shows" in one.name for one in checks(none))
