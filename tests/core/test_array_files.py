"""Arrays of NumPy from foreign files: damage is one line, and nothing is unpickled."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.core.table_files import npz_names, read_npy, read_npz

MEND = "mend it"


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.mark.parametrize(
    "array",
    [
        np.arange(24.0).reshape(2, 3, 4),
        np.arange(6, dtype=np.int16).reshape(2, 3).T,
        np.array(7.5),
        np.zeros((0, 3)),
        np.array(["ab", "c"]),
        np.arange(3, dtype=">f4"),
    ],
)
def test_arrays_come_back_as_they_were(tmp_path: Path, array: Any) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(npy(array))
    found = read_npy(path, MEND)
    np.testing.assert_array_equal(found, array)
    assert found.dtype == array.dtype and found.flags.writeable
    np.savez_compressed(tmp_path / "a.npz", a=array, b=[1])
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz", MEND)["a"], array)
    assert list(read_npz(tmp_path / "a.npz", MEND, ["b"])) == ["b"]
    assert npz_names(tmp_path / "a.npz", MEND) == ["a", "b"]


def changed(header: str) -> bytes:
    """A file of eight float32 with another header of the same length."""
    data = npy(np.zeros(8, np.float32))
    length = int.from_bytes(data[8:10], "little")
    return data[:10] + header.ljust(length - 1).encode() + b"\n" + data[10 + length :]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "cannot be read"),
        (b"\x93NUMPY\x01\x00", "cannot be read"),
        (b"\x93NUMPY\x09\x00" + bytes(200), "cannot be read"),
        (b"PK\x05\x06" + bytes(18), "cannot be read"),
        (pickle.dumps([1]), "cannot be read"),
        (changed("{'descr': '<f4', 'fortran_order': False, 'shape': (8"), "cannot be read"),
        (changed("{'descr': '<f4', 'fortran_order': False, 'shape': [8]}"), "cannot be read"),
        (changed("(" * 100), "cannot be read"),
        (changed("{'descr': '<f4', 'fortran_order': False, 'shape': (10**9,)}"), "cannot be read"),
        (
            changed("{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999,)}"),
            "cannot be read",
        ),
        (changed("{'descr': '<f4', 'fortran_order': False, 'shape': (-2, -4)}"), "cannot be read"),
        (
            changed("{'descr': '<f4', 'fortran_order': False, 'shape': (7,)}"),
            "has 4 bytes after its values",
        ),
        (changed("{'descr': '|O', 'fortran_order': False, 'shape': (4,)}"), "never loaded"),
        (changed("{'descr': '|V4', 'fortran_order': False, 'shape': (8,)}"), "not plain values"),
        (
            changed("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (8,)}"),
            "not plain values",
        ),
    ],
)
def test_a_damaged_array_is_one_line(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_npy(path, MEND)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", data)
    with pytest.raises(InputError, match=message):
        read_npz(tmp_path / "a.npz", MEND)


def test_archives_that_grow_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "zeros.npz"
    np.savez_compressed(path, a=np.zeros(1 << 20), b=np.zeros(1 << 20))
    assert path.stat().st_size < 100_000
    assert len(read_npz(path, MEND, limit=(16 << 20) + 1000)) == 2
    with pytest.raises(InputError, match=r"array b: has 8388\d+ bytes, \d+ are read at most"):
        read_npz(path, MEND, limit=9 << 20)
    with pytest.raises(InputError, match="array c: is missing"):
        read_npz(path, MEND, ["c"])
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="archive: cannot be read"):
        read_npz(path, MEND)
    with pytest.raises(InputError, match="file: is missing"):
        read_npz(tmp_path / "none.npz", MEND)
