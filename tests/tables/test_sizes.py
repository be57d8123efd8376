"""What a table takes in memory is known, and refused, before it is decoded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

from recast.core.errors import InputError
from recast.tables import ParquetRows, check_batches, read_feather, read_parquet
from recast.tables import arrow as feather_module
from recast.tables.arrow import declared_size
from recast.tables.encodings import Compact
from recast.tables.parquet import read_footer

MEND = "mend it"
ZEROS = pa.table({"x": np.zeros(1 << 20)})  # 8 MiB


def refused(read: Callable[[], object], match: str) -> None:
    """`read` is refused, and Arrow has not taken a mebibyte for it, all its buffers together."""
    pool = pa.default_memory_pool()
    before = pool.total_bytes_allocated()
    with pytest.raises(InputError, match=match):
        read()
    assert pool.total_bytes_allocated() - before < 1 << 20


def test_a_feather_file_is_as_large_as_its_buffers_say(tmp_path: Path) -> None:
    table = pa.table({"a": np.arange(1000), "b": np.arange(1000, dtype=np.float32)})
    for compression in ("uncompressed", "lz4", "zstd"):
        path = tmp_path / f"{compression}.feather"
        feather.write_feather(table, str(path), compression=compression, chunksize=300)
        rows, size = declared_size(path.read_bytes())
        assert rows == 1000
        # Uncompressed buffers may be stored with up to 63 bytes of padding each.
        assert 12_000 <= size <= 12_000 + 8 * 64
        assert read_feather(path, ["a", "b"], MEND).data.equals(table)


def test_a_feather_file_that_would_grow_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "zeros.feather"
    feather.write_feather(ZEROS, str(path), compression="zstd")
    assert path.stat().st_size < 10_000
    assert len(read_feather(path, ["x"], MEND)) == 1 << 20
    monkeypatch.setattr(feather_module, "FEATHER_LIMIT", 1 << 22)
    match = f"claims {1 << 20} rows and {8 << 20} bytes"
    refused(lambda: read_feather(path, ["x"], MEND), match)


def test_a_buffer_that_claims_a_terabyte_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lie.feather"
    feather.write_feather(pa.table({"x": np.zeros(1000)}), str(path), compression="lz4")
    data = path.read_bytes()
    claim = (8000).to_bytes(8, "little")
    assert data.count(claim) == 1
    path.write_bytes(data.replace(claim, (1 << 40).to_bytes(8, "little")))
    match = f"claims 1000 rows and {1 << 40} bytes"
    refused(lambda: read_feather(path, ["x"], MEND), match)


def test_an_arrow_file_for_another_library_is_checked_batch_by_batch(tmp_path: Path) -> None:
    path = tmp_path / "log.arrow"
    feather.write_feather(ZEROS, str(path), compression="zstd", chunksize=1 << 18)
    check_batches(path, MEND, 4 << 20)
    with pytest.raises(InputError, match=f"Arrow file: a batch claims {2 << 20} bytes; mend it"):
        check_batches(path, MEND, 1 << 20)
    text = pa.Array.from_buffers(pa.string(), 1, pa.array([b"\xff"], pa.binary()).buffers())
    feather.write_feather(pa.table({"t": text}), str(path))
    with pytest.raises(InputError, match=r"Arrow file: cannot be read .*UTF8"):
        check_batches(path, MEND, 1 << 20)


def test_feather_of_version_1_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.feather"
    path.write_bytes(b"FEA1" + bytes(200) + b"FEA1")
    with pytest.raises(InputError, match="feather version 1; write it again"):
        read_feather(path, ["x"], MEND)


@pytest.mark.parametrize("options", [{}, {"data_page_version": "2.0"}, {"use_dictionary": False}])
def test_a_parquet_file_that_would_grow_is_refused(tmp_path: Path, options: dict) -> None:
    path = tmp_path / "zeros.parquet"
    pq.write_table(ZEROS, path, compression="zstd", **options)
    assert len(read_parquet(path, ["x"], MEND)) == 1 << 20
    match = r"takes \d+ bytes in memory|of more than 1024 bytes in memory"
    read_parquet(path, ["x"], MEND, limit=32 << 20)
    refused(lambda: read_parquet(path, ["x"], MEND, limit=1 << 10), match)


def test_a_page_that_claims_more_than_its_column_does_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "lie.parquet"
    pq.write_table(pa.table({"x": np.zeros(1000)}), path, use_dictionary=False)
    data = path.read_bytes()
    with path.open("rb") as stream:
        _, groups = read_footer(stream, len(data))
    start = groups[0].columns[0][9]
    header = Compact(data[start:]).struct()
    claimed = zigzag(header[2])
    at = data.index(claimed, start)
    lie = zigzag((1 << 31) - 1)
    shift = len(lie) - len(claimed)
    grown = data[:at] + lie + data[at + len(claimed) :]
    footer = int.from_bytes(data[-8:-4], "little")
    stored = zigzag(groups[0].columns[0][7])
    end = len(grown) - 8 - footer
    assert len(zigzag(groups[0].columns[0][7] + shift)) == len(stored)
    fixed = grown[end:].replace(stored, zigzag(groups[0].columns[0][7] + shift))
    path.write_bytes(grown[:end] + fixed)
    match = r"takes 4\d{9} bytes in memory"
    refused(lambda: read_parquet(path, ["x"], MEND), match)


def zigzag(value: int) -> bytes:
    """A non-negative number in Thrift's compact encoding."""
    value <<= 1
    data = b""
    while value > 127:
        data += bytes([value & 127 | 128])
        value >>= 7
    return data + bytes([value])


def test_a_long_text_that_many_rows_share_is_read_few_rows_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "texts.parquet"
    pq.write_table(pa.table({"t": ["x" * 100_000] * 500}), path)
    assert path.stat().st_size < 10_000
    rows = ParquetRows(path, ["t"], MEND, limit=2 << 20)
    sizes = [batch.num_rows for batch in rows.batches(0)]
    assert sum(sizes) == 500 and max(sizes) * 100_000 <= 2 << 20
    with pytest.raises(InputError, match="has 500 rows of more than 2097152 bytes in memory"):
        read_parquet(path, ["t"], MEND, limit=2 << 20)


def test_texts_as_changes_are_refused(tmp_path: Path) -> None:
    # A million texts, each the one before and one letter, take half a terabyte and little on disk.
    path = tmp_path / "changes.parquet"
    table = pa.table({"t": ["a", "ab", "abc"]})
    pq.write_table(table, path, use_dictionary=False, column_encoding={"t": "DELTA_BYTE_ARRAY"})
    with pytest.raises(InputError, match="delta-encoded texts are not supported"):
        read_parquet(path, ["t"], MEND)


def test_a_footer_of_megabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "footer.parquet"
    path.write_bytes(b"PAR1" + bytes(2 << 20) + (2 << 20).to_bytes(4, "little") + b"PAR1")
    with pytest.raises(InputError, match="its footer has 2097152 bytes, 1048576 are read at most"):
        read_parquet(path, ["x"], MEND)
