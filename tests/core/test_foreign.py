"""Parts of users: completed once, warned of slips, and refused if a member is of the wrong kind."""

from __future__ import annotations

import ast
import inspect
import pickle
import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.actors.generate import ActorGenerator, BaseGenerator
from recast.core.errors import InputError
from recast.core.foreign import BasePart, _members, lacks, whole
from recast.envs.driving_env import NOTHING, BaseReward, Reward
from recast.planning import BasePlanner, Planner, PlannerAround
from recast.simulation import (
    ActorMotion,
    BaseController,
    BaseMotion,
    BaseRenderer,
    BaseScript,
    EgoController,
    ScriptMotion,
    SensorRenderer,
)
from recast.simulation.renderer import BaseRestorer, Restorer

SEAMS: dict[type, type[BasePart]] = {
    Planner: BasePlanner,
    ActorMotion: BaseMotion,
    ScriptMotion: BaseScript,
    EgoController: BaseController,
    ActorGenerator: BaseGenerator,
    SensorRenderer: BaseRenderer,
    Restorer: BaseRestorer,
    Reward: BaseReward,
}
ROOT = Path(__file__).parents[2]
SOURCES = ("src/recast", "bridges/src", "tools/src")
ELSEWHERE = {
    ("bridges/src/recast_bridges/navsim/planner.py", "name"),  # of an agent, which is NAVSIM's
}


class Bare:
    """What a planner must have, and no more."""

    name = "bare"

    def plan(self, observation: Any) -> Any:
        return observation


class Picky(Bare):
    """Has members of its own, and state."""

    needs_images, camera_names = True, ("front",)

    def __init__(self) -> None:
        self.seen: list[int] = []

    @property
    def record_fields(self) -> dict[str, str]:
        return {"weights": self.version}  # type: ignore[attr-defined]

    def finish_rollout(self) -> None:
        self.seen.append(1)


@pytest.mark.parametrize("protocol", SEAMS)
def test_every_base_has_all_that_its_protocol_asks_for(protocol: type) -> None:
    hints = {name for kind in protocol.__mro__ for name in inspect.get_annotations(kind)}
    methods = {
        name for kind in protocol.__mro__ for name in vars(kind) if callable(vars(kind)[name])
    }
    values = {
        name
        for kind in protocol.__mro__
        for name, one in vars(kind).items()
        if isinstance(one, property)
    }
    named = {name for name in hints | methods | values if not name.startswith("_")}
    assert named <= _members(SEAMS[protocol])


def test_a_part_is_completed_once() -> None:
    made = whole(Bare(), BasePlanner)
    assert isinstance(made, BasePlanner) and whole(made, BasePlanner) is made
    assert made.plan(7) == 7 and made.needs_images is False and made.choose_cameras({}) is None
    assert made.record_fields == {} and made.finish_rollout() is None
    assert type(made).__name__ == "Bare" and type(made).__module__ == __name__
    own = Picky()
    made = whole(own, BasePlanner)
    assert made.needs_images and made.choose_cameras({}) == ("front",)
    made.finish_rollout()
    assert own.seen == [1]


def test_a_fault_inside_a_property_is_not_a_missing_member() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'version'"):
        whole(Picky(), BasePlanner).record_fields  # noqa: B018


def test_a_completed_part_can_be_copied_and_sent() -> None:
    made = whole(Picky(), BasePlanner)
    for again in (deepcopy(made), pickle.loads(pickle.dumps(made))):
        again.finish_rollout()
        assert again.part.seen == [1] and made.part.seen == []  # type: ignore[attr-defined]


def test_a_part_around_another_changes_what_its_class_says() -> None:
    class Twice(PlannerAround):
        def plan(self, observation: Any) -> Any:
            return 2 * super().plan(observation)

    made = Twice(Picky())  # type: ignore[arg-type]
    assert made.plan(3) == 6 and made.needs_images and made.name == "bare"
    assert made.wanted_views == () and made.choose_cameras({}) == ("front",)


def test_a_function_is_a_reward_without_parts() -> None:
    made = whole(lambda facts: 3.0, BaseReward)
    assert made(NOTHING) == 3.0 and made.parts(NOTHING) == {}


def test_a_slip_is_warned_about_in_one_line_and_once() -> None:
    class Slips(Bare):
        def choose_camera(self, mounts: Any) -> None: ...

    with pytest.warns(UserWarning, match=r"Slips has choose_camera, .* is it choose_cameras\?$"):
        whole(Slips(), BasePlanner)
    with warnings.catch_warnings(action="error"):
        whole(Slips(), BasePlanner)  # not again


def test_what_has_the_member_is_no_slip() -> None:
    class Both(Bare):
        shared, share = True, 0.5

    with warnings.catch_warnings(action="error"):
        whole(Both(), BasePlanner)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "method": ({"plan": 3}, "plan: is not a method; correct it; see recast.planning.types.Base"),
    "value": ({"camera_names": lambda self: ()}, "camera_names: is a method, not a value"),
    "property": ({"record_fields": lambda self: {}}, "record_fields: is a method, not a value"),
    "text": ({"name": 7}, "name: is not of the type str"),
    "flag": ({"needs_images": "no"}, "needs_images: is not of the type bool"),
}


@pytest.mark.parametrize("case", WRONG)
def test_members_of_the_wrong_kind_are_refused(case: str) -> None:
    members, line = WRONG[case]
    with pytest.raises(InputError) as refused:
        whole(type("Mine", (Bare,), members)(), BasePlanner)
    assert line in str(refused.value) and str(refused.value).startswith(f"{Bare.__module__}.Mine")


def test_flags_of_numpy_are_flags() -> None:
    assert whole(type("Mine", (Bare,), {"shared": np.bool_(True)})(), BasePlanner).shared


def test_what_lacks_a_member_and_a_class_are_refused() -> None:
    class Slow:
        name = "slow"

        def plans(self) -> None: ...

    assert lacks(Slow(), BasePlanner) == ("plan",)
    with pytest.raises(InputError, match=r"Slow: plan: is missing; is it plans\?"):
        whole(Slow(), BasePlanner)
    with pytest.raises(InputError, match="Bare: part: is a class; call Bare"):
        whole(Bare, BasePlanner)
    with pytest.raises(TypeError, match="abstract"):
        type("Lazy", (BasePlanner,), {})()


def asked_by_name(source: str, members: frozenset[str]) -> list[str]:
    """Members of seams that a module fetches by their name as a text."""
    calls = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    found = []
    for call in calls:
        by_name = isinstance(call.func, ast.Name) and call.func.id in ("getattr", "hasattr")
        if by_name and len(call.args) > 1 and isinstance(call.args[1], ast.Constant):
            found.append(str(call.args[1].value))
    return [name for name in found if name in members]


def test_no_member_of_a_seam_is_asked_for_by_its_name() -> None:
    members = frozenset().union(*map(_members, SEAMS.values()))
    assert {"choose_cameras", "follows_log", "candidates", "close", "parts", "reset"} <= members
    found = {
        (str(path.relative_to(ROOT)), name)
        for folder in SOURCES
        for path in (ROOT / folder).rglob("*.py")
        for name in asked_by_name(path.read_text(), members)
    }
    assert found <= ELSEWHERE


@pytest.mark.parametrize("call", ['getattr(p, "follows_log", False)', 'hasattr(m, "script")'])
def test_asking_by_name_would_be_seen(call: str) -> None:
    assert asked_by_name(f"def f(p, m):\n    return {call}\n", _members(BaseScript))
