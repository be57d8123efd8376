from __future__ import annotations

import os
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.core.torch_file import read_torch_file
from recast_bridges.scenes import checkpoint
from recast_bridges.scenes.checkpoint import PickledArray, PickledQuaternion, read_pickle

ARRAYS = {
    "turned": np.arange(6.0).reshape(2, 3).T,
    "whole": np.array([[1, -2]], np.int16),
    "big": np.array([1.5, -2], ">f8"),
    "flags": np.array([True, False]),
    "names": np.array(["car", "pedestrian"]),
    "objects": np.array(["a", None], object),
    "none": np.zeros((0, 4)),
    "one": np.array(3.0),
}


def read(tmp_path: Path, data: bytes) -> Any:
    path = tmp_path / "x.pkl"
    path.write_bytes(data)
    return read_pickle(path, "mend it")


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_and_plain_values_are_read(tmp_path: Path, protocol: int) -> None:
    plain = {"text": "ä", "list": [1, (2.5, None)], 3: b"abc", "table": {"x": True}}
    numbers = {"f": np.float64(2.5), "i": np.int64(-7), "b": np.bool_(True)}
    value = OrderedDict({**plain, **ARRAYS, **numbers})
    found = read(tmp_path, pickle.dumps(value, protocol))
    assert list(found) == list(value)
    for name, one in plain.items():
        assert found[name] == one
    for name, array in ARRAYS.items():
        assert np.array_equal(found[name].value, array), name
        assert found[name].value.dtype == array.dtype
    assert [found[name] for name in numbers] == [2.5, -7, True]


class Quaternion:
    """Stands for pyquaternion's class in the pickles of this test."""

    def __init__(self, *wxyz: float) -> None:
        self.q = np.array(wxyz)


def test_quaternions_are_read_without_their_package(tmp_path: Path) -> None:
    data = pickle.dumps(Quaternion(0.5, 0.5, 0.5, -0.5), 2)
    named = f"{__name__}\nQuaternion\n".encode()
    assert named in data
    found = read(tmp_path, data.replace(named, b"pyquaternion.quaternion\nQuaternion\n"))
    assert isinstance(found, PickledQuaternion)
    assert found.value.tolist() == [0.5, 0.5, 0.5, -0.5]


class Hostile:
    def __init__(self, call: Any, *arguments: Any) -> None:
        self.call = call, arguments

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("call", [os.mkdir, eval, getattr, np.load])
def test_nothing_that_a_pickle_names_is_run(tmp_path: Path, protocol: int, call: Any) -> None:
    ran = tmp_path / "ran"
    arguments = {eval: f"__import__('os').mkdir({str(ran)!r})"}.get(call, str(ran))
    with pytest.raises(InputError, match="which is never unpickled; mend it"):
        read(tmp_path, pickle.dumps([Hostile(call, arguments)], protocol))
    assert not ran.exists()


ARRAY = b"cnumpy._core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntC\x01btR"
FLOATS = b"cnumpy\ndtype\n(X\x02\x00\x00\x00f8tR"


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (b"\x80\x04\x8e" + b"\xff" * 7 + b"\x00.", "is damaged"),  # bytes of 2^56
        (b"\x80\x04r\xff\xff\xff\xff.", "is damaged"),  # place 2^32 of the memory of values
        (ARRAY + b"(I1\n(L1000000000000L\ntI01\nI00\nC\x01atb.", "an array that is not NumPy's"),
        (ARRAY + b"(I1\n(L1000000000000L\nt" + FLOATS + b"I00\nC\x01atb.", "that it lacks"),
        (ARRAY + b"(I1\n(I-1\nt" + FLOATS + b"I00\nC\x00tb.", "an array without a shape"),
        (b"cnumpy\ndtype\n(X\x03\x00\x00\x00V99tR.", "an array of type 'V99'"),
        (b"cnumpy\nndarray\n}X\x05\x00\x00\x00valueX\x01\x00\x00\x00asb.", "a state of an object"),
        (b"ccollections\nOrderedDict\n(](I1\nI2\ntatR.", "is damaged"),
        (b"}((((tttI1\ns.", "keys that are neither texts nor numbers"),
        (b"](I1\nI2\nu.", "members of an object that is not a table"),
        (b"(I1\nios\nsystem\n.", "is damaged"),  # the instruction INST
        (b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.", "is damaged|holds pickle"),
        (b"c_codecs\nencode\n(Vabc\nVzlib\ntR.", "bytes in an unknown encoding"),
        (b"", "is damaged"),
    ],
)
def test_what_is_not_there_takes_no_memory(tmp_path: Path, data: bytes, line: str) -> None:
    with pytest.raises(InputError, match=line):
        read(tmp_path, data)


def test_large_pickles_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recast_bridges.scenes.checkpoint.LARGEST", 100)
    assert read(tmp_path, pickle.dumps(b"1" * 50)) == b"1" * 50
    with pytest.raises(InputError, match="100 are read at most"):
        read(tmp_path, pickle.dumps(b"1" * 101))


def test_tuples_in_tuples_without_end_are_refused_as_keys(tmp_path: Path) -> None:
    deep = b"}" + b"(" * 10 + b"I1\n" + b"t" * 10 + b"I1\ns."
    with pytest.raises(InputError, match="keys that are neither"):
        read(tmp_path, deep)
    with pytest.raises(InputError, match="keys that are neither"):
        read(tmp_path, b"}" + b"(" * 200_000 + b"I1\n" + b"t" * 200_000 + b"I1\ns.")


def test_checkpoints_hold_arrays_where_they_may(tmp_path: Path) -> None:
    path = tmp_path / "x.ckpt"
    before = set(torch.serialization.get_safe_globals())
    torch.save({"shift": ARRAYS["turned"], "scale": np.float64(2.5), "t": torch.ones(2)}, path)
    found = read_torch_file(path, "mend it", safe=checkpoint.ARRAYS)
    assert isinstance(found["shift"], PickledArray) and found["scale"] == 2.5
    assert np.array_equal(found["shift"].value, ARRAYS["turned"])
    assert set(torch.serialization.get_safe_globals()) == before
    with pytest.raises(InputError, match="never unpickled"):
        read_torch_file(path, "mend it")


def test_calls_in_checkpoints_are_refused_where_arrays_are_read(tmp_path: Path) -> None:
    path, ran = tmp_path / "x.ckpt", tmp_path / "ran"
    torch.save({"shift": ARRAYS["turned"], "x": Hostile(os.mkdir, str(ran))}, path)
    with pytest.raises(InputError, match="mkdir, which is not a tensor"):
        read_torch_file(path, "mend it", safe=checkpoint.ARRAYS)
    assert not ran.exists()
