"""GTRS as a planner: what it asks for, what it answers, and what it refuses."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.dynamics import make_state
from recast.logs import Trajectory
from recast.planning import (
    DrivingCommand,
    Planner,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    make_planner,
)
from recast.planning.gtrs import (
    NUPLAN_VIRTUAL,
    GtrsModel,
    GtrsPlanner,
    empty_model,
    new_model,
    save_gtrs,
)
from recast.planning.types import ego_status
from support.tiny_gtrs import VIEWS, fan, rig


@pytest.fixture
def context() -> PlanningContext:
    poses = np.tile(np.eye(4), (31, 1, 1))
    poses[:, 0, 3] = 2.0 * np.arange(31)
    log = Trajectory(np.arange(31, dtype=np.int64) * 200_000, poses)
    return PlanningContext(
        ReferenceRoute.from_trajectory(log), log, cameras=rig(*VIEWS.cameras, "rear")
    )


def test_it_is_a_planner_that_says_what_it_wants_to_see(planner: GtrsPlanner) -> None:
    assert isinstance(planner, Planner)
    assert planner.needs_images and planner.camera_names is None
    assert [(view.name, view.yaw) for view in planner.wanted_views] == [
        ("front_left", 45.0),
        ("front", 0.0),
        ("front_right", -45.0),
    ]
    for view in planner.wanted_views:
        assert (view.camera.width, view.camera.height) == (48, 32)
        assert view.camera.fx == view.camera.fy == pytest.approx(40.0, abs=0.01)
    nuplan = GtrsPlanner(planner.model, planner.vocabulary, NUPLAN_VIRTUAL)
    assert nuplan.camera_names == ("nuplan_l0", "nuplan_f0", "nuplan_r0")
    assert nuplan.wanted_views == ()


@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_it_says_where_it_computes(device: str, planner: GtrsPlanner) -> None:
    model = empty_model(planner.model.config).to(device) if device == "meta" else planner.model
    assert GtrsPlanner(model, planner.vocabulary, VIEWS).device == device


def test_the_cameras_names_do_not_matter(
    planner: GtrsPlanner, context: PlanningContext, observation: PlannerInput
) -> None:
    planner.reset(context)
    expected = planner.plan(observation)
    theirs = ("FRONT_LEFT", "front_right", "front_left", "front")  # three of them mislead
    mounts = rig(*theirs)
    assert planner.choose_cameras(mounts) == dict(zip(VIEWS.cameras, theirs, strict=False))
    planner.reset(replace(context, cameras=mounts))
    images = dict(zip(theirs, observation.images.values(), strict=False))
    plan = planner.plan(replace(observation, images=images))
    assert plan.waypoints.tobytes() == expected.waypoints.tobytes() and plan.info == expected.info


def test_a_plan_is_the_best_entry_unchanged(
    planner: GtrsPlanner, context: PlanningContext, observation: PlannerInput
) -> None:
    planner.reset(context)
    plan, decision = planner.plan(observation), planner.decide(observation)
    plan.validate()
    best = int(np.argmax(decision.scores))
    np.testing.assert_array_equal(plan.waypoints, fan(12)[best])
    assert plan.info["index"] == best and plan.info["command"] == "straight"
    assert plan.info["score"] == pytest.approx(float(decision.scores[best]))
    assert plan.candidates is not None
    assert plan.candidates.waypoints.shape == (3, 40, 3)
    np.testing.assert_array_equal(plan.candidates.waypoints[0], plan.waypoints)
    np.testing.assert_array_equal(plan.candidates.scores, -np.sort(-decision.scores)[:3])


def test_scores_of_all_trajectories(planner: GtrsPlanner, observation: PlannerInput) -> None:
    decision = planner.decide(observation)
    assert decision.scores.shape == (12,)
    assert sorted(decision.order().tolist()) == list(range(12))
    assert decision.sub_scores["imi"].sum() == pytest.approx(1.0, abs=1e-5)
    for values in decision.sub_scores.values():
        assert values.shape == (12,) and (values >= 0).all() and (values <= 1).all()
    assert len(decision.top(100).scores) == 12


def test_the_same_input_gives_the_same_plan(
    planner: GtrsPlanner, observation: PlannerInput
) -> None:
    first, again = planner.decide(observation), planner.decide(observation)
    assert first.scores.tobytes() == again.scores.tobytes()


def test_every_input_matters(planner: GtrsPlanner, observation: PlannerInput) -> None:
    scores = planner.decide(observation).scores
    for name in VIEWS.cameras:
        darker = dict(observation.images) | {name: observation.images[name] // 2}
        assert not np.array_equal(
            planner.decide(replace(observation, images=darker)).scores, scores
        )
    turned = replace(observation, command=DrivingCommand.LEFT)
    faster = replace(observation, ego=make_state([5.0, 0.1, 0.02], speed=9.0))
    for changed in (turned, faster):
        assert not np.array_equal(planner.decide(changed).scores, scores)


def test_where_the_ego_is_does_not_matter(planner: GtrsPlanner, observation: PlannerInput) -> None:
    moved = replace(observation, ego=make_state([-300.0, 80.0, 1.5], speed=6.0))
    assert np.array_equal(planner.decide(moved).scores, planner.decide(observation).scores)


def test_external_proposals(planner: GtrsPlanner, observation: PlannerInput) -> None:
    proposals = fan(20)[12:]
    both = planner.decide(observation, proposals)
    assert both.scores.shape == (20,) and both.trajectories.shape == (20, 40, 3)
    np.testing.assert_array_equal(both.trajectories[12:], proposals)
    only = planner.decide(observation, proposals, proposals_only=True)
    np.testing.assert_array_equal(only.scores, both.scores)
    assert only.best == 12 + int(np.argmax(both.scores[12:]))
    assert only.order().min() == 12 and len(only.top(50).scores) == 8
    with pytest.raises(InputError, match=r"planner tiny, proposals: .*has shape \(8, 20, 3\)"):
        planner.decide(observation, proposals[:, :20])
    with pytest.raises(ValueError, match="needs proposals"):
        planner.decide(observation, proposals_only=True)


def test_a_missing_camera_is_named_before_anything_is_rendered(
    planner: GtrsPlanner, context: PlanningContext, observation: PlannerInput
) -> None:
    mounts = {name: mount for name, mount in context.cameras.items() if name != "front_right"}
    message = (
        r"^planner tiny: view front_right: is 45 degrees right, 62 wide at 48:32, but no camera "
        r"shows it; add recast.* there are front_left \(45 degrees left, 62 wide\), front \(ahead"
    )
    with pytest.raises(InputError, match=message):
        planner.reset(replace(context, cameras=mounts))
    with pytest.raises(InputError, match=r"camera front_left: .*there are none"):
        planner.plan(replace(observation, images={}))


def test_other_sizes_and_steps_are_refused(planner: GtrsPlanner, context: PlanningContext) -> None:
    mount = context.cameras["front"]
    large = CameraMount(mount.camera.resized(96, 64), mount.rig_from_camera)  # one of three
    with pytest.raises(InputError, match="view front: is ahead, 62 wide at 48:32, but no camera"):
        planner.reset(replace(context, cameras={**context.cameras, "front": large}))
    with pytest.raises(InputError, match=r"dt: is 0.2 s"):
        planner.reset(replace(context, dt=0.2))


def test_broken_numbers_end_in_one_line(planner: GtrsPlanner, observation: PlannerInput) -> None:
    state = observation.ego.copy()
    state[3] = np.nan
    with pytest.raises(InputError, match="planner tiny: ego state: holds NaN"):
        planner.plan(replace(observation, ego=state))
    model: GtrsModel = planner.model
    with torch.no_grad():
        model.head.heads["imi"][0].bias.fill_(torch.inf)
    with pytest.raises(InputError, match=r"planner tiny: scores: are NaN or infinite \(12 of 12\)"):
        planner.plan(observation)


def test_a_bad_vocabulary_is_refused(planner: GtrsPlanner) -> None:
    with pytest.raises(InputError, match=r"gtrs: vocabulary: has shape \(3, 8, 3\)"):
        GtrsPlanner(planner.model, np.zeros((3, 8, 3), np.float32), VIEWS)


def test_a_folder_is_a_planner_s_name(
    planner: GtrsPlanner,
    observation: PlannerInput,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    save_gtrs(tmp_path / "mine", planner)
    expected = planner.plan(observation).waypoints
    np.testing.assert_array_equal(
        make_planner(str(tmp_path / "mine")).plan(observation).waypoints, expected
    )
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(make_planner("mine").plan(observation).waypoints, expected)
    (tmp_path / "log-replay").mkdir()
    assert make_planner("log-replay").name == "log-replay"
    with pytest.raises(InputError, match=r"mine/none/config.json: file: is missing"):
        make_planner(str(tmp_path / "mine" / "none"))


def test_training_mode_is_left_before_driving(
    planner: GtrsPlanner, context: PlanningContext
) -> None:
    planner.model.train()
    planner.reset(context)
    assert not planner.model.training


@pytest.fixture
def remembering(planner: GtrsPlanner) -> GtrsPlanner:
    """The same planner with a network that looks at an image one second older, too."""
    config = planner.model.config.model_copy(update={"history": 1.0})
    model = new_model(config, torch.Generator().manual_seed(1))
    return GtrsPlanner(model, planner.vocabulary, VIEWS)


def at(observation: PlannerInput, seconds: float, seed: int = 0) -> PlannerInput:
    """The same state at another time and with other images."""
    rng = np.random.default_rng([seed, round(10 * seconds)])
    images = {name: rng.integers(0, 256, (32, 48, 3), np.uint8) for name in VIEWS.cameras}
    return replace(observation, timestamp_us=round(seconds * 1e6), images=images)


def test_a_second_image_is_the_one_of_a_second_ago(
    remembering: GtrsPlanner, context: PlanningContext, observation: PlannerInput
) -> None:
    remembering.reset(context)
    status = ego_status(observation.command, observation.ego)
    seen = {t: VIEWS.stitch(at(observation, t).images) for t in (0.0, 0.5, 1.0, 1.5)}
    for now, before in ((0.0, None), (0.5, 0.0), (1.0, 0.0), (1.5, 0.5)):
        found = remembering.decide(at(observation, now))
        again = remembering.decide(at(observation, now))  # a second look remembers nothing new
        pictures = [seen[now]] if before is None else [seen[before], seen[now]]
        expected = remembering.judge(pictures, status, now - (before or 0.0))
        np.testing.assert_allclose(found.scores, expected.scores, rtol=0, atol=1e-4)
        np.testing.assert_array_equal(found.scores, again.scores)
    alone = remembering.judge([seen[1.0]], status)
    both = remembering.judge([seen[0.0], seen[1.0]], status, 1.0)
    assert np.abs(alone.scores - both.scores).max() > 1e-3
    too_old = remembering.judge([seen[0.0], seen[1.0]], status, 1.6)
    np.testing.assert_array_equal(too_old.scores, alone.scores)


def test_a_copy_and_a_reset_have_memories_of_their_own(
    remembering: GtrsPlanner, context: PlanningContext, observation: PlannerInput
) -> None:
    remembering.reset(context)
    remembering.plan(at(observation, 0.0))
    branch = deepcopy(remembering)
    branch.plan(at(observation, 0.1, seed=1))  # nearer to a second before 1.1 s
    own, theirs = (one.decide(at(observation, 1.1)) for one in (remembering, branch))
    assert np.abs(own.scores - theirs.scores).max() > 1e-3
    remembering.reset(context)
    forgotten = remembering.decide(at(observation, 1.0))
    status = ego_status(observation.command, observation.ego)
    alone = remembering.judge([VIEWS.stitch(at(observation, 1.0).images)], status)
    np.testing.assert_allclose(forgotten.scores, alone.scores, rtol=0, atol=1e-4)


def test_an_unknown_earlier_image_says_nothing(remembering: GtrsPlanner) -> None:
    """In a batch, too, where the place of an unknown one holds anything."""
    generator = torch.Generator().manual_seed(2)
    images = torch.rand(2, 3, 32, 128, generator=generator)
    earlier, status = torch.rand(2, 3, 32, 128, generator=generator), torch.randn(2, 8)
    trajectories = torch.from_numpy(remembering.vocabulary)
    with torch.no_grad():
        both = remembering.model(images, status, trajectories, earlier, torch.tensor([1.0, 0.0]))
        known = remembering.model(images, status, trajectories, earlier)
        none = remembering.model(images, status, trajectories)
    for name, found in both.items():
        torch.testing.assert_close(found[0], known[name][0], rtol=0, atol=1e-5)
        torch.testing.assert_close(found[1], none[name][1], rtol=0, atol=1e-5)
