import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from rich.console import Console

from recast.core.errors import InputError
from recast.core.files import write_json
from recast.planning import make_planner
from recast.planning.gtrs import BackboneConfig, BackboneStage, GtrsConfig
from recast.training.loop import LOG_FILE, StepRandom, read_log_lines
from recast.training.state import STATE_FILE, TrainerSettings
from recast_tools.planner_training.evaluate import truth_sheet
from recast_tools.planner_training.samples import (
    HELD_OUT_EVERY,
    SAMPLES_FILE,
    DatasetRecord,
    SampleStore,
    world_folder,
)
from recast_tools.planner_training.task import (
    HALF_VIEWS,
    MINI,
    MINI_VIEWS,
    Batch,
    GtrsTask,
    PlannerTrainingConfig,
    balanced,
    chosen_training,
    first_model,
)
from recast_tools.planner_training.train import export_planner, train_planner

TINY = GtrsConfig(
    backbone=BackboneConfig(
        stem=(4, 4, 8),
        stages=(BackboneStage(blocks=1, conv_channels=8, out_channels=12),),
        layers=1,
        frozen_norm=False,
    ),
    channels=16,
    feedforward=16,
    heads=2,
    decoder_layers=1,
    token_rows=2,
    token_columns=8,
)
QUIET = Console(quiet=True)


def config(steps: int, **changes: object) -> PlannerTrainingConfig:
    trainer = TrainerSettings(
        steps=steps, lr=2e-3, ema_decay=0.9, clip=2.0, checkpoint_every=2, log_every=3
    )
    said = {"trainer": trainer, "network": TINY, "batch": 4, "judged": 2, "sheet_every": 4}
    return PlannerTrainingConfig(**(said | changes))


@pytest.fixture(autouse=True)
def short_settling(monkeypatch: pytest.MonkeyPatch) -> None:
    """The statistics of norms are those of few batches."""
    monkeypatch.setattr("recast_tools.planner_training.train._SETTLING", 4)


def change(world: Path, column: str, values: list[Any]) -> None:
    """Write other values into a column of a world's samples."""
    table = pq.read_table(world / SAMPLES_FILE)
    index = table.schema.get_field_index(column)
    table = table.set_column(index, column, pa.array(values, table.schema.field(index).type))
    pq.write_table(table, world / SAMPLES_FILE)


