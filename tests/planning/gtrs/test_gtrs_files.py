"""Checkpoints, folders and vocabularies: what is read, and what is refused in one line."""

from __future__ import annotations

import errno
import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from recast.core.errors import InputError
from recast.planning.gtrs import (
    WAYMO_NATIVE,
    GtrsModel,
    GtrsPlanner,
    load_checkpoint,
    load_gtrs,
    read_vocabulary,
    save_gtrs,
    write_vocabulary,
)
from recast.planning.gtrs.planner import PREFIX, VOCABULARY
from support.tiny_gtrs import TINY, fan

State = dict[str, torch.Tensor]


@pytest.fixture
def state(tiny_model: GtrsModel) -> State:
    """A whole state dict under released names, unused modules and vocabulary included."""
    unused = {"_query_embedding.weight": torch.zeros(30, 32), "_agent_head.x": torch.zeros(2)}
    return dict(tiny_model.state_dict()) | unused | {VOCABULARY: torch.from_numpy(fan(20))}


def _lightning(state: State, path: Path) -> Path:
    content = {
        "epoch": 19,
        "state_dict": {PREFIX + name: tensor for name, tensor in state.items()},
        "optimizer_states": [{"lr": 2e-4}],
    }
    torch.save(content, path)
    return path


def _refusal(action: Callable[[], object]) -> str:
    with pytest.raises(InputError) as caught:
        action()
    error = caught.value
    assert "\n" not in str(error)
    return f"{error.where}: {error.field}: {error.problem}; {error.mend}"  # not shortened


def test_a_lightning_checkpoint(state: State, tmp_path: Path) -> None:
    path = _lightning(state, tmp_path / "epoch.ckpt")
    planner = load_checkpoint(path, config=TINY)
    np.testing.assert_array_equal(planner.vocabulary, fan(20))
    assert planner.views == WAYMO_NATIVE and not planner.model.training
    for name, tensor in planner.model.state_dict().items():
        assert torch.equal(tensor, state[name])


def test_a_vocabulary_file_replaces_the_one_inside(state: State, tmp_path: Path) -> None:
    write_vocabulary(tmp_path / "mine.npy", fan(7))
    path = _lightning(state, tmp_path / "epoch.ckpt")
    planner = load_checkpoint(path, tmp_path / "mine.npy", config=TINY)
    np.testing.assert_array_equal(planner.vocabulary, fan(7))


def test_plain_state_dicts_and_safetensors(state: State, tmp_path: Path) -> None:
    halved = {name: tensor.half() if "conv" in name else tensor for name, tensor in state.items()}
    torch.save(halved, tmp_path / "plain.pth")
    save_file(state, tmp_path / "weights.safetensors")
    from_pth = load_checkpoint(tmp_path / "plain.pth", config=TINY).model
    from_safetensors = load_checkpoint(tmp_path / "weights.safetensors", config=TINY).model
    assert all(p.dtype == torch.float32 for p in from_pth.parameters())
    for name, tensor in from_safetensors.state_dict().items():
        assert torch.equal(tensor, state[name])


def _without(name: str) -> Callable[[State], State]:
    return lambda state: {k: v for k, v in state.items() if k != name}


def _with(name: str, tensor: torch.Tensor) -> Callable[[State], State]:
    return lambda state: state | {name: tensor}


