"""A folder is checked by its headers: what is missing, unexpected or wrong of each model."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
import torch
from rich.console import Console
from safetensors.torch import load_file, save_file

from recast.trellis.checkpoint_sizes import SMALL, new_checkpoint
from recast.trellis.checkpoints import check_details, check_table, first_fault, verify_checkpoint
from recast.trellis.model_files import GENERATION_ROLES, ModelCheck, save_checkpoint

NAMED = [*GENERATION_ROLES, "image_encoder", "sparse_structure_encoder", "slat_encoder"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    checkpoint = new_checkpoint(SMALL, 0)
    save_checkpoint(tmp_path / "model", checkpoint.record, checkpoint.models)
    return tmp_path / "model"


def by_role(checks: list[ModelCheck]) -> dict[str, ModelCheck]:
    return {check.role: check for check in checks}


def printed(checks: list[ModelCheck], folder: Path, width: int = 80) -> str:
    text = io.StringIO()
    Console(width=width, file=text).print(check_table(checks, folder))
    return text.getvalue()


def test_a_sound_folder(folder: Path) -> None:
    checks = verify_checkpoint(folder, values=True)
    assert [check.role for check in checks] == NAMED
    assert first_fault(checks) is None
    for check in checks:
        assert not any(check.faults().values())
        assert check.bytes_found == check.bytes_expected == check.file.stat().st_size
        assert check_details(check) == []
    text = printed(checks, folder)
    assert text.count(": ok") == len(NAMED)
    assert "…" not in text
    assert "ckpts/slat_dec_gs.safetensors" in text
    assert f"{checks[0].bytes_found:,} bytes" in text


def test_everything_wrong_of_one_model_is_listed(folder: Path) -> None:
    path = folder / "ckpts/ss_dec.safetensors"
    tensors = {name: tensor.clone() for name, tensor in load_file(path).items()}
    del tensors["out_layer.2.bias"]
    tensors["more"] = torch.zeros(3)
    tensors["input_layer.bias"] = torch.zeros(7)
    tensors["input_layer.weight"] = tensors["input_layer.weight"].half()
    tensors["out_layer.2.weight"][0, 0] = torch.nan
    save_file(tensors, path)
    check = by_role(verify_checkpoint(folder))["sparse_structure_decoder"]
    assert {kind: [*names] for kind, names in check.faults().items()} == {
        "of another shape": ["input_layer.bias"],
        "missing": ["out_layer.2.bias"],
        "unexpected": ["more"],
        "of another type": ["input_layer.weight"],
        "not finite": [],
    }
    assert check.bytes_found == path.stat().st_size != check.bytes_expected
    read = verify_checkpoint(folder, values=True)
    broken = by_role(read)["sparse_structure_decoder"].faults()["not finite"]
    assert [*broken] == ["out_layer.2.weight"]
    fault = first_fault(read)
    assert fault is not None
    assert "input_layer.bias: is float32 [7]" in str(fault)
    counted = "1 of another shape, 1 missing, 1 unexpected, 1 of another type, 1 not finite"
    assert counted in fault.problem
    assert len(check_details(by_role(read)["sparse_structure_decoder"])) == 5
    assert printed(read, folder).count(": ok") == len(NAMED) - 1


def test_long_lists_are_cut(folder: Path) -> None:
    path = folder / "ckpts/slat_enc.safetensors"
    path.unlink()
    save_file({"alone": torch.zeros(1)}, path)
    check = by_role(verify_checkpoint(folder))["slat_encoder"]
    assert check.expected is not None
    assert check_details(check)[0].endswith(f"and {len(check.expected) - 8} more")


def test_what_may_be_absent(folder: Path) -> None:
    (folder / "ckpts/ss_enc.safetensors").unlink()
    pipeline = json.loads((folder / "pipeline.json").read_text())
    del pipeline["args"]["models"]["slat_encoder"]
    pipeline["args"]["models"] |= {"slat_decoder_mesh": "microsoft/x/mesh"}
    pipeline["args"]["image_cond_model"] = "dinov2_vitl14_reg"
    (folder / "pipeline.json").write_text(json.dumps(pipeline))
    checks = verify_checkpoint(folder)
    assert first_fault(checks) is None
    notes = {role: check.note for role, check in by_role(checks).items()}
    assert notes["sparse_structure_encoder"] == "absent"
    assert notes["slat_decoder_mesh"] == "not used"
    assert notes["image encoder"] == "stored elsewhere"
    assert "not used" in printed(checks, folder)


def test_faults_of_several_models_are_counted(folder: Path) -> None:
    for stem in ("ss_dec", "slat_flow"):
        path = folder / f"ckpts/{stem}.safetensors"
        path.write_bytes(path.read_bytes()[:-8])
    (folder / "ckpts/image_encoder.json").unlink()
    checks = verify_checkpoint(folder)
    fault = first_fault(checks)
    assert fault is not None and "2 more models are at fault" in fault.problem
    assert by_role(checks)["slat_flow_model"].error is not None


def test_models_that_do_not_fit_together(folder: Path) -> None:
    path = folder / "ckpts/slat_dec_gs.json"
    config = json.loads(path.read_text())
    config["args"]["resolution"] = 64
    path.write_text(json.dumps(config))
    checks = verify_checkpoint(folder)
    assert "voxels along an axis: differ" in str(first_fault(checks))
    assert checks[-1].role == "all together"
