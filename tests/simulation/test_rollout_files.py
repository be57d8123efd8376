from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recast.core.errors import InputError
from recast.geometry import se3
from recast.simulation import Rollout, load_rollout, save_rollout


@pytest.fixture
def rollout() -> Rollout:
    rng = np.random.default_rng(0)
    states, plans = 11, 2
    poses = se3.exp(rng.normal(size=(2, states, 6)))
    actor = rng.normal(size=(states, 4))
    actor[:, 3] = np.abs(actor[:, 3])
    return Rollout(
        name="cut-in-a",
        arm="native",
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
        actor=actor,
        world_from_rig=poses[0],
        world_from_actor=poses[1],
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


def test_only_a_person_is_written_as_something_else_than_a_vehicle(
    rollout: Rollout, tmp_path: Path
) -> None:
    save_rollout(rollout, tmp_path / "vehicle")
    assert "category" not in json.loads((tmp_path / "vehicle" / "rollout.json").read_text())
    save_rollout(replace(rollout, category="cyclist"), tmp_path / "cyclist")
    assert load_rollout(tmp_path / "cyclist").category == "cyclist"


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
        ("ego_size", np.array([4.0, -1.0])),
        ("actor_size", np.array([4.0, 0.0, 1.0])),
        ("actor_size", np.array([4.0, 1e30, 1.0])),
        ("actor", -np.ones((11, 4))),
        ("ego", np.full((11, 11), 1e200)),
        ("ego", np.zeros((11, 11), np.int64)),
        ("ego", np.zeros((11, 11), complex)),
        ("world_from_rig", np.ones((11, 4, 4))),
        ("world_from_actor", np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (11, 1, 1))),
        ("plan_steps", np.array([5, 0])),
        ("plan_steps", np.array([0.0, 5.0])),
        ("dt", 0.0),
        ("dt", float("nan")),
        ("start_timestamp_us", -1),
        ("start_timestamp_us", 10**30),
        ("ego_centre_offset", float("inf")),
        ("name", "x" * 5000),
        ("planner", "\ud800"),
        ("other_actors", ("\udfff",)),
    ],
)
def test_unfit_arrays_are_named(rollout: Rollout, field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"Rollout.{field}"):
        replace(rollout, **{field: value}).validate()


def test_another_version_is_refused(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    header = json.loads((tmp_path / "r" / "rollout.json").read_text())
    header["version"] = 1
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
    with pytest.raises(InputError, match=r"rollout\.parquet: column ego_vx: is missing"):
        load_rollout(tmp_path / "r")


def test_a_truncated_table_is_refused(rollout: Rollout, tmp_path: Path) -> None:
    save_rollout(rollout, tmp_path / "r")
    path = tmp_path / "r" / "rollout.parquet"
    pq.write_table(pq.read_table(path).slice(0, 8), path)
    with pytest.raises(InputError, match="steps_run"):
        load_rollout(tmp_path / "r")


def changed(folder: Path, file: str, column: str, values: pa.Array) -> None:
    path = folder / file
    table = pq.read_table(path)
    pq.write_table(table.set_column(table.column_names.index(column), column, values), path)


ONES = pa.array(np.ones(11))
POSES = pa.FixedSizeListArray.from_arrays(pa.array(np.ones(11 * 9)), 9)


@pytest.mark.parametrize(
    ("file", "column", "values", "message"),
    [
        ("rollout", "ego_x", ONES.cast(pa.string()), "holds string, not numbers"),
        ("rollout", "ego_x", pa.array([[1.0]] * 11), "holds list"),
        ("rollout", "ego_x", pa.array([None] * 10 + [1.0]), "row 0: is empty"),
        ("rollout", "ego_x", pa.array([1.0] * 10 + [np.nan]), "row 10: is nan"),
        ("rollout", "ego_x", pa.array([[{"a": 1}]] * 11), "column ego_x"),
        ("rollout", "ego_x", pa.array([b"1"] * 11), "holds binary, not numbers"),
        ("rollout", "ego_vx", pa.array([1e300] * 11), "Rollout.ego: holds a number beyond"),
        ("rollout", "actor_speed", pa.array([-1] * 11), "Rollout.actor: has a negative speed"),
        ("rollout", "world_from_rig", POSES, "has 9 numbers, not 16"),
        ("rollout", "world_from_rig", ONES, "holds double, not lists"),
        ("plans", "plan_step", pa.array(["0", "5"]), "holds string, not numbers"),
        ("plans", "plan_step", pa.array([0.0, 5.0]), "holds float64, not whole numbers"),
        ("plans", "plan_step", pa.array([0, 2**64 - 1], pa.uint64()), "not whole numbers"),
        ("plans", "plan_step", pa.array([5, 0]), "Rollout.plan_steps: must increase"),
        ("plans", "waypoints", pa.array([[1.0], [1.0, 2.0]]), "has 1 numbers, not 120"),
        ("plans", "waypoints", pa.array([[1.0] * 119 + [None]] * 2), "holds NaN"),
        ("route", "x", pa.array(["a"] * 7), "holds string, not numbers"),
        ("route", "y", pa.array([np.inf] * 7), "row 0: is inf"),
    ],
)
def test_columns_of_another_kind_are_one_line(
    rollout: Rollout, tmp_path: Path, file: str, column: str, values: pa.Array, message: str
) -> None:
    save_rollout(rollout, tmp_path / "r")
    changed(tmp_path / "r", f"{file}.parquet", column, values)
    with pytest.raises(InputError) as error:
        load_rollout(tmp_path / "r")
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dt", 0),
        ("dt", -0.1),
        ("start_timestamp_us", 10**30),
        ("steps_requested", -1),
        ("steps_requested", 1 << 80),
        ("actor_size", [0, 0, 0]),
        ("ego_size", [1e99, 1]),
        ("name", "x" * 10_000),
        ("steps_run", 9),
        ("other_actors", [1]),
        ("planner", None),
        ("cut_reason", ["a"]),
    ],
)
def test_a_header_out_of_range_is_one_line(
    rollout: Rollout, tmp_path: Path, field: str, value: object
) -> None:
    save_rollout(rollout, tmp_path / "r")
    path = tmp_path / "r" / "rollout.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), field: value}))
    with pytest.raises(InputError, match=field.split("_")[0]):
        load_rollout(tmp_path / "r")


def test_hostile_names_are_kept_as_text(rollout: Rollout, tmp_path: Path) -> None:
    """They come from logs and plugins; whoever makes a path or a page of them makes them safe."""
    hostile = "../<script>\n\u202e"
    named = replace(rollout, name=hostile, track_id=hostile, planner=hostile)
    save_rollout(named, tmp_path / "r")
    assert load_rollout(tmp_path / "r").track_id == hostile


def test_every_cut_and_flip_is_one_line_or_a_valid_rollout(
    rollout: Rollout, tmp_path: Path
) -> None:
    save_rollout(rollout, tmp_path / "r")
    rng = np.random.default_rng(3)
    for path in sorted((tmp_path / "r").iterdir()):
        whole = path.read_bytes()
        for _ in range(25):
            data = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.5 else whole)
            for at in rng.integers(len(data), size=3) if data else ():
                data[at] = rng.integers(256)
            path.write_bytes(data)
            try:
                load_rollout(tmp_path / "r").validate()
            except InputError as error:
                assert len(str(error)) <= 300 and str(error).isprintable()
        path.write_bytes(whole)
    load_rollout(tmp_path / "r")
