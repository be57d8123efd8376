"""Headers of safetensors files: sizes to the byte, and nothing believed that is not checked."""

from __future__ import annotations

import json
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save, save_file

from recast.core.errors import InputError
from recast.core.torch_file import DTYPES, read_header
from recast.trellis.model_files import file_bytes
from support.trellis import FOLDER

TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.ones(4, dtype=torch.float16)}


@given(
    shapes=st.dictionaries(
        st.text(min_size=1, max_size=6).filter(lambda name: name != "__metadata__"),
        st.tuples(
            st.sampled_from(sorted(DTYPES)), st.lists(st.integers(0, 4), max_size=3).map(tuple)
        ),
        max_size=6,
    )
)
@settings(max_examples=60, deadline=None)
def test_the_size_of_a_file_is_known_before_it_is_written(
    shapes: dict[str, tuple[str, tuple[int, ...]]],
) -> None:
    tensors = {
        name: torch.zeros(shape, dtype=DTYPES[code]) for name, (code, shape) in shapes.items()
    }
    assert file_bytes(tensors) == len(save(tensors))


def test_every_golden_file_is_read_with_its_names_shapes_and_types() -> None:
    for path in sorted(FOLDER.glob("*.safetensors")):
        assert path.stat().st_size == file_bytes(read_header(path, "download it again"))


def test_metadata_is_allowed(tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    path.write_bytes(save(TENSORS, metadata={"format": "pt"}))
    found = read_header(path, "download it again")
    assert all(tensor.is_meta for tensor in found.values())
    assert {name: (one.dtype, one.shape) for name, one in found.items()} == {
        name: (one.dtype, one.shape) for name, one in TENSORS.items()
    }


def rewritten(change: Callable[[dict[str, dict[str, object]]], object]) -> bytes:
    """The file of TENSORS with another header over the same data."""
    data = save(TENSORS)
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:end])
    change(header)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data[end:]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "has 0 bytes: truncated"),
        (b"\x10\0\0", "has 3 bytes: truncated"),
        (b"\xff" * 64, "header too large"),
        (save(TENSORS)[:40], "truncated"),
        (save(TENSORS)[:-1], "truncated"),
        (save(TENSORS) + b"\0", "not fully covered"),
        (b"\x04\0\0\0\0\0\0\0nope", "invalid JSON"),
        (b"\x02\0\0\0\0\0\0\0[]", "invalid JSON"),
        (b"\x08\x27\0\0\0\0\0\0" + b"[" * 9992, "invalid JSON"),
        (b"PK\x03\x04" + b"\0" * 60, "pickled PyTorch file"),
        (pickle.dumps({"a": 1}), "pickled PyTorch file"),
        (b"<!DOCTYPE html><html><body>404</body></html>", "header too large"),
        (rewritten(lambda h: h["a"].update(dtype="F8_E4M3")), "shape, data type, or offset"),
        (rewritten(lambda h: h["a"].update(dtype=["F32"])), "invalid JSON"),
        (rewritten(lambda h: h["a"].update(shape=[2, -3])), "invalid JSON"),
        (rewritten(lambda h: h["a"].update(shape=[True, 6])), "invalid JSON"),
        (rewritten(lambda h: h["a"].update(shape=[2, 4])), "shape, data type, or offset"),
        (rewritten(lambda h: h["a"].update(data_offsets=[0, 24, 32])), "invalid JSON"),
        (rewritten(lambda h: h["a"].update(data_offsets=[8, 32])), "invalid offset for tensor `a`"),
        (rewritten(lambda h: h.update(a=3)), "invalid JSON"),
        (rewritten(lambda h: h.pop("b")), "not fully covered"),
    ],
)
def test_a_file_that_is_no_whole_safetensors_file(
    tmp_path: Path, data: bytes, message: str
) -> None:
    path = tmp_path / "x.safetensors"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_header(path, "download it again")
    assert "\n" not in str(caught.value)


def test_an_element_type_that_no_network_has(tmp_path: Path) -> None:
    save_file({"a": torch.zeros(2, dtype=torch.float8_e4m3fn)}, tmp_path / "x.safetensors")
    with pytest.raises(InputError, match="a: has an unknown element type"):
        read_header(tmp_path / "x.safetensors", "download it again")


def test_a_shape_beyond_all_numbers(tmp_path: Path) -> None:
    text = b'{"a":{"dtype":"U8","shape":[0,9223372036854775807,9],"data_offsets":[0,0]}}'
    path = tmp_path / "x.safetensors"
    path.write_bytes(len(text).to_bytes(8, "little") + text)
    with pytest.raises(InputError):
        read_header(path, "download it again")


@given(cut=st.integers(0, 400), flip=st.integers(0, 255))
@settings(max_examples=80, deadline=None)
def test_damage_is_refused_or_leaves_a_header_within_the_file(cut: int, flip: int) -> None:
    data = bytearray(save(TENSORS))
    data[cut % len(data)] ^= flip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.safetensors"
        path.write_bytes(data)
        try:
            header = read_header(path, "download it again")
        except InputError:
            return
        assert sum(tensor.nbytes for tensor in header.values()) < len(data)


@pytest.mark.parametrize("missing", ["no.safetensors", "."])
def test_a_file_that_cannot_be_opened(tmp_path: Path, missing: str) -> None:
    with pytest.raises(InputError, match="check the path"):
        read_header(tmp_path / missing, "download it again")