FAULTS: dict[str, tuple[Callable[[State], State], str]] = {
    "missing": (
        _without("downscale_layer.bias"),
        r"downscale_layer.bias: is missing \(1 missing\)",
    ),
    "unexpected": (
        _with("_trajectory_head.heads.comfort.0.weight", torch.zeros(1)),
        r"heads.comfort.0.weight: is not expected \(1 unexpected\)",
    ),
    "shape": (
        _with("_status_encoding.weight", torch.zeros(32, 9)),
        r"_status_encoding.weight: is float32 \[32, 9\], not float32 \[32, 8\]",
    ),
    "type": (
        _with("_status_encoding.bias", torch.zeros(32, dtype=torch.int64)),
        r"_status_encoding.bias: is int64",
    ),
    "not finite": (
        _with("_status_encoding.bias", torch.full((32,), torch.nan)),
        r"_status_encoding.bias: holds NaN or infinite values \(1 not finite\)",
    ),
    "several": (
        lambda state: _without("downscale_layer.bias")(_with("extra", torch.zeros(1))(state)),
        r"1 missing, 1 unexpected",
    ),
    "no vocabulary": (_without(VOCABULARY), r"_trajectory_head.vocab: is missing; give a vocab"),
    "bad vocabulary": (_with(VOCABULARY, torch.zeros(5, 8, 3)), r"has shape \(5, 8, 3\)"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_weights(fault: str, state: State, tmp_path: Path) -> None:
    change, message = FAULTS[fault]
    path = _lightning(change(state), tmp_path / "epoch.ckpt")
    line = _refusal(lambda: load_checkpoint(path, config=TINY))
    assert line.startswith(f"{path}: ")
    with pytest.raises(InputError, match=message):
        load_checkpoint(path, config=TINY)


class _Bomb:
    def __reduce__(self) -> Any:
        return (os.getcwd, ())


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK\x03\x04 but no archive",
        b"\x80\x02 but no pickle",
        b"\xff" * 64,
        b"\x10\x00\x00\x00\x00\x00\x00\x00" + b"{" * 16,
        pickle.dumps({"state_dict": _Bomb()}, 2),
        pickle.dumps([1, 2], 2),
    ],
)
def test_files_that_are_no_weights(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "weights"
    path.write_bytes(content)
    assert _refusal(lambda: load_checkpoint(path)).startswith(f"{path}: ")


def test_a_checkpoint_with_other_objects_is_not_executed(tmp_path: Path) -> None:
    torch.save({"state_dict": {"x": _Bomb()}}, tmp_path / "x.ckpt")
    line = _refusal(lambda: load_checkpoint(tmp_path / "x.ckpt"))
    assert "is never unpickled" in line and "getcwd" in line
    torch.save({"state_dict": {"x": [1.0]}}, tmp_path / "x.ckpt")
    assert "x: is list, not a tensor" in _refusal(lambda: load_checkpoint(tmp_path / "x.ckpt"))
    assert "is missing" in _refusal(lambda: load_checkpoint(tmp_path / "none.ckpt"))


def test_an_expanded_tensor_takes_no_memory(state: State, tmp_path: Path) -> None:
    """A kilobyte that claims 48 GB, in place of the vocabulary and of a weight."""
    bomb = torch.zeros(1).expand(10**8, 40, 3)
    for name in (VOCABULARY, "downscale_layer.bias"):
        torch.save(state | {name: bomb}, tmp_path / "bomb.pth")
        line = _refusal(lambda: load_checkpoint(tmp_path / "bomb.pth", config=TINY))
        assert "has a tensor of 100000000x40x3 values, of which 4 bytes are stored" in line


@pytest.mark.parametrize("dtype", [torch.int64, torch.bool, torch.complex64])
def test_a_vocabulary_of_other_numbers(state: State, tmp_path: Path, dtype: torch.dtype) -> None:
    torch.save(state | {VOCABULARY: state[VOCABULARY].to(dtype)}, tmp_path / "x.pth")
    assert "not numbers" in _refusal(lambda: load_checkpoint(tmp_path / "x.pth", config=TINY))


def test_names_with_and_without_prefix_do_not_merge(state: State, tmp_path: Path) -> None:
    torch.save(state | {PREFIX + "downscale_layer.bias": torch.zeros(32)}, tmp_path / "x.pth")
    assert PREFIX in _refusal(lambda: load_checkpoint(tmp_path / "x.pth", config=TINY))


def test_a_folder_gives_back_what_was_saved(planner: GtrsPlanner, tmp_path: Path) -> None:
    save_gtrs(tmp_path / "one", planner)
    again = load_gtrs(tmp_path / "one")
    assert (again.name, again.views, again.weights) == ("tiny", planner.views, planner.weights)
    assert again.model.config == planner.model.config and not again.model.training
    np.testing.assert_array_equal(again.vocabulary, planner.vocabulary)
    for name, tensor in again.model.state_dict().items():
        assert torch.equal(tensor, planner.model.state_dict()[name])
    save_gtrs(tmp_path / "two", again)
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()


def test_a_folder_of_half_precision(planner: GtrsPlanner, tmp_path: Path) -> None:
    save_gtrs(tmp_path / "half", planner, torch.float16)
    stored = load_file(tmp_path / "half" / "weights.safetensors")
    weights = [tensor for tensor in stored.values() if tensor.is_floating_point()]
    assert all(tensor.dtype == torch.float16 for tensor in weights)
    assert load_gtrs(tmp_path / "half").model.downscale_layer.weight.dtype == torch.float32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "format: is 'other'"),
        ({"version": 2}, "version: is 2"),
        ({"name": "../x"}, "name: String should match"),
        ({"surplus": 1}, "surplus: Extra inputs"),
        ({"model": {"heads": 5}}, "model: .*256 channels do not divide into 5 heads"),
        ({"model": {"channels": 10**12, "heads": 1}}, "model.channels: "),
        ({"model": {"channels": "32"}}, "model.channels: "),
        ({"model": {}}, "weights.safetensors: .* of another shape"),
        ({"scoring": {"progress": -1.0}}, "scoring.imitation: Field required"),
    ],
)
def test_wrong_configurations(
    change: dict[str, Any], message: str, planner: GtrsPlanner, tmp_path: Path
) -> None:
    save_gtrs(tmp_path / "x", planner)
    path = tmp_path / "x" / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    _refusal(lambda: load_gtrs(tmp_path / "x"))
    with pytest.raises(InputError, match=message):
        load_gtrs(tmp_path / "x")


