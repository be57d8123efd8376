"""`recast view`: what it takes, and what it says about what it does not."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import pytest
import torch

from recast.cli.main import main
from recast.logs import DrivingLog, map_of, read_log
from recast.planning import make_planner
from recast.reconstruction import TrainingStatus, train_scene
from recast.reconstruction.train import CHECKPOINT
from recast.runs.arms import Arm
from recast.runs.config import RunConfig
from recast.runs.run_folder import RunFolder
from recast.runs.view import view_inputs
from recast.scene.store import read_tensors
from recast.simulation import MOTIONS, RolloutSetup, run_rollout, save_rollout
from support.tiny_street import TINY, KilledError

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def rollout_folder(tiny_log: DrivingLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loose") / "native"
    setup = RolloutSetup(
        tiny_log, "0", MOTIONS["advancing-a"], arm="native", map=map_of(tiny_log), steps=10
    )
    save_rollout(run_rollout(setup, make_planner("idm-follower")), folder / "states")
    return folder


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["view", *words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_a_log_and_its_rollout_are_shown_together(
    tiny_log_folder: Path, rollout_folder: Path
) -> None:
    found = view_inputs([tiny_log_folder, rollout_folder])
    assert list(found.scenarios) == ["advancing-a, idm-follower", "recording"]
    drive = found.scenarios["advancing-a, idm-follower"]["native"]
    assert drive.controlled == ("0",) and len(drive) == 11
    assert found.runner is not None and found.runner.track == "0"


def test_a_replay_of_a_log_is_written(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.html"
    assert main(["view", str(tiny_log_folder), "--replay", str(path)]) == 0
    assert path.stat().st_size < 3e6
    said = " ".join(capsys.readouterr().out.split())
    assert "MB, 0 of 0 Gaussians" in said and "viser" not in said


def test_a_run_whose_street_trains_shows_what_the_training_has_come_to(
    tiny_log_folder: Path, tmp_path: Path
) -> None:
    street = TINY.model_copy(update={"iterations": 40, "checkpoint_every": 8})
    config = RunConfig(
        track="0",
        motions=("advancing-a",),
        planners=("idm-follower",),
        arms=(Arm.native(), Arm.replaced("template")),
        scene=street,
    )
    store = tmp_path / "store"
    run = RunFolder.create_or_resume(
        tmp_path / "run", config.resolved(), tiny_log_folder, "hash", str(store)
    )
    first = view_inputs([run.path])
    assert first.title.endswith(", 0 of 2 rollouts")
    assert list(first.scenarios) == ["recording"] and first.scenes["native"] is None
    assert first.renew is not None and first.renew() is None

    def stop(status: TrainingStatus) -> None:
        if status.iteration >= 30:
            raise KilledError

    def train(out: Path) -> None:
        train_scene(read_log(tiny_log_folder), out, street, stop, device="cpu")

    with suppress(KilledError):
        run.store().make("scenes", {"a": "street"}, train, name="street", resumes=True)
    [partial] = run.store().partial("scenes")
    found = first.renew()
    assert found is not None and found.renew is not None and found.renew() is None
    assert found.title.endswith(", street after 24 steps of training, 0 of 2 rollouts")
    scene = found.scenes["native"]
    assert scene is not None and "0" in scene.actors and scene.low_pass == street.low_pass
    tensors, _ = read_tensors(partial / CHECKPOINT)
    assert torch.equal(scene.background.means, tensors["background:means"])


def test_folders_that_cannot_be_shown_are_refused(
    tiny_log_folder: Path, rollout_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, nothing = str(tiny_log_folder), str(tmp_path)
    assert "is not a folder" in refused(capsys, str(tmp_path / "missing"))
    assert "is not a folder that can be shown" in refused(capsys, nothing)
    assert "second log" in refused(capsys, log, log)
    assert "outside of a run folder" in refused(capsys, str(rollout_folder))


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--max-gaussians", "10"), "--max-gaussians"),
        (("--port", "0"), "--port"),
        (("--replay-mb", "nan", "--replay", "x.html"), "--replay-mb"),
        (("--replay", "x.txt"), "--replay"),
    ],
)
def test_options_are_checked_first(
    words: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert named in refused(capsys, "no-such-folder", *words)


def test_without_viser_one_line_says_what_to_install(
    tiny_log_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'recast-sim[viewer]'" in refused(capsys, str(tiny_log_folder))
