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

from recast.core import table_files
from recast.core.errors import InputError
from recast.core.table_files import (
    ArrowTable,
    ParquetRows,
    check_batches,
    read_feather,
    read_parquet,
)

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


ZEROS = pa.table({"x": np.zeros(1 << 20)})  # 8 MiB


@pytest.mark.parametrize(("suffix", "read"), [("feather", read_feather), ("parquet", read_parquet)])
def test_a_table_that_grows_in_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, read: Any
) -> None:
    path = tmp_path / f"zeros.{suffix}"
    if suffix == "feather":
        feather.write_feather(ZEROS, str(path), compression="zstd")
    else:
        pq.write_table(ZEROS, path, compression="zstd")
    assert path.stat().st_size < 10_000
    assert len(read(path, ["x"], MEND)) == 1 << 20
    monkeypatch.setattr(table_files, "TABLE_LIMIT", 1 << 22)
    with pytest.raises(InputError, match=rf"has over {1 << 22} rows, or over {1 << 22} bytes"):
        read(path, ["x"], MEND)
    monkeypatch.setattr(table_files, "TABLE_LIMIT", 1 << 28)
    monkeypatch.setattr(table_files, "ROW_LIMIT", 1 << 19)
    with pytest.raises(InputError, match=r"has over 524288 rows|has 1048576 rows"):
        read(path, ["x"], MEND)


def test_a_buffer_that_claims_a_petabyte_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lie.feather"
    feather.write_feather(pa.table({"x": np.zeros(1000)}), str(path), compression="lz4")
    data = path.read_bytes()
    claim = (8000).to_bytes(8, "little")
    assert data.count(claim) == 1
    path.write_bytes(data.replace(claim, (1 << 50).to_bytes(8, "little")))
    with pytest.raises(InputError, match="feather table: cannot be read"):
        read_feather(path, ["x"], MEND)


def test_an_arrow_file_for_another_library_is_checked_batch_by_batch(tmp_path: Path) -> None:
    path = tmp_path / "log.arrow"
    feather.write_feather(ZEROS, str(path), compression="zstd", chunksize=1 << 18)
    check_batches(path, MEND, 4 << 20)
    with pytest.raises(InputError, match=f"Arrow file: has a batch of {2 << 20} bytes"):
        check_batches(path, MEND, 1 << 20)
    feather.write_feather(pa.table({"t": bad_text()}), str(path))
    with pytest.raises(InputError, match=r"Arrow file: cannot be read .*UTF8"):
        check_batches(path, MEND, 1 << 20)


def test_feather_of_version_1_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.feather"
    path.write_bytes(b"FEA1" + bytes(200) + b"FEA1")
    with pytest.raises(InputError, match="the file is a feather file of version 1"):
        read_feather(path, ["x"], MEND)


def test_a_piece_of_parquet_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "texts.parquet"
    pq.write_table(pa.table({"t": ["x" * 100_000] * 500}), path)
    rows = ParquetRows(path, ["t"], MEND)
    monkeypatch.setattr(table_files, "STREAM_LIMIT", 2 << 20)
    assert sum(batch.num_rows for batch in rows.batches(0, rows_at_once=10)) == 500
    with pytest.raises(InputError, match="row group 0: holds more than 2097152 bytes"):
        next(rows.batches(0))