@pytest.mark.parametrize("name", ["config.json", "weights.safetensors", "vocabulary.npy"])
def test_missing_and_broken_files_of_a_folder(
    name: str, planner: GtrsPlanner, tmp_path: Path
) -> None:
    save_gtrs(tmp_path / "x", planner)
    path = tmp_path / "x" / name
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert str(path) in _refusal(lambda: load_gtrs(tmp_path / "x"))
    path.unlink()
    assert str(path) in _refusal(lambda: load_gtrs(tmp_path / "x"))


def test_a_full_disk_leaves_nothing(
    planner: GtrsPlanner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert "no space left" in _refusal(lambda: save_gtrs(tmp_path / "x", planner))
    assert not list(tmp_path.iterdir())


def test_an_existing_folder_is_never_overwritten(planner: GtrsPlanner, tmp_path: Path) -> None:
    assert "exists already" in _refusal(lambda: save_gtrs(tmp_path, planner))


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_any_vocabulary_file(dtype: type[np.floating[Any]], tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", fan(5).astype(dtype))
    trajectories = read_vocabulary(tmp_path / "v.npy")
    assert trajectories.dtype == np.float32 and trajectories.flags.writeable
    np.testing.assert_array_equal(trajectories, fan(5).astype(dtype).astype(np.float32))


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((3, 40, 2), np.float32), r"has shape \(3, 40, 2\)"),
        (np.zeros((40, 3), np.float32), r"has shape \(40, 3\)"),
        (np.zeros((0, 40, 3), np.float32), r"has shape \(0, 40, 3\)"),
        (np.zeros((3, 40, 3), np.int64), r"int64"),
        (np.full((3, 40, 3), np.inf), r"trajectory 0 holds NaN or infinity \(3 of 3"),
        (np.full((3, 40, 3), 1e300), r"trajectory 0 holds NaN or infinity"),
        (np.array([[None]]), "pickled Python objects"),
    ],
)
def test_files_that_are_no_vocabulary(array: np.ndarray, message: str, tmp_path: Path) -> None:
    path = tmp_path / "v.npy"
    np.save(path, array, allow_pickle=True)
    _refusal(lambda: read_vocabulary(path))
    with pytest.raises(InputError, match=message):
        read_vocabulary(path)


@pytest.mark.parametrize(
    "content", [b"", b"\x93NUMPY", b"nonsense", b"PK\x03\x04no", b"\x93NUMPY\x01\x00\xff\xff{}"]
)
def test_broken_vocabulary_files(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "v.npy"
    path.write_bytes(content)
    assert str(path) in _refusal(lambda: read_vocabulary(path))
    np.savez(tmp_path / "several.npz", a=fan(2))
    assert "array: cannot be read (" in _refusal(lambda: read_vocabulary(tmp_path / "several.npz"))
    assert "is missing" in _refusal(lambda: read_vocabulary(tmp_path / "none.npy"))


def test_the_published_vocabulary(released_vocabulary: torch.Tensor, shared: Path) -> None:
    trajectories = read_vocabulary(shared / "golden" / "planners" / "vocab_8192.npy")
    assert trajectories.shape == (8192, 40, 3)
    np.testing.assert_array_equal(trajectories, released_vocabulary.numpy())
