from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import pytest
import torch

from recast.core.errors import InputError
from recast.core.torch_file import read_tensors, read_torch_file

LARGE = torch.zeros(1).expand(10**8, 40, 3)  # 48 GB as soon as anything copies it


def saved(path: Path, value: Any) -> Path:
    torch.save(value, path)
    return path


@pytest.mark.parametrize(
    "value",
    [{"a": LARGE}, [1, [LARGE]], LARGE, {"deep": {"er": (LARGE,)}}],
)
def test_a_tensor_larger_than_what_is_stored_of_it_is_refused(tmp_path: Path, value: Any) -> None:
    path = saved(tmp_path / "x.pt", value)
    assert path.stat().st_size < 10_000
    with pytest.raises(InputError, match="4 bytes are stored"):
        read_torch_file(path, "mend it")


def test_sparse_tensors_are_refused(tmp_path: Path) -> None:
    sparse = torch.sparse_coo_tensor(torch.tensor([[0]]), torch.ones(1), (10**12,))
    with pytest.raises(InputError, match="sparse"):
        read_torch_file(saved(tmp_path / "x.pt", {"a": sparse}), "mend it")


def test_compressed_members_are_refused(tmp_path: Path) -> None:
    plain = saved(tmp_path / "plain.pt", {"a": torch.zeros(1_000_000)})
    small = tmp_path / "small.pt"
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(small, "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name), zipfile.ZIP_DEFLATED)
    assert small.stat().st_size < plain.stat().st_size / 100
    with pytest.raises(InputError, match="is compressed"):
        read_torch_file(small, "mend it")


def test_views_and_shared_storages_are_read(tmp_path: Path) -> None:
    whole = torch.arange(12.0).reshape(3, 4)
    state = {"whole": whole, "tied": whole, "turned": whole.T, "row": whole[1], "none": whole[:0]}
    found = read_tensors(saved(tmp_path / "x.pt", state), "state", "mend it")
    assert all(torch.equal(found[name], tensor) for name, tensor in state.items())


def test_a_list_that_holds_itself_ends(tmp_path: Path) -> None:
    value: list[Any] = [torch.zeros(2)]
    value.append(value)
    assert read_torch_file(saved(tmp_path / "x.pt", value), "mend it")[1]