def test_a_killed_training_ends_in_the_same_bytes(small_dataset: Path, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    reached = train_planner([small_dataset], whole, config(6), QUIET)
    train_planner([small_dataset], parts, config(3), QUIET)  # a constant rate may go on
    train_planner([small_dataset], parts, config(6), QUIET)
    with_settings = [(folder / STATE_FILE).read_bytes() for folder in (whole, parts)]
    assert with_settings[0] == with_settings[1]
    lines = [
        [{k: v for k, v in line.items() if k != "seconds"} for line in read_log_lines(f / LOG_FILE)]
        for f in (whole, parts)
    ]
    assert lines[0] == lines[1]
    assert {"held_out", "gap", "regret"} <= lines[0][-1].keys()
    assert reached.samples == 2
    assert 0.0 <= reached.score <= 1.0
    assert (whole / "sheets" / "0000004.png").exists()

    planner = export_planner(whole, [small_dataset], tmp_path / "planner")
    loaded = make_planner(str(tmp_path / "planner"))
    assert loaded.name == "planner"
    half = {
        k: v.half().float() for k, v in planner.model.state_dict().items() if v.is_floating_point()
    }
    for name, value in half.items():
        torch.testing.assert_close(loaded.model.state_dict()[name], value, rtol=0, atol=0)


def test_reconstructed_samples_can_be_left_out(small_dataset: Path, tmp_path: Path) -> None:
    """Then all is as if their worlds were not there."""
    mixed, traced = tmp_path / "mixed", tmp_path / "traced"
    for folder in (mixed, traced):
        shutil.copytree(small_dataset, folder)
    for number in (2, 5):
        change(world_folder(mixed, number), "renderer", ["replaced", "replaced"])
        shutil.rmtree(world_folder(traced, number))
    states = {}
    for name, folder, renderers in (
        ("alone", traced, ("oracle",)),
        ("left out", mixed, ("oracle",)),
        ("all", mixed, ("replaced", "oracle")),
    ):
        out = tmp_path / name
        train_planner([folder], out, config(3, renderers=renderers), QUIET)
        states[name] = (out / STATE_FILE).read_bytes()
    assert states["left out"] == states["alone"]
    assert states["all"] != states["alone"]
    with pytest.raises(InputError, match="samples"):  # a training is of one kind
        train_planner([mixed], tmp_path / "all", config(3, renderers=("oracle",)), QUIET)
    with pytest.raises(InputError, match="renderers"):
        train_planner([mixed], tmp_path / "none", config(3, renderers=("native",)), QUIET)


def test_another_training_in_the_same_folder_is_refused(
    small_dataset: Path, tmp_path: Path
) -> None:
    out = tmp_path / "training"
    train_planner([small_dataset], out, config(2), QUIET)
    with pytest.raises(InputError, match="config"):
        train_planner([small_dataset], out, config(2, batch=2), QUIET)
    with pytest.raises(InputError, match="exists"):
        export_planner(out, [small_dataset], out)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(InputError, match="something else"):
        train_planner([small_dataset], tmp_path / "other", config(2), QUIET)


def test_a_training_may_begin_from_a_planner(small_dataset: Path, tmp_path: Path) -> None:
    first, then = tmp_path / "first", tmp_path / "then"
    train_planner([small_dataset], first, config(4), QUIET)
    export_planner(first, [small_dataset], tmp_path / "planner")
    still = config(2).model_copy(update={"trainer": TrainerSettings(steps=2, lr=1e-9)})
    train_planner([small_dataset], then, still, QUIET, tmp_path / "planner")
    begun = make_planner(str(tmp_path / "planner")).model
    ended = export_planner(then, [small_dataset], tmp_path / "ended").model
    for name, value in begun.named_parameters():
        torch.testing.assert_close(ended.state_dict()[name], value, rtol=0, atol=1e-6)
    with pytest.raises(InputError, match="start_sha256"):  # it is another training without it
        train_planner([small_dataset], then, still, QUIET)
    with pytest.raises(InputError, match="other network sizes"):
        bigger = still.model_copy(update={"network": MINI})
        train_planner([small_dataset], tmp_path / "third", bigger, QUIET, tmp_path / "planner")


def test_a_planner_may_be_the_mean_of_two(small_dataset: Path, tmp_path: Path) -> None:
    weights = []
    for seed in (0, 1):
        trainer = config(2).trainer.model_copy(update={"seed": seed})
        said = config(2).model_copy(update={"trainer": trainer})
        train_planner([small_dataset], tmp_path / f"training-{seed}", said, QUIET)
        planner = tmp_path / f"planner-{seed}"
        export_planner(tmp_path / f"training-{seed}", [small_dataset], planner)
        weights.append(make_planner(str(planner)).model.state_dict())
    last, out = tmp_path / "training-1", tmp_path / "mean"
    export_planner(last, [small_dataset], out, tmp_path / "planner-0", 0.25)
    mean = make_planner(str(out)).model.state_dict()
    for name, value in mean.items():
        if value.is_floating_point():
            parts = 0.25 * weights[0][name], 0.75 * weights[1][name]
            # Each part and the mean are rounded to 11 bits; float16 ends at 6e-8.
            bound = 2 * 2**-11 * (parts[0].abs() + parts[1].abs()) + 2e-7
            assert bool(((value - sum(parts)).abs() <= bound).all())
    with pytest.raises(InputError, match="share"):
        export_planner(last, [small_dataset], tmp_path / "none", tmp_path / "planner-0", 1.5)
    assert not (tmp_path / "none").exists()


def test_a_batch_holds_every_speed_of_a_picture(small_dataset: Path) -> None:
    """With part of the primitives and a mirror, entries are those taken one by one."""
    store = SampleStore(small_dataset)
    model = first_model(0, TINY)
    task = GtrsTask(store, np.arange(20), model, 4, 16)
    chosen, scored = np.array([3, 8]), np.array([5, 77, 2])
    mirrored = np.array([False, True])
    both = task.gather(chosen, np.arange(2), mirrored, scored=scored)
    assert both.images.shape[0] == 2
    possible = torch.from_numpy(store.record.primitives.trajectories(both.status.numpy()))
    torch.testing.assert_close(both.trajectories, possible[:, scored])
    for k in range(2):
        alone = task.gather(chosen, np.array([k]), mirrored)
        torch.testing.assert_close(both.status[k::2], alone.status)
        torch.testing.assert_close(both.demonstration[k::2], alone.demonstration)
        for name, values in alone.targets.items():
            torch.testing.assert_close(both.targets[name][k::2], values[:, scored])
    twice = store.record.primitives.mirror
    straight = task.gather(chosen[1:], np.arange(2), np.array([False]))
    name = "no_at_fault_collisions"
    torch.testing.assert_close(both.targets[name][2:], straight.targets[name][:, twice[scored]])
    tokens = task.look(both)
    logits = task.logits(tokens, both)
    one = model.score(tokens[1:], both.status[3:], both.trajectories[3:])
    torch.testing.assert_close(logits[name][3:], one[name])


def test_it_learns_to_look(small_dataset: Path, tmp_path: Path) -> None:
    """Some seconds suffice to tell a street with a red patch from one without."""
    training = config(80, sheet_every=0, judged=2, batch=4).model_copy(
        update={"trainer": TrainerSettings(steps=80, lr=5e-3, clip=2.0, log_every=80)}
    )
    reached = train_planner([small_dataset], tmp_path / "out", training, QUIET)
    assert reached.gap > 0.0
    assert reached.slower > 0.0


def test_settings_come_from_a_file_and_the_arguments(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    write_json(path, {"trainer": {"lr": 1e-3}, "batch": 4})
    found = chosen_training(path, seed=3, steps=7)
    assert (found.trainer.lr, found.trainer.seed, found.trainer.steps, found.batch) == (
        1e-3,
        3,
        7,
        4,
    )
    assert found.network == MINI
    write_json(path, {"batsch": 4})
    with pytest.raises(InputError, match="batsch"):
        chosen_training(path)


def test_half_size_views_are_the_loop_s_averaged_two_by_two() -> None:
    rng = np.random.default_rng(0)
    small = {
        name: rng.integers(0, 255, (160, 240, 3)).astype(np.uint8) for name in HALF_VIEWS.cameras
    }
    large = {name: image.repeat(2, axis=0).repeat(2, axis=1) for name, image in small.items()}
    np.testing.assert_array_equal(MINI_VIEWS.stitch(large), HALF_VIEWS.stitch(small))


@pytest.mark.parametrize("share", [0.2, 0.25, 0.5])
def test_the_same_share_of_every_scene_and_of_the_held_out_is_reconstructed(share: float) -> None:
    record = DatasetRecord(scenes=tuple("abcdefghi"), reconstructed=share)
    numbers = np.arange(360)
    chosen = np.array([record.is_reconstructed(number) for number in numbers])
    np.testing.assert_allclose(np.bincount(numbers[chosen] % 9), 40 * share, atol=2)
    held_out = numbers % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
    assert abs(chosen[held_out].sum() - 36 * share) <= 2
    for all_or_none in (False, True):
        record = DatasetRecord(scenes=("a",), reconstructed=float(all_or_none))
        assert [record.is_reconstructed(number) for number in range(5)] == [all_or_none] * 5


def test_the_store_knows_twins_and_holds_out_whole_worlds(small_dataset: Path) -> None:
    store = SampleStore(small_dataset)
    assert len(store) == 20
    np.testing.assert_array_equal(store.twin[store.twin], np.arange(20))
    assert set(store.worlds[store.held_out]) == {9}
    assert store.image(3).shape == (128, 512, 3)
    assert truth_sheet(store, 0, 3).shape == (3 * 128, 512 + 256, 3)
    with pytest.raises(InputError, match="choose from the 20"):
        truth_sheet(store, 18, 3)


def test_a_training_with_a_second_image(small_dataset: Path, tmp_path: Path) -> None:
    """It may begin from a planner that looks at one; only what is new is drawn."""
    data = tmp_path / "data"
    shutil.copytree(small_dataset, data)
    for number in range(10):  # each second sample is a second later than the first
        change(world_folder(data, number), "before", [-1, 0])
    train_planner([data], tmp_path / "first", config(2), QUIET)
    export_planner(tmp_path / "first", [data], tmp_path / "one")
    two = TINY.model_copy(update={"history": 1.0})
    train_planner([data], tmp_path / "second", config(4, network=two), QUIET, tmp_path / "one")
    ended = export_planner(tmp_path / "second", [data], tmp_path / "two")
    assert ended.model.config.history == 1.0
    assert make_planner(str(tmp_path / "two")).model.config.history == 1.0
    with pytest.raises(InputError, match="other network sizes"):  # it would lose what it looks at
        train_planner([data], tmp_path / "third", config(2), QUIET, tmp_path / "two")


def test_twins_lack_the_same_images(small_dataset: Path) -> None:
    """Else what one of them lacks would tell it from the other."""
    store = SampleStore(small_dataset)
    store.before[:] = np.where(store.clues[:, 0] > 0, np.arange(len(store)), -1)
    model = first_model(0, TINY.model_copy(update={"history": 1.0}))
    task = GtrsTask(store, np.arange(len(store)), model, 4, 16)
    seen, gather = [], task.gather

    def watched(*parts: Any) -> Batch:
        seen.append(parts[4])
        return gather(*parts)

    task.gather = watched  # type: ignore[method-assign]
    for step in range(6):
        task.loss(step, StepRandom.of(0, step))
    assert not np.concatenate(seen).any()  # one of each pair has no image before
    store.before[:] = np.arange(len(store)) ^ 1  # now each has its twin before it
    seen.clear()
    for step in range(12):
        task.loss(step, StepRandom.of(0, step))
    halves = np.array(seen).reshape(12, 2, -1)
    np.testing.assert_array_equal(halves[:, 0], halves[:, 1])
    assert set(np.unique(halves)) == {0.0, 0.5, 1.0, 1.5}


@pytest.mark.parametrize(
    ("column", "values", "says"),
    [
        ("renderer", ["oracle", "dream"], "row 1 is 'dream'"),
        ("image", ["000.png", "../000.png"], "row 1 is '../000.png'"),
        ("best", [[1, 2], [3]], "has 1 numbers, not 2"),
        ("scores", [[1], [2]], "has 1 numbers, not"),
    ],
)
def test_damaged_samples_are_told(
    small_dataset: Path, tmp_path: Path, column: str, values: list[Any], says: str
) -> None:
    data = tmp_path / "data"
    shutil.copytree(small_dataset, data)
    change(world_folder(data, 4), column, values)
    with pytest.raises(InputError, match=re.escape(says)) as told:
        SampleStore(data)
    assert "world-00004" in str(told.value)


def test_a_missing_picture_is_told(small_dataset: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    shutil.copytree(small_dataset, data)
    (world_folder(data, 4) / "001.png").unlink()
    with pytest.raises(InputError, match=r"001\.png"):
        SampleStore(data).image(9)


def test_rare_kinds_are_drawn_more_often(small_dataset: Path) -> None:
    """As the root of their number, whatever comes of them."""
    store = SampleStore(small_dataset)
    store.clues[:], store.columns[:] = 0.0, 0.0
    store.clues[:4, :4] = 1.0, 12.0, 3.3, 1.0  # beside the lane
    store.clues[4:8, :4] = 1.0, 12.0, -3.3, 1.0  # on the other side
    store.clues[8, :4] = 1.0, 12.0, 0.2, -1.0  # facing the ego
    store.clues[9:12, :4] = 1.0, 12.0, 0.2, 1.0  # it shows its rear
    store.columns[9:12, 16] = 1.0, np.log(10.0), 1.0, 0.0, -1.0, 0.0
    # What is farther does not count.
    store.columns[9:12, 20] = 1.0, np.log(30.0), -1.0, 0.0, -9.0, 0.0
    store.columns[9, 16, 4] = -7.0  # it is closed in on
    store.before[:] = 0
    store.before[0] = -1
    chances = balanced(store, np.arange(20))
    groups = {"first": [0], "beside": range(1, 8), "facing": [8], "free": range(12, 20)}
    groups |= {"closing": [9], "rear": [10, 11]}
    mass = {name: chances[list(rows)].sum() for name, rows in groups.items()}
    for name, rows in groups.items():
        assert mass[name] / mass["first"] == pytest.approx(np.sqrt(len(rows)))
    assert chances.sum() == pytest.approx(1.0)
    again = balanced(store, np.arange(9, 20))
    assert again[0] / again[3:].sum() == pytest.approx(1 / np.sqrt(8))
