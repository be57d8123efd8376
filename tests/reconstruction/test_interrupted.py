"""Scene commands that are killed or refused by the disk at a chosen moment, each in a child."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
from pathlib import Path

import pytest

from recast.logs import read_log
from recast.reconstruction import SceneConfig, TrainingStatus, train_scene, write_config
from support.children import KILL, Ended, Fault, command
from support.tiny_street import TINY
from support.unbroken import Unbroken, unbroken

pytestmark = pytest.mark.whole

CONFIG = TINY.model_copy(update={"iterations": 40, "checkpoint_every": 8, "densify_every": 12})
REFUSED = {errno.ENOSPC: "no space left", errno.EROFS: "read-only", errno.EACCES: "denied"}


@pytest.fixture(scope="module")
def training(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    """A `recast scene train` that nothing disturbed."""
    folder = tmp_path_factory.mktemp("training")
    write_config(CONFIG, folder / "config.json")
    args = ["scene", "train", str(tiny_log_folder), "--config", str(folder / "config.json")]
    return unbroken([*args, "--device", "cpu"], folder / "scene")


def killed_at_step(log: Path, out: Path, config: SceneConfig, step: int) -> int:
    """Exit code of a child that trains and is killed when it tells of a step."""
    context = multiprocessing.get_context("forkserver")
    child = context.Process(target=_train, args=(log, out, config, step))
    child.start()
    child.join()
    assert child.exitcode is not None
    return child.exitcode


def _train(log: Path, out: Path, config: SceneConfig, step: int) -> None:
    def tell(status: TrainingStatus) -> None:
        if status.phase == "train" and status.iteration >= step:
            os.kill(os.getpid(), signal.SIGKILL)

    train_scene(read_log(log), out, config, tell, device="cpu")


def test_ten_kills_change_nothing(
    training: Unbroken, tiny_log_folder: Path, tmp_path: Path
) -> None:
    """At five changes of the folder, each in what is left to do, and at five steps between."""
    out, moments = tmp_path / "scene", training.moments
    assert any("checkpoint" in moment for moment in moments) and len(moments) > 40
    kills = (
        "os.rename scene/source.json",
        "os.rename scene/work/initialisation.safetensors",
        10,
        "open scene/work/.checkpoint.safetensors.partial",
        10,
        20,
        "os.rename scene/work/checkpoint.safetensors",
        30,
        40,
        "os.rename scene/scene.json",
    )
    for kill in kills:
        if isinstance(kill, int):
            code = killed_at_step(tiny_log_folder, out, CONFIG, kill)
        else:
            code = training.again(out, Fault(tmp_path, KILL, kill)).code
        assert code == KILL, kill
    assert training.again(out).code == 0
    assert training.same(out)


def refused(ended: Ended, kind: int) -> bool:
    """Whether a command ended in one line that says what the disk refused."""
    assert ended.code == 2 and len(ended.err.splitlines()) == 1, ended.err
    assert REFUSED[kind] in ended.err
    return True


def test_disks_that_refuse_training(training: Unbroken, tmp_path: Path) -> None:
    """One line each time; with room again, the same command ends with the same bytes."""
    out, third = tmp_path / "scene", len(training.moments) // 3
    # Each counts on from what the last one left.
    for kind, at in ((errno.EROFS, 1), (errno.ENOSPC, third), (errno.EACCES, third)):
        assert refused(training.again(out, Fault(tmp_path, kind, at)), kind)
        assert not (out / "scene.json").exists()
    assert training.again(out).code == 0
    assert training.same(out)


@pytest.mark.parametrize("verb", ["export", "export at a time", "eval", "import"])
def test_disks_that_refuse_what_others_write(
    training: Unbroken, tiny_log_folder: Path, tmp_path: Path, verb: str
) -> None:
    """The first, a middle and the last change; nothing is left that looks finished."""
    scene, log = str(training.out), str(tiny_log_folder)
    args = {
        "export": ["scene", "export", scene],
        "export at a time": ["scene", "export", scene, "--time", "0.1"],
        "eval": ["scene", "eval", scene, "--log", log],
        "import": ["scene", "import", "gaussians", f"{scene}/background.ply", "--log", log],
    }[verb]

    def run(name: str, kind: int = errno.EROFS, at: int | None = None) -> Ended:
        root = tmp_path / name
        root.mkdir()
        words = [*args, "--out", root / "out"]
        return command(words, Fault(root, kind, at), tmp_path / f"notes-{name}")

    whole = run("whole")
    assert whole.code == 0, whole.err
    changes = len(whole.moments)
    for kind, at in ((errno.EROFS, 1), (errno.ENOSPC, changes // 2), (errno.EACCES, changes)):
        assert refused(run(str(at), kind, at), kind)
        finished = tmp_path / str(at) / "out" / ("eval.json" if verb == "eval" else "scene.json")
        assert not finished.exists()
