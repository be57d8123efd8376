from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from recast.errors import InputError
from recast.simulation import Rollout, load_rollout, save_rollout


@pytest.fixture
def rollout() -> Rollout:
    rng = np.random.default_rng(0)
    states, plans = 11, 2
    return Rollout(
        name="cut-in-a",
        method="native",
        track_id="0",
        motion="cut-in",
        setting="a",
        planner="idm",
        start_timestamp_us=123,
        dt=0.1,
        steps_requested=160,
        cut_reason="the log ends",
        ego=rng.normal(size=(states, 11)),
        log_ego=rng.normal(size=(states, 4)),
        actor=rng.normal(size=(states, 4)),
        world_from_rig=rng.normal(size=(states, 4, 4)),
        world_from_actor=rng.normal(size=(states, 4, 4)),
        actor_size=np.array([4.0, 1.8, 1.5]),
        ego_size=np.array([5.176, 2.297]),
        ego_centre_offset=1.461,
        predictions=rng.normal(size=(plans, 40, 3)),
        plan_steps=np.array([0, 5]),
        route=rng.normal(size=(7, 2)),
        other_actors=("3", "5"),
    )


def test_round_trip_is_bit_exact(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    back = load_rollout(tmp_path / "r")
    for field in fields(Rollout):
        value, restored = getattr(rollout, field.name), getattr(back, field.name)
        if isinstance(value, np.ndarray):
            assert value.dtype == restored.dtype
            assert value.shape == restored.shape
            assert value.tobytes() == restored.tobytes(), field.name
        else:
            assert value == restored, field.name


def test_a_rollout_without_plans_survives(rollout: Rollout, tmp_path: Path) -> None:
    empty = replace(
        rollout, predictions=np.zeros((0, 40, 3)), plan_steps=np.zeros(0, dtype=np.int64)
    )
    save_rollout(empty, tmp_path / "r")
    assert load_rollout(tmp_path / "r").predictions.shape == (0, 40, 3)


def test_same_rollout_same_bytes(rollout: Rollout, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_rollout(rollout, tmp_path / name)
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == ["plans.parquet", "rollout.json", "rollout.parquet", "route.parquet"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_an_existing_folder_is_left_alone(rollout: Rollout, tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="exists already"):
        save_rollout(rollout, tmp_path / "r")
    assert (tmp_path / "r" / "mine.txt").read_text() == "keep"


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("actor", np.zeros((3, 4))),
        ("plan_steps", np.array([0, 99])),
        ("predictions", np.zeros((2, 39, 3))),
        ("steps_requested", 4),
        ("ego_size", np.array([np.nan, 1.0])),
    ],
)
def test_unfit_arrays_are_named(rollout: Rollout, field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"Rollout.{field}"):
        replace(rollout, **{field: value}).validate()


def test_another_version_is_refused(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    header = json.loads((tmp_path / "r" / "rollout.json").read_text())
    header["version"] = 2
    (tmp_path / "r" / "rollout.json").write_text(json.dumps(header))
    with pytest.raises(InputError, match=r"rollout\.json: version"):
        load_rollout(tmp_path / "r")


@pytest.mark.parametrize("name", ["rollout.json", "rollout.parquet", "plans.parquet"])
def test_missing_and_broken_files_are_named(rollout: Rollout, tmp_path: Path, name: str) -> None:
    save_rollout(rollout, tmp_path / "r")
    (tmp_path / "r" / name).write_bytes(b"not this")
    with pytest.raises(InputError, match=name):
        load_rollout(tmp_path / "r")
    (tmp_path / "r" / name).unlink()
    with pytest.raises(InputError, match=f"{name}: file: is missing"):
        load_rollout(tmp_path / "r")


def test_a_missing_column_is_named(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    path = tmp_path / "r" / "rollout.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["ego_vx"]), path)
    with pytest.raises(InputError, match=r"rollout\.parquet: ego_vx: column is missing"):
        load_rollout(tmp_path / "r")


def test_a_truncated_table_is_refused(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    path = tmp_path / "r" / "rollout.parquet"
    pq.write_table(pq.read_table(path).slice(0, 8), path)
    with pytest.raises(InputError, match="steps_run"):
        load_rollout(tmp_path / "r")
