"""AlpaSim's scene score by hand; docs/metrics.md has the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.geometry import se2
from recast.logs.hdmap import HdMap
from recast.simulation.rollout import ControlledActor
from recast_bridges.scores.simulators import alpasim_scene_score, off_road
from support.made_up_rollouts import make_rollout, moved_map, moved_rollout, street
from support.straight_road import hd_road

SIZE = np.array([4.0, 2.0, 1.5])
EGO = (5.176, 2.297)


def path_of(x=0.0, y=0.0, heading=0.0, speed=0.0, states=81):
    path = np.tile([x, y, heading, abs(speed)], (states, 1))
    path[:, 0] += speed * 0.1 * np.arange(states)
    return path


def drive(share=1.0, actor=None, other=None, y=None, **changes):
    """80 steps along 80 recorded metres, of which the ego drives a share."""
    ego = np.zeros((81, 11))
    ego[:, 0] = share * np.arange(81.0)
    if y is not None:
        ego[:, 1] = y
    log = path_of(speed=10.0)
    further = ()
    if other is not None:
        further = (
            ControlledActor("8", "car", "m", "a", other, se2.to_se3(other[:, :3], 0.8), SIZE),
        )
    actor = path_of(300.0) if actor is None else actor
    values = {"log_ego": log, "actor_size": SIZE, "controlled": further, **changes}
    return make_rollout(ego, actor, **values)


def score(rollout, hd_map=None, **options):
    return alpasim_scene_score(rollout, hd_map or street(20.0, 400.0), **options)


@pytest.mark.parametrize(
    ("share", "value"), [(1.0, 1.0), (0.8, 1.0), (0.5, 0.625), (0.0, 0.0), (1.5, 1.0)]
)
def test_progress(share, value):
    found = score(drive(share))
    assert found.progress == pytest.approx(min(share, 1.0))
    assert found.score.value == pytest.approx(value)


def test_a_short_recording_asks_for_no_progress():
    found = score(drive(0.0, log_ego=path_of(speed=0.62)))  # 4.96 m
    assert (found.score.value, found.progress) == (1.0, 0.0)
    assert score(drive(0.0, log_ego=path_of(speed=0.63))).score.value == 0.0
    assert score(drive(0.0, log_ego=path_of())).score.value == 1.0  # it stood


@pytest.mark.parametrize(
    ("actor", "value", "fault"),
    [
        (path_of(42.0), 0.0, True),  # met with the front bumper
        (path_of(-10.0, speed=14.0), None, False),  # runs into the rear
        (path_of(1.0, 2.0, speed=10.0), 0.0, True),  # alongside: neither bumper
        (path_of(1.0, 3.0, speed=10.0), 1.0, None),
    ],
)
def test_at_fault_by_bumpers(actor, value, fault):
    found = score(drive(actor=actor))
    if fault is None:
        assert not found.contact.any()
        return
    step = int(np.argmax(found.contact))
    assert bool(found.at_fault[step]) is fault
    assert found.last_step == step
    # Without fault the rollout ends there all the same, with the progress made so far.
    assert found.score.value == pytest.approx(step / 80 / 0.8 if value is None else value)


def test_of_several_contacts_the_last_decides_as_in_alpasim():
    # At step 36 the ego's bumpers are at 40.05 and 34.87 m: both actors are touched then. The one
    # behind gains 0.4 m a step.
    front, rear = path_of(42.0), path_of(32.9 - 1.4 * 36, speed=14.0)
    first = score(drive(actor=front, other=rear))
    assert first.last_step == 36
    assert first.contact[36]
    assert not first.contact[35]
    assert first.score.value == pytest.approx(36 / 80 / 0.8)
    assert score(drive(actor=rear, other=front)).score.value == 0.0
    for actor, other in ((front, rear), (rear, front)):
        assert score(drive(actor=actor, other=other), last_contact_only=False).score.value == 0.0


def test_nothing_counts_after_the_ego_is_four_metres_away():
    aside = np.zeros(81)
    aside[40:] = 4.0
    wall = path_of(62.0, 4.0)
    found = score(drive(actor=wall, y=aside))
    assert (found.last_step, found.score.value) == (40, pytest.approx(0.5 / 0.8))
    aside[40:] = 3.99
    found = score(drive(actor=path_of(62.0, 3.99), y=aside))
    assert found.score.value == 0.0
    assert found.score.reason == "collision at fault at step 56"


def test_the_step_of_an_event_still_counts():
    aside = np.zeros(81)
    aside[56:] = 4.0  # away in the step of the contact
    assert score(drive(actor=path_of(62.0, 4.0), y=aside)).score.value == 0.0


def test_the_first_two_steps_are_made_up():
    aside = np.zeros(81)
    aside[:2] = 5.0
    assert score(drive(y=aside)).last_step == 80
    # The rear bumper is 1.127 m behind the rear axle: at step 1 it touches what ends at -0.127 m.
    rollout = drive(actor=path_of(-2.127))
    ego = rollout.ego.copy()
    ego[:3, 0] = 2.0, 1.0, 4.0
    found = score(replace(rollout, ego=ego))
    assert found.last_step == 1
    assert found.progress == pytest.approx(4.0 / 80 / 2)  # half of what it is at step 2


def test_leaving_the_corridor_fails_only_by_the_later_rules():
    aside = np.zeros(81)
    aside[72:] = 4.0
    away = drive(y=aside)
    assert score(away).score.value == 1.0  # 72 of 80 m
    later = score(away, corridor_fails=True)
    assert (later.score.value, later.score.reason) == (0.0, "left the corridor sideways at step 72")
    beyond = drive(1.2)
    assert score(beyond, corridor_fails=True).score.value == 1.0
    assert score(beyond).last_step == 70  # 84 m, 4 m past the end


@pytest.mark.parametrize(
    ("y", "outside"),
    [
        (0.6, False),  # one lane contains the box
        (1.75, False),  # two lanes together do
        (-0.61, True),
        (4.11, True),
    ],
)
def test_off_road_by_lanes(y, outside):
    poses = np.array([[20.0, y, 0.0]])
    assert off_road(poses, EGO, hd_road()).tolist() == [outside]
    found = alpasim_scene_score(drive(y=np.full(81, y)), hd_road())
    assert found.score.value == (0.0 if outside else 1.0)


def test_off_road_by_areas_and_by_edges():
    shoulder = np.array([[-60.0, -4.0], [210.0, -4.0], [210.0, -1.7505], [-60.0, -1.7505]])
    poses = np.array([[20.0, -1.0, 0.0], [20.0, -2.9, 0.0]])
    wide = replace(hd_road(), drivable_area=(shoulder,))
    # A gap of half a millimetre to the lane is none; 5 cm beyond the shoulder are.
    assert off_road(poses, EGO, wide).tolist() == [False, True]
    gap = replace(hd_road(), drivable_area=(shoulder - [0.0, 0.01],))
    assert off_road(poses, EGO, gap).tolist() == [True, True]
    kerb = [np.array([[-60.0, -4.0], [210.0, -4.0]])]
    assert off_road(poses, EGO, gap, kerb).tolist() == [False, True]
    # Far beyond the edge, nothing touches it: AlpaSim's rule sees no ego that begins there.
    assert off_road(np.array([[20.0, -9.0, 0.0]]), EGO, gap, kerb).tolist() == [False]


def test_lanes_further_than_six_metres_do_not_count():
    broad = hd_road().lanes["oncoming"]
    outline = np.array([[-50.0, 1.0], [200.0, 1.0], [200.0, 12.0], [-50.0, 12.0]])
    only = HdMap({"oncoming": replace(broad, polygon=outline)}, ())
    edges = [np.array([[-60.0, 9.0], [210.0, 9.0]])]
    assert off_road([[20.0, 9.5, 0.0]], EGO, only, edges).tolist() == [False]
    assert off_road([[20.0, 9.6, 0.0]], EGO, only, edges).tolist() == [True]


def test_the_place_in_the_world_does_not_matter():
    move = np.array([310.0, -125.0, 2.1])
    rollout = drive(0.6, actor=path_of(-10.0, speed=12.0))
    plain = replace(rollout, controlled=())
    here = score(plain)
    there = score(moved_rollout(plain, move), moved_map(street(20.0, 400.0), move))
    assert here.contact.any()
    assert there.last_step == here.last_step
    assert there.score.value == pytest.approx(here.score.value, abs=1e-9)


def test_why_there_is_no_value():
    assert alpasim_scene_score(drive(), None).score.reason == "no drivable area in the map"
    assert score(drive().first(1)).score.reason == "the rollout has fewer than three states"
    assert score(drive().first(1)).to_json()["largest_distance_m"] is None
