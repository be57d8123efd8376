from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from recast import plugins
from recast.errors import InputError
from recast.planning import (
    PLANNERS,
    IdmLaneFollower,
    gtrs_mini,
    make_planner,
    planner_folder,
)

PLUGIN = """
class Mine:
    name = "mine"
    needs_images = True
    def reset(self, context): ...
    def plan(self, observation): ...
def broken(): return object()
value = 3
"""


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "my_planner_plugin.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    yield "my_planner_plugin"
    sys.modules.pop("my_planner_plugin", None)


@pytest.mark.parametrize("name", ["constant-velocity", "idm-follower", "log-replay", "pdm-closed"])
def test_built_in_planners_by_name(name: str) -> None:
    assert name in PLANNERS.names()
    assert make_planner(name).name == name


def test_the_shipped_planner_is_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "gtrs-mini" in PLANNERS.names()
    assert planner_folder("gtrs-mini") == gtrs_mini()
    assert planner_folder("./somewhere") == Path("somewhere")
    assert planner_folder("pdm-closed") is planner_folder("some.module:Planner") is None
    monkeypatch.setattr("recast.planning.shipped.gtrs_mini", lambda: tmp_path / "gone")
    with pytest.raises(InputError, match="planner: gtrs-mini: its weights are not in this inst"):
        make_planner("gtrs-mini")


def test_each_call_makes_a_new_one() -> None:
    assert make_planner("idm-follower") is not make_planner("idm-follower")
    assert isinstance(make_planner("idm-follower"), IdmLaneFollower)


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(InputError, match="constant-velocity, gtrs-mini, idm-follower"):
        make_planner("gtsr")


def test_a_path_to_a_class(plugin: str) -> None:
    assert make_planner(f"{plugin}:Mine").name == "mine"


def test_installed_plugins_are_found(plugin: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = EntryPoints([EntryPoint("mine", f"{plugin}:Mine", PLANNERS.group)])
    monkeypatch.setattr(plugins, "entry_points", lambda group: found.select(group=group))
    assert "mine" in PLANNERS.names()
    assert make_planner("mine").needs_images


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("no_such_module:Mine", "cannot be imported"),
        ("{plugin}:Nothing", "cannot be imported"),
        ("{plugin}:value", "cannot be called"),
        ("{plugin}:broken", "lacks name, needs_images, reset, plan"),
    ],
)
def test_bad_paths_are_named(plugin: str, path: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_planner(path.format(plugin=plugin))
