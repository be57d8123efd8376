from __future__ import annotations

from dataclasses import replace
from functools import partial
from threading import Lock

import numpy as np
import pytest

from recast.actors import Asset, BoxLidarSegmenter, Observation
from recast.actors.evidence import Evidence
from recast.actors.generate import VEHICLE, candidates_of
from recast.actors.observe import gather_evidence
from recast.actors.register import AutoGenerator, candidate_score, choose, register
from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig
from recast.splats import Gaussians
from support import made_up_actors as made_up


@pytest.fixture(scope="module")
def evidence(street: DrivingLog) -> Evidence:
    config = SceneConfig(scale=1.0, holdout_every=0)
    return gather_evidence(street, "7", segmenter=BoxLidarSegmenter(), config=config)


def asset_of(gaussians: Gaussians, seed: int = 0) -> Asset:
    return Asset(gaussians, VEHICLE, "made up", seed)


def no_vehicle() -> Asset:
    raise InputError("crop", "structure", "is empty", "take another seed")


def test_the_right_kind_of_vehicle_is_chosen(
    red_car: Gaussians, observation: Observation, street: DrivingLog, evidence: Evidence
) -> None:
    makers = [
        partial(asset_of, made_up.car(style="pickup"), 1),
        no_vehicle,
        partial(asset_of, red_car, 2),
        partial(asset_of, made_up.car(style="van"), 3),
    ]
    told: list[tuple[int, int]] = []
    choice = choose(
        makers, observation, street, evidence, lambda done, total: told.append((done, total))
    )
    assert choice.fits
    assert told[-1] == (4, 4)
    rows = choice.actor.provenance.candidates
    assert [row.chosen for row in rows] == [False, False, True, False]
    assert rows[1].score is None and "is empty" in rows[1].label
    assert choice.actor.provenance.seed == 2
    best = rows[2].score
    assert best is not None
    for row in (rows[0], rows[3]):
        assert row.score is not None and row.score.total < best.total


def test_only_the_chosen_sketch_is_finished(
    red_car: Gaussians, observation: Observation, street: DrivingLog, evidence: Evidence
) -> None:
    finished: list[int] = []

    def finish(seed: int) -> Asset:
        finished.append(seed)
        return asset_of(red_car, seed)

    def sketch(style: str, seed: int) -> Asset:
        return replace(asset_of(made_up.car(style=style), seed), finish=partial(finish, seed))

    makers = [partial(sketch, "van", 1), partial(sketch, "sedan", 2)]
    choice = choose(makers, observation, street, evidence)
    rows = choice.actor.provenance.candidates
    assert finished == [row.seed for row in rows if row.chosen]
    assert len(choice.actor.gaussians) == len(red_car)


def test_no_two_candidates_are_made_at_once(
    red_car: Gaussians, observation: Observation, street: DrivingLog, evidence: Evidence
) -> None:
    """A user's generator need not be made for threads, and what it raises ends the choice."""
    busy, made = Lock(), []

    def make(seed: int) -> Asset:
        assert busy.acquire(blocking=False)
        try:
            made.append(seed)
            if seed == 2:
                raise RuntimeError("out of memory")
            return asset_of(red_car, seed)
        finally:
            busy.release()

    with pytest.raises(RuntimeError, match="out of memory"):
        choose([partial(make, seed) for seed in range(4)], observation, street, evidence)
    assert made[:3] == [0, 1, 2]


def test_a_vehicle_that_does_not_fit_is_said_not_to(
    observation: Observation, street: DrivingLog, evidence: Evidence
) -> None:
    """A quarter of a car: the LiDAR met what is not there."""
    flat = made_up.car(size=made_up.SIZE * [1.0, 1.0, 0.5])
    choice = choose([partial(asset_of, flat)], observation, street, evidence)
    assert not choice.fits
    assert "does not fit" in choice.actor.provenance.candidates[0].cells()[-1]


def test_a_front_of_fog_or_of_another_paint_counts_against_a_candidate(
    red_car: Gaussians, observation: Observation, street: DrivingLog, evidence: Evidence
) -> None:
    """The log sees the rear: what it says of all three is the same."""
    front = red_car.means[:, 0] > 0.4
    wide = red_car.log_scales.clone()
    wide[front] = wide[front].clamp(min=-2.3)
    fog = replace(red_car, log_scales=wide)
    white = red_car.sh.clone()
    white[front, 0] = 1.4
    other = replace(red_car, sh=white)
    makers = [partial(asset_of, one, k) for k, one in enumerate((fog, other, red_car))]
    choice = choose(makers, observation, street, evidence)
    assert choice.actor.provenance.seed == 2
    scores = [row.score for row in choice.actor.provenance.candidates]
    assert scores[0] and scores[1] and scores[2]
    assert scores[0].detail < 0.7 * scores[2].detail
    assert scores[1].apart > scores[2].apart + 20


def test_no_candidate_at_all(
    observation: Observation, street: DrivingLog, evidence: Evidence
) -> None:
    with pytest.raises(InputError, match="is empty"):
        choose([no_vehicle, no_vehicle], observation, street, evidence)


def test_what_is_not_known_does_not_count(
    red_car: Gaussians, observation: Observation, street: DrivingLog
) -> None:
    actor = register(asset_of(red_car), observation, street, street.tracks["7"])
    nothing = np.zeros((0, 3), np.float32)
    from recast.actors.evidence import FreeSpace

    blind = Evidence("7", "car", made_up.SIZE, (), nothing, FreeSpace(nothing))
    score = candidate_score(actor, blind)
    assert (score.outline, score.colour, score.lidar) == (None, None, None)
    assert score.total == 0 and score.fits


def test_every_generator_offers_at_least_one(observation: Observation, red_car: Gaussians) -> None:
    class Two:
        name = "two"

        def candidates(self, observation: Observation, seed: int) -> list[partial[Asset]]:
            return [partial(asset_of, red_car, seed), partial(asset_of, red_car, seed + 1)]

        def generate(self, observation: Observation, seed: int) -> Asset:
            return asset_of(red_car, seed)

    class One:
        name = "one"

        def generate(self, observation: Observation, seed: int) -> Asset:
            return asset_of(red_car, seed)

    made = [make().seed for make in candidates_of(AutoGenerator((Two(), One())), observation, 5)]
    assert made == [5, 6, 5]
    assert [make().seed for make in candidates_of(One(), observation, 5)] == [5]
    assert AutoGenerator((One(), Two())).generate(observation, 9).seed == 9
