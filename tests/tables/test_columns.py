"""Columns of tables: the same out of feather and parquet, and checked when asked for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

from recast.core.errors import InputError
from recast.tables import ArrowTable, ParquetRows, read_feather, read_parquet

MEND = "mend it"
Write = Callable[[pa.Table, Path], ArrowTable]


def through_feather(table: pa.Table, folder: Path) -> ArrowTable:
    feather.write_feather(table, str(folder / "t.feather"), chunksize=3)
    return read_feather(folder / "t.feather", table.column_names, MEND)


def through_parquet(table: pa.Table, folder: Path) -> ArrowTable:
    pq.write_table(table, folder / "t.parquet", row_group_size=3)
    return read_parquet(folder / "t.parquet", table.column_names, MEND)


both = pytest.mark.parametrize("through", [through_feather, through_parquet])


@both
def test_columns_come_back_as_they_were(tmp_path: Path, through: Write) -> None:
    words = ["a", "b", "ü", "a", "", "b", "c"]
    written = pa.table(
        {
            "int": np.arange(7),
            "half": np.linspace(0, 1, 7).astype(np.float16),
            "byte": np.arange(7, dtype=np.uint8),
            "word": words,
            "named": pa.array(words).dictionary_encode(),
            "large": pa.array(words, pa.large_string()),
        }
    )
    table = through(written, tmp_path)
    assert len(table) == 7
    for name in ("int", "half", "byte"):
        found = table.numbers(name)
        assert found.dtype == written[name].to_numpy().dtype
        np.testing.assert_array_equal(found, written[name].to_numpy())
    for name in ("word", "named", "large"):
        assert table.words(name).tolist() == words


def test_lists_have_one_width(tmp_path: Path) -> None:
    values = np.arange(14.0).reshape(7, 2)
    fixed = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), 2)
    table = through_parquet(pa.table({"v": values.tolist(), "f": fixed}), tmp_path)
    for name in ("v", "f"):
        np.testing.assert_array_equal(table.lists(name, 2), values)
        with pytest.raises(InputError, match=f"column {name}, row 0: has 2 numbers, not 3"):
            table.lists(name, 3)
    empty = through_parquet(pa.table({"v": pa.array([], pa.list_(pa.float64()))}), tmp_path)
    assert empty.lists("v", 2).shape == (0, 2)


def bad_text() -> pa.Array:
    data = pa.array([b"ok", b"\xff\xfe", b"ok"], pa.binary())
    return pa.Array.from_buffers(pa.string(), 3, data.buffers())


@both
@pytest.mark.parametrize(
    ("column", "ask", "message"),
    [
        ([1.0, np.nan, 2.0], "numbers", "column c, row 1: is nan, not a number"),
        (pa.array([1, None]), "numbers", "column c, row 1: is empty"),
        (["a"], "numbers", "column c: holds string, not numbers"),
        ([1.0], "words", "column c: holds double, not text"),
        (pa.array(["a", None]), "words", "column c, row 1: is empty"),
        (pa.array(["a", None, "b"]).dictionary_encode(), "words", "column c, row 1: is empty"),
        (bad_text(), "words", "cannot be read .*UTF8"),
        ([{"a": 1}], "words", "column c: holds struct<a: int64>, not numbers, text, bytes"),
        ([["a"]], "words", "column c: holds list<"),
        (pa.array([1], pa.timestamp("us")), "numbers", "column c: holds timestamp"),
    ],
)
def test_a_wrong_column_is_one_line(
    tmp_path: Path, through: Write, column: Any, ask: str, message: str
) -> None:
    with pytest.raises(InputError, match=message) as raised:
        getattr(through(pa.table({"c": column}), tmp_path), ask)("c")
    assert str(raised.value).endswith("; mend it") and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[1.0, 2.0], [1.0, None]], "row 1: holds NaN"),
        ([[1.0, 2.0], None], "row 1: is empty"),
        ([[1.0, 2.0], [1.0]], "row 1: has 1 numbers, not 2"),
        ([[1.0, 2.0], [1.0, float("inf")]], "row 1: holds NaN or infinity"),
    ],
)
def test_a_wrong_list_is_one_line(tmp_path: Path, rows: list, message: str) -> None:
    with pytest.raises(InputError, match=f"column c, {message}"):
        through_parquet(pa.table({"c": rows}), tmp_path).lists("c", 2)


@pytest.mark.parametrize(("suffix", "read"), [("feather", read_feather), ("parquet", read_parquet)])
def test_a_column_is_there_once(tmp_path: Path, suffix: str, read: Any) -> None:
    path = tmp_path / f"t.{suffix}"
    with pytest.raises(InputError, match=f"{path}: file: is missing; mend it"):
        read(path, ["a"], MEND)
    table = pa.table([[1], [2]], names=["a", "a"])
    write = {
        "feather": lambda: feather.write_feather(table, str(path)),
        "parquet": lambda: pq.write_table(table, path),
    }
    write[suffix]()
    for column, problem in (("a", "occurs twice"), ("b", "is missing")):
        with pytest.raises(InputError, match=f"column {column}: {problem}"):
            read(path, [column], MEND)
    path.write_bytes(b"no table")
    with pytest.raises(InputError, match="cannot be read"):
        read(path, ["a"], MEND)


def test_rows_of_parquet_come_in_order(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    pq.write_table(pa.table({"a": np.arange(10), "b": np.arange(10)}), path, row_group_size=4)
    rows = ParquetRows(path, ["b"], MEND)
    assert rows.first_rows.tolist() == [0, 4, 8, 10]
    found = [batch.to_pydict() for batch in rows.batches(1, rows_at_once=3)]
    assert found == [{"b": [4, 5, 6]}, {"b": [7]}]
