"""What the first screen says: the scenario that tells most, in a sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from recast.actors.actor import Coverage
from recast.metrics import rollout_metrics
from recast.metrics.trust import SIGHTLESS, RolloutTrust, TrustFeatures
from recast.reporting import NotMade, ReportInputs, RolloutPart, ScenarioPart
from recast.reporting.finding import RunFinding, endings, finding
from recast.reporting.summary import vehicles
from recast.simulation import Rollout
from recast.simulation.scene_renderer import ImageCoverage, RolloutCoverage
from reporting.made_up_rollouts import cut_in, straight_map

ARMS = {
    "native": "reconstructed vehicle",
    "replaced": "replaced vehicle",
    "oracle": "true vehicle",
}


def part(arm: str, brake: float) -> RolloutPart:
    """A rollout of 3 s; the ego collides if it does not brake."""
    rollout = cut_in(arm, steps=30, brake=brake, cut=False)
    return RolloutPart(arm, rollout, rollout_metrics(rollout, straight_map()))


def run(*scenarios: ScenarioPart, truth: str | None = "oracle") -> ReportInputs:
    return ReportInputs("Car 0", "log", ARMS, scenarios=scenarios, truth_arm=truth)


def scenario(title: str, **brakes: float) -> ScenarioPart:
    return ScenarioPart(title, "", tuple(part(arm, brake) for arm, brake in brakes.items()))


APART = scenario("Apart", native=0.0, replaced=6.0, oracle=6.0)
ALIKE = scenario("Alike", native=6.0, replaced=6.0, oracle=6.0)
WRONG = scenario("Wrong", native=0.0, replaced=0.0, oracle=6.0)
FEATURES = TrustFeatures({}, {}, 10, 20, None, None)


def test_arms_that_end_alike_are_named_together() -> None:
    told = endings(APART, ARMS)
    hit = APART.rollouts[0].metrics
    assert not isinstance(hit, NotMade) and hit.contact_speed is not None
    assert told.startswith(
        f"Apart: with the reconstructed vehicle, idm-lane-follower collides at "
        f"{hit.contact_speed:.1f} m/s (at fault); with the replaced and the true vehicle, it "
    )
    assert told.count("with the") == 2 and told.endswith(", without contact.")


def test_numbers_are_told_for_each_arm_where_they_differ() -> None:
    several = scenario("S", native=6.0, replaced=5.0)
    told = endings(several, ARMS)
    assert told.count(" and ") == 2 and "the reconstructed and the replaced vehicle" in told


def test_the_scenario_that_depends_on_the_vehicle_tells_most() -> None:
    found = finding(run(ALIKE, WRONG, APART))
    assert found is not None and found.scenario == 2
    assert "Only the replaced vehicle gives the true verdict: no collision." in (found.sentences[0])
    assert found.sentences[1] == (
        "Scenarios with the true verdict (collision or not): 1 of 3 with the reconstructed "
        "vehicle, 2 of 3 with the replaced vehicle."
    )
    metrics = APART.rollouts[0].metrics
    assert not isinstance(metrics, NotMade) and metrics.collision.first_step is not None
    assert found.step == metrics.collision.first_step - 10
    assert found.moment == "1 s before the contact with the reconstructed vehicle"


def test_the_moment_is_one_at_which_a_camera_shows_the_vehicle_with_every_arm() -> None:
    native, replaced, oracle = APART.rollouts
    assert isinstance(replaced.rollout, Rollout)
    turned = replaced.rollout.ego.copy()
    turned[8:, 2] += 0.5  # from step 8 on, it steers past
    drive = Rollout(**{**vars(replaced.rollout), "ego": turned})
    passing = replace(replaced, rollout=drive, metrics=rollout_metrics(drive, straight_map()))
    found = finding(run(replace(APART, rollouts=(native, passing, oracle))))
    assert found is not None and found.step == 7
    hit = native.metrics
    assert not isinstance(hit, NotMade) and hit.collision.first_step is not None
    before = f"{(hit.collision.first_step - 7) / 10:g} s before the contact"
    assert found.moment == f"{before} with the reconstructed vehicle"


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (ALIKE, "The verdict is the true one: no collision."),
        (WRONG, "The true verdict is another one: no collision."),
    ],
)
def test_what_a_verdict_means(shown: ScenarioPart, words: str) -> None:
    found = finding(run(shown))
    assert found is not None and found.sentences[-1].endswith(words)


def test_without_a_truth_nobody_is_right() -> None:
    found = finding(run(APART, truth=None))
    assert found is not None
    assert found.sentences[0].endswith("a recording has no truth to decide by.")


def test_of_scenarios_alike_the_one_that_shows_most_that_is_invented() -> None:
    covered = RolloutCoverage((ImageCoverage("front", 0, True, Coverage(100.0, 0.2, 0.1, 0.7)),))
    native, replaced, oracle = ALIKE.rollouts
    second = replace(ALIKE, rollouts=(native, replace(replaced, coverage=covered), oracle))
    found = finding(run(ALIKE, second))
    assert found is not None and found.scenario == 1
    nearest = found.step
    assert 0 < nearest <= 30 and found.moment.startswith("the smallest gap, ")


def test_a_planner_without_eyes_is_told_first() -> None:
    blind = tuple(replace(one, trust=SIGHTLESS) for one in ALIKE.rollouts[:2])
    found = finding(run(replace(ALIKE, rollouts=blind), truth=None))
    assert found is not None and "uses no images" in found.sentences[0]
    assert found.trust == ""


def test_trust_is_never_told_as_certain_and_says_that_it_is_provisional(tmp_path: Path) -> None:
    values = {"native": 0.993, "replaced": 0.714}
    judged = [
        replace(one, trust=RolloutTrust(values[one.arm], "", {}, FEATURES, True))
        for one in ALIKE.rollouts[:2]
    ]
    found = finding(run(replace(ALIKE, rollouts=tuple(judged)), truth=None))
    assert found is not None and found.provisional
    assert found.trust == "reconstructed vehicle over 0.99, replaced vehicle 0.71"
    found.write(tmp_path)
    assert RunFinding.read(tmp_path) == found
    assert RunFinding.read(tmp_path / "other") is None


def test_a_run_without_rollouts_has_no_finding() -> None:
    assert finding(run()) is None
    nothing = ScenarioPart("S", "", (RolloutPart("native", NotMade("why"), NotMade("why")),))
    assert finding(run(nothing)) is None


def test_labels_in_a_sentence() -> None:
    assert vehicles(["replaced vehicle"]) == "the replaced vehicle"
    assert vehicles(["replaced vehicle", "omnire"]) == "replaced vehicle and omnire"


def test_an_actor_behind_is_not_what_the_ego_stops_for() -> None:
    stopped = cut_in("native", steps=30, brake=6.0, cut=False)
    for x, words in ((30.0, "stops 17 m before the vehicle"), (-20.0, "comes within ")):
        actor = stopped.actor.copy()
        actor[:] = x, 0.0, 0.0, 0.0
        standing = replace(stopped, actor=actor)
        metrics = rollout_metrics(standing, straight_map())
        one = ScenarioPart("S", "", (RolloutPart("native", standing, metrics),))
        assert words in endings(one, ARMS)
        walker = replace(standing, category="pedestrian")
        part = RolloutPart("native", walker, rollout_metrics(walker, straight_map()))
        told = endings(ScenarioPart("S", "", (part,)), {"native": "reconstructed pedestrian"})
        assert words.replace("vehicle", "pedestrian") in told
        assert "with the reconstructed pedestrian, " in told
