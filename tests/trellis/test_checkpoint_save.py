"""Folders are written in the published layout, byte for byte, and half precision is kept."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from recast.core.errors import InputError
from recast.trellis.checkpoints import Checkpoint, load_checkpoint, verify_checkpoint
from recast.trellis.model_files import GENERATION_ROLES, OPTIONAL_ROLES, save_checkpoint
from support.trellis_folder import write_golden_model

ROLES = (*GENERATION_ROLES, *OPTIONAL_ROLES)
ROLE = "sparse_structure_decoder"
DECODER = "ckpts/ss_dec"


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_golden_model(tmp_path_factory.mktemp("golden") / "model")


def load(folder: Path, **kwargs: Any) -> Checkpoint:
    return load_checkpoint(folder, with_encoder=False, **kwargs)


def half(folder: Path) -> None:
    """Turn the structure decoder's torso into float16, as the published files have it."""
    config = json.loads((folder / f"{DECODER}.json").read_text())
    config["args"]["use_fp16"] = True
    (folder / f"{DECODER}.json").write_text(json.dumps(config))
    checkpoint = load(folder, roles=(ROLE,), torso_dtype=torch.float16)
    state = checkpoint.models[ROLE].published_state()
    save_file(state, folder / f"{DECODER}.safetensors")


def test_a_half_torso_runs_in_float32_on_the_cpu_unless_asked(golden: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(golden, tmp_path / "model"))
    half(folder)
    stored = load_file(folder / f"{DECODER}.safetensors")
    assert {t.dtype for t in stored.values()} == {torch.float16, torch.float32}
    upcast = load(folder).models[ROLE]
    for name, tensor in upcast.published_state().items():
        assert tensor.dtype == torch.float32
        assert torch.equal(tensor, stored[name].float())
    asked = load(folder, torso_dtype=torch.bfloat16).models[ROLE]
    assert asked.torso_dtype == torch.bfloat16
    assert asked.published_state()["middle_block.0.conv1.weight"].dtype == torch.bfloat16
    assert asked.published_state()["out_layer.0.weight"].dtype == torch.float32


def test_saving_gives_the_same_bytes_and_the_same_weights(golden: Path, tmp_path: Path) -> None:
    checkpoint = load(golden, roles=ROLES)
    for name in ("one", "two"):
        save_checkpoint(tmp_path / name, checkpoint.record, checkpoint.models)
    for path in sorted((tmp_path / "one").rglob("*.*")):
        same = tmp_path / "two" / path.relative_to(tmp_path / "one")
        assert path.read_bytes() == same.read_bytes()
    for name in ("ss_flow", "ss_dec", "slat_flow", "slat_dec_gs", "ss_enc", "slat_enc"):
        # Tensor order and header of the format are canonical: even the golden bytes come back.
        path = f"ckpts/{name}.safetensors"
        assert (tmp_path / "one" / path).read_bytes() == (golden / path).read_bytes()
        args = json.loads((tmp_path / f"one/ckpts/{name}.json").read_text())["args"]
        assert (
            args.items() >= json.loads((golden / f"ckpts/{name}.json").read_text())["args"].items()
        )


@pytest.mark.parametrize(
    ("dtype", "kept", "fp16"),
    [(torch.float16, torch.float16, True), (torch.bfloat16, torch.float32, False)],
)
def test_what_is_saved_of_a_torso(
    golden: Path, tmp_path: Path, dtype: torch.dtype, kept: torch.dtype, fp16: bool
) -> None:
    checkpoint = load(golden, roles=(ROLE,), torso_dtype=dtype)
    save_checkpoint(tmp_path / "new", checkpoint.record, checkpoint.models)
    tensors = load_file(tmp_path / f"new/{DECODER}.safetensors")
    weight = "middle_block.0.conv1.weight"
    assert tensors[weight].dtype == kept
    assert torch.equal(tensors[weight], checkpoint.models[ROLE].published_state()[weight].to(kept))
    args = json.loads((tmp_path / f"new/{DECODER}.json").read_text())["args"]
    assert args["use_fp16"] is fp16
    checked = {check.role: check for check in verify_checkpoint(tmp_path / "new")}[ROLE]
    assert checked.expected is not None
    assert checked.fault() is None


def test_nothing_is_written_over(golden: Path, tmp_path: Path) -> None:
    checkpoint = load(golden, roles=("slat_encoder",))
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="exists already"):
        save_checkpoint(tmp_path / "there", checkpoint.record, checkpoint.models)
    with pytest.raises(InputError, match=r"models\.unheard_of: is missing"):
        save_checkpoint(
            tmp_path / "new",
            checkpoint.record,
            {"unheard_of": checkpoint.models["slat_encoder"]},
        )
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
