from __future__ import annotations

import sys
import traceback
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from recast.core import plugins
from recast.core.artefact import files_hash, folder_hash
from recast.core.errors import InputError
from recast.planning import (
    PLANNERS,
    IdmLaneFollower,
    make_planner,
    planner_device,
    planner_folder,
    planner_source,
    shipped_folder,
)
from recast.planning.registry import SHIPPED

PLUGIN = """
class Mine:
    name = "mine"
    needs_images = True
    def reset(self, context): ...
    def plan(self, observation): ...
def broken(): return object()
def itself(): return Mine
def needy(size): return Mine()
def failing(): raise RuntimeError("out of\\nmemory")
def leaving(): raise SystemExit(3)
def placed(*, device):
    planner = Mine()
    planner.device = device
    return planner
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
    for name in SHIPPED:
        assert name in PLANNERS.names()
        assert planner_folder(name) == shipped_folder(name)
        assert make_planner(name).name == name
    assert planner_folder("./somewhere") == Path("somewhere")
    assert planner_folder("pdm-closed") is planner_folder("some.module:Planner") is None
    monkeypatch.setattr("recast.planning.registry.shipped_folder", lambda name: tmp_path / name)
    with pytest.raises(InputError, match="planner: gtrs-mini: its weights are missing from this"):
        make_planner("gtrs-mini")


def test_each_call_makes_a_new_one() -> None:
    assert make_planner("idm-follower") is not make_planner("idm-follower")
    assert isinstance(make_planner("idm-follower"), IdmLaneFollower)


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(InputError, match="constant-velocity, expert, gtrs-mini, gtrs-mini-o"):
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
        ("{plugin}:broken", "made object, which lacks name, needs_images, reset, plan"),
        ("{plugin}:itself", "made the class Mine; return a planner"),
        (".x:y", r"cannot be imported \(TypeError: .*relative import"),
        (":y", r"cannot be imported \(ValueError"),
        ("a..b:c", "cannot be imported"),
        ("{plugin}:needy", r"cannot be made \(TypeError: needy\(\) missing 1 required"),
        (
            "{plugin}:failing",
            r"cannot be made \(RuntimeError: out of memory, my_planner_plugin.py line 10\)",
        ),
        ("{plugin}:leaving", r"cannot be made \(SystemExit: 3, my_planner_plugin.py line 11\)"),
        ("navsim:{plugin}:needy", r"cannot be made \(TypeError: needy"),
        ("navsim:.x:y", r"cannot be imported \(TypeError"),
        ("navsim:", "is not known"),
    ],
)
def test_bad_paths_are_one_line(plugin: str, path: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        make_planner(path.format(plugin=plugin))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "body", ["raise OSError('no disk')", "import sys; sys.exit('bye')", "x = ("]
)
def test_a_module_that_does_not_import_keeps_its_traceback(
    body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_broken_module.py").write_text(f"def f():\n    {body}\nf()\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        InputError, match="planner: my_broken_module:P: cannot be imported"
    ) as caught:
        make_planner("my_broken_module:P")
    cause = caught.value.__cause__
    assert isinstance(cause, OSError | SystemExit | SyntaxError)
    if not isinstance(cause, SyntaxError):  # which has its line in itself
        frames = [frame.f_code.co_name for frame, _ in traceback.walk_tb(cause.__traceback__)]
        assert frames[-1] == "f"


def test_an_agent_that_fails_to_start_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = """
class Agent:
    def initialize(self): raise FileNotFoundError("weights.ckpt")
    def get_sensor_config(self): ...
    def compute_trajectory(self, agent_input): ...
"""
    (tmp_path / "my_failing_agent.py").write_text(agent)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        InputError,
        match=r"cannot be made \(FileNotFoundError: weights.ckpt, my_failing_agent.py line 3\)",
    ):
        make_planner("navsim:my_failing_agent:Agent")


def test_the_files_behind_a_name(plugin: str, tmp_path: Path) -> None:
    mine = files_hash([tmp_path / f"{plugin}.py"], tmp_path)
    assert PLANNERS.source(f"{plugin}:Mine") == f"{plugin}:Mine {mine}"
    assert PLANNERS.source(f"navsim:{plugin}:Agent") == f"navsim:{plugin}:Agent {mine}"
    assert planner_source("idm-follower") == "idm-follower"
    assert planner_source("gtrs-mini") == folder_hash(shipped_folder("gtrs-mini"))
    with pytest.raises(InputError, match="gtsr: is not known"):
        planner_source("gtsr")


@pytest.mark.parametrize(("gpus", "expected"), [(0, "cpu"), (2, "cuda")])
def test_the_device_that_is_there(
    gpus: int, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: gpus > 0)
    monkeypatch.setattr("torch.cuda.device_count", lambda: gpus)
    assert planner_device() == planner_device("auto") == expected
    assert planner_device("cpu") == "cpu"
    for name, index in (("cuda", 0), ("cuda:1", 1), ("cuda:2", 2)):
        if index < gpus:
            assert planner_device(name) == name
        else:
            with pytest.raises(
                InputError, match=f"device: {name}: does not exist: torch finds {gpus}"
            ):
                planner_device(name)
    for name in ("gpu", "", "cuda:", "cuda:-1", "meta", "cuda:0001", "CPU\n"):
        with pytest.raises(InputError, match="is unknown; choose auto, cpu, cuda"):
            planner_device(name)


@pytest.mark.filterwarnings("ignore:for .* copying from a non-meta parameter")
def test_planners_compute_where_they_are_told(
    plugin: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torch's device without memory stands for a GPU."""
    asked = []

    def meta(name: str) -> str:
        asked.append(name)
        return "meta"

    monkeypatch.setattr("recast.planning.registry.planner_device", meta)
    assert make_planner("gtrs-mini").device == "meta"
    assert make_planner(str(shipped_folder()), "cuda:1").device == "meta"
    assert make_planner(f"{plugin}:placed", "cuda").device == "meta"
    assert asked == ["auto", "cuda:1", "cuda"]
    make_planner(f"{plugin}:Mine", "cuda")  # has no say
    make_planner("idm-follower", "cuda")
    assert len(asked) == 3


def test_without_a_gpu_planners_compute_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert make_planner("gtrs-mini").device == make_planner(str(shipped_folder())).device == "cpu"
    with pytest.raises(
        InputError, match="planner device: cuda: does not exist: torch finds 0 GPUs"
    ):
        make_planner("gtrs-mini", "cuda")
