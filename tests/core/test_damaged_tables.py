"""Damaged metadata of tables: refused in one line or harmless, and never the end of the process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

PROGRAM = Path(__file__).with_name("every_byte.py")
TABLE = pa.table(
    {
        "number": pa.array([1, None, 3, 4] * 5),
        "text": [f"name {i % 7}" for i in range(20)],
        "half": np.arange(20).astype(np.float16),
    }
)


@pytest.mark.parametrize("kind", ["feather", "parquet"])
def test_no_byte_of_the_metadata_can_end_the_process(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"table.{kind}"
    if kind == "parquet":
        pq.write_table(TABLE, path, store_schema=False)
        footer = int.from_bytes(path.read_bytes()[-8:-4], "little")
        first = path.stat().st_size - 8 - footer
    else:
        feather.write_feather(TABLE, str(path), compression="lz4")
        first = path.stat().st_size - 500  # the footer, and the end of the last message
    command = [sys.executable, str(PROGRAM), str(path), str(first)]
    found = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0, found.stderr[-2000:]
    accepted, refused = (int(count) for count in found.stdout.split())
    assert accepted > 0 and refused > 100
