"""The training loop: resumes, refusals, logs, losses that are not finite."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.training.loop import StepRandom, read_log_lines, train
from recast.training.state import STATE_FILE, TrainerSettings, TrainingState
from support.line_task import SETTINGS, Line


def weights(state: TrainingState) -> list[Tensor]:
    return [v for m in state.modules.values() for v in m.state_dict().values()]


def tensors_of(folder: Path) -> dict[str, Tensor]:
    with safe_open(folder / STATE_FILE, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def lines_of(folder: Path) -> list[dict[str, float]]:
    lines = read_log_lines(folder / "log.jsonl")
    return [{k: v for k, v in line.items() if k != "seconds"} for line in lines]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    train(Line(), SETTINGS, folder)
    return folder


@pytest.mark.parametrize("stops", [(1,), (7, 9), (5, 10, 22)])
def test_an_interrupted_training_writes_the_same_bytes(
    whole: Path, tmp_path: Path, stops: tuple[int, ...]
) -> None:
    for stop in stops:
        with pytest.raises(KeyboardInterrupt):
            train(Line(stop_at=stop), SETTINGS, tmp_path)
    train(Line(), SETTINGS, tmp_path)
    assert (tmp_path / STATE_FILE).read_bytes() == (whole / STATE_FILE).read_bytes()
    assert lines_of(tmp_path) == lines_of(whole)


def test_a_stop_loses_the_steps_since_the_checkpoint_only(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(Line(stop_at=13), SETTINGS, tmp_path)
    again = Line()
    train(again, SETTINGS, tmp_path)
    assert again.parts[0] == (10, 0)
    assert again.parts[-1] == (22, 1)


def test_a_finished_training_is_left_alone(whole: Path) -> None:
    before = (whole / STATE_FILE).read_bytes()
    task = Line()
    state = train(task, SETTINGS, whole)
    assert task.parts == [] and state.step == 23
    assert (whole / STATE_FILE).read_bytes() == before


def test_the_loss_falls_and_the_average_lags(whole: Path) -> None:
    lines = lines_of(whole)
    assert [line["step"] for line in lines] == [4, 8, 12, 16, 20]
    assert lines[-1]["loss"] < 0.5 * lines[0]["loss"]
    tensors = tensors_of(whole)
    assert not torch.equal(tensors["model/line/0.weight"], tensors["average/line/0.weight"])


def test_values_that_are_not_finite_are_left_out_of_means(whole: Path) -> None:
    task = Line()
    offsets = {
        (step, part): float(StepRandom.of(4, step, part).numpy.normal())
        for step in range(4)
        for part in range(2)
    }
    assert task.parts == []
    first = lines_of(whole)[0]
    odd = [value for (step, _), value in offsets.items() if step % 2]
    assert first["odd"] == pytest.approx(sum(odd) / len(odd))
    assert first["offset"] == pytest.approx(sum(offsets.values()) / 8)


def test_a_line_cut_short_by_a_kill_and_steps_undone_are_written_anew(
    whole: Path, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(Line(stop_at=14), SETTINGS, tmp_path)
    with (tmp_path / "log.jsonl").open("a") as stream:
        stream.write('{"step": 16, "los')
    train(Line(), SETTINGS, tmp_path)
    assert lines_of(tmp_path) == lines_of(whole)


def test_a_checkpoint_cut_short_is_refused(whole: Path, tmp_path: Path) -> None:
    (tmp_path / STATE_FILE).write_bytes((whole / STATE_FILE).read_bytes()[:-100])
    with pytest.raises(InputError, match=r"state\.safetensors: state: cannot be read"):
        train(Line(), SETTINGS, tmp_path)


def test_the_partial_file_of_a_kill_does_not_count(whole: Path, tmp_path: Path) -> None:
    (tmp_path / f".{STATE_FILE}.partial").write_bytes(b"half a checkpoint")
    train(Line(), SETTINGS, tmp_path)
    assert (tmp_path / STATE_FILE).read_bytes() == (whole / STATE_FILE).read_bytes()


@pytest.mark.parametrize("change", [{"lr": 1e-3}, {"seed": 5}, {"ema_decay": 0.8}, {"steps": 30}])
def test_other_settings_are_refused(whole: Path, change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        train(Line(), SETTINGS.model_copy(update=change), whole)


def test_a_constant_schedule_may_go_on_longer_and_write_more_often(tmp_path: Path) -> None:
    long = SETTINGS.model_copy(update={"schedule": "constant"})
    short = long.model_copy(update={"steps": 11, "checkpoint_every": 3, "log_every": 2})
    train(Line(), short, tmp_path / "a")
    resumed = train(Line(), long, tmp_path / "a")
    whole = train(Line(), long, tmp_path / "b")
    for found, expected in zip(weights(resumed), weights(whole), strict=True):
        assert torch.equal(found, expected)
    with pytest.raises(InputError, match="23 are done, but 11 are requested"):
        train(Line(), short, tmp_path / "a")


def test_another_network_is_refused(whole: Path) -> None:
    task = Line()
    task.network = nn.Sequential(nn.Linear(3, 9), nn.Tanh(), nn.Linear(9, 1))
    with pytest.raises(InputError, match="belong to another network"):
        train(task, SETTINGS, whole)


def test_steps_without_finite_loss_change_nothing_and_then_end_the_training(
    tmp_path: Path,
) -> None:
    settings = SETTINGS.model_copy(update={"steps": 100, "checkpoint_every": 1})
    with pytest.raises(InputError, match="step 27: the loss is not finite"):
        train(Line(bad_from=8), settings, tmp_path)
    good = train(
        Line(), settings.model_copy(update={"schedule": "constant", "steps": 8}), tmp_path / "good"
    )
    assert good.step == 8
    stopped = tensors_of(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        train(Line(stop_at=8), settings, tmp_path / "until")
    until = tensors_of(tmp_path / "until")
    assert stopped.keys() == until.keys()
    for name, value in until.items():
        assert torch.equal(stopped[name], value), name
    assert lines_of(tmp_path)[2]["not_finite"] == 1.0


def test_probe_and_watch_come_with_each_line(tmp_path: Path) -> None:
    seen: list[tuple[int, dict[str, float]]] = []
    steps: list[int] = []
    train(
        Line(),
        SETTINGS,
        tmp_path,
        probe=lambda: {"gap": 0.25},
        watch=lambda step, values: seen.append((step, values)),
        after_step=lambda state: steps.append(state.step),
    )
    assert [step for step, _ in seen] == [4, 8, 12, 16, 20]
    assert all(values["gap"] == 0.25 and "loss" in values for _, values in seen)
    assert steps == list(range(1, 24))
    assert lines_of(tmp_path)[0]["gap"] == 0.25


def test_the_randomness_of_parts_differs_and_that_of_the_whole_step_does_not() -> None:
    parts = [StepRandom.of(1, 2, part, 2) for part in range(2)]
    assert parts[0].numpy.random() != parts[1].numpy.random()
    assert parts[0].whole().random() == parts[1].whole().random()
    assert parts[0].whole().random() != StepRandom.of(1, 3, 0, 2).whole().random()


def test_rates() -> None:
    flat = TrainerSettings(steps=10, lr=2.0, warmup=4)
    assert [flat.rate(i) for i in range(5)] == [0.5, 1.0, 1.5, 2.0, 2.0]
    wave = TrainerSettings(steps=10, lr=2.0, schedule="cosine")
    assert wave.rate(0) == 2.0
    assert wave.rate(5) == pytest.approx(1.01)
    assert wave.rate(10) == pytest.approx(0.02)


_TWO = """
import sys
from pathlib import Path
from support.line_task import SETTINGS, Line
from recast.training.loop import Processes, train
settings = SETTINGS.model_copy(update={"accumulate": 1})
train(Line(), settings, Path(sys.argv[1]), processes=Processes.started())
"""


@pytest.mark.whole
def test_two_processes_train_as_one_that_accumulates_twice(whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("accelerate")
    (tmp_path / "two.py").write_text(_TWO)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    tests = str(Path(__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": tests, "CUDA_VISIBLE_DEVICES": ""}
    command += [str(tmp_path / "two.py"), str(tmp_path / "out")]
    subprocess.run(command, check=True, env=environment, capture_output=True, timeout=300)
    for name, value in tensors_of(whole).items():
        found = tensors_of(tmp_path / "out")[name]
        torch.testing.assert_close(found, value, rtol=1e-4, atol=1e-6, msg=name)
