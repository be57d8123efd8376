"""Folders in the published layout load strictly, and each fault ends in one line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from recast.core.errors import InputError
from recast.trellis.checkpoints import Checkpoint, load_checkpoint
from recast.trellis.model_files import GENERATION_ROLES, OPTIONAL_ROLES
from support.trellis import golden_tensors
from support.trellis_folder import GOLDEN_MODELS, write_golden_model

ROLES = (*GENERATION_ROLES, *OPTIONAL_ROLES)
DECODER = "ckpts/ss_dec"


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_golden_model(tmp_path_factory.mktemp("golden") / "model")


@pytest.fixture
def folder(golden: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return Path(shutil.copytree(golden, tmp_path / "model"))


def load(folder: Path, **kwargs: Any) -> Checkpoint:
    return load_checkpoint(folder, with_encoder=False, **kwargs)


def refused(folder: Path, **kwargs: Any) -> str:
    with pytest.raises(InputError) as caught:
        load(folder, **kwargs)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def edit_json(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))


def edit_weights(
    folder: Path, change: Callable[[dict[str, Tensor]], object], model: str = DECODER
) -> None:
    path = folder / f"{model}.safetensors"
    tensors = {name: tensor.clone() for name, tensor in load_file(path).items()}
    change(tensors)
    path.unlink()
    save_file(tensors, path)


def test_every_golden_network_loads_with_equal_tensors(golden: Path) -> None:
    checkpoint = load_checkpoint(golden, roles=ROLES)
    assert set(checkpoint.models) == {*ROLES, "image_encoder"}
    for role, name in GOLDEN_MODELS.items():
        model = checkpoint.models[role]
        found, expected = model.published_state(), golden_tensors(name)
        assert found.keys() == expected.keys()
        for key in expected:
            assert torch.equal(found[key], expected[key]), (role, key)
        assert not model.training
    assert checkpoint.encoder is checkpoint.models["image_encoder"]
    assert checkpoint.encoder.channels == 48


def test_only_the_roles_asked_for_are_looked_at(folder: Path) -> None:
    for stem in ("ss_flow", "slat_flow", "slat_dec_gs", "slat_enc", "ss_enc", "dinov2_tiny"):
        (folder / f"ckpts/{stem}.safetensors").unlink()
    checkpoint = load(folder, roles=("sparse_structure_decoder",))
    assert list(checkpoint.models) == ["sparse_structure_decoder"]
    with pytest.raises(InputError, match="image encoder: was not loaded"):
        _ = checkpoint.encoder


def test_a_missing_file_is_named_with_its_role(folder: Path) -> None:
    (folder / f"{DECODER}.safetensors").unlink()
    line = refused(folder)
    assert "models.sparse_structure_decoder: names ckpts/ss_dec, but ckpts/ss_dec.safe" in line
    edit_json(
        folder / "pipeline.json",
        lambda p: p["args"]["models"].update(sparse_structure_decoder=f"microsoft/x/{DECODER}"),
    )
    assert "names microsoft/x/ckpts/ss_dec, but microsoft/x/ckpts/ss_dec.json" in refused(folder)
    edit_json(
        folder / "pipeline.json", lambda p: p["args"]["models"].pop("sparse_structure_decoder")
    )
    assert "models.sparse_structure_decoder: is missing" in refused(folder)


def test_an_optional_role_may_be_somewhere_else(folder: Path) -> None:
    edit_json(
        folder / "pipeline.json",
        lambda p: p["args"]["models"].update(slat_decoder_rf="microsoft/x/rf", slat_encoder="no"),
    )
    assert set(load(folder).models) == set(GENERATION_ROLES)
    assert "models.slat_encoder" in refused(folder, roles=ROLES)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(name="SLatMeshDecoder"), "'SLatMeshDecoder' is not a known network"),
        (lambda c: c.pop("name"), "name: Field required"),
        (lambda c: c.update(args=[]), "args: "),
        (lambda c: c["args"].update(width=3), "width: Extra inputs"),
        (lambda c: c["args"].update(channels=[8, -1]), "channels.1"),
        (lambda c: c["args"].pop("channels"), "channels: Field required"),
    ],
)
def test_a_wrong_configuration(
    folder: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    edit_json(folder / f"{DECODER}.json", change)
    line = refused(folder)
    assert message in line
    assert "ckpts/ss_dec.json" in line


WEIGHT = "blocks.0.conv1.weight"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: t.update({WEIGHT: t[WEIGHT][:, :3].clone()}),
            f"{WEIGHT}: is float32 [16, 3, 3, 3, 3], not float32 [16, 16, 3, 3, 3] "
            "(1 of another shape of SparseStructureDecoder)",
        ),
        (lambda t: t.pop(WEIGHT), f"{WEIGHT}: is missing (1 missing of SparseStructureDecoder)"),
        (lambda t: t.update(extra=torch.zeros(1)), "extra: is not expected (1 unexpected"),
        (lambda t: t.update({WEIGHT: t[WEIGHT].int()}), f"{WEIGHT}: is int32"),
        (lambda t: t[WEIGHT].view(-1)[5].fill_(torch.nan), f"{WEIGHT}: holds NaN or inf"),
        (lambda t: t[WEIGHT].view(-1)[5].fill_(torch.inf), f"{WEIGHT}: holds NaN or inf"),
    ],
)
def test_wrong_weights(
    folder: Path, change: Callable[[dict[str, Tensor]], object], message: str
) -> None:
    edit_weights(folder, change)
    line = refused(folder)
    assert message in line
    assert "ckpts/ss_dec.safetensors" in line


def test_wrong_weights_of_the_image_encoder(folder: Path) -> None:
    path = next(path for path in (folder / "ckpts").glob("*.safetensors") if "dino" in path.name)
    name = next(iter(load_file(path)))
    edit_weights(folder, lambda t: t[name].view(-1)[0].fill_(torch.nan), f"ckpts/{path.stem}")
    with pytest.raises(InputError, match=f"{path.name}: {name}: holds NaN"):
        load_checkpoint(folder)


def test_weights_beyond_half_precision(folder: Path) -> None:
    edit_weights(folder, lambda t: t[WEIGHT].view(-1)[0].fill_(1e6))
    load(folder)
    assert f"{WEIGHT}: exceeds the range of torch.float16" in refused(
        folder, torso_dtype=torch.float16
    )


def test_a_truncated_file(folder: Path) -> None:
    path = folder / f"{DECODER}.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    assert "truncated" in refused(folder)


def test_a_pickle_in_disguise_is_never_loaded(folder: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[Callable[[str], object], tuple[str]]:
            return Path.touch, (folder / "exploded",)  # type: ignore[return-value]

    torch.save({"a": Bomb()}, folder / f"{DECODER}.safetensors")
    assert "pickled PyTorch file" in refused(folder)
    assert not (folder / "exploded").exists()


@pytest.mark.parametrize(
    ("stem", "change", "message"),
    [
        ("ss_flow", {"cond_channels": 40}, "is float32"),
        ("slat_enc", {"resolution": 32}, "voxels along an axis: differ"),
    ],
)
def test_models_that_do_not_fit_together(
    folder: Path, stem: str, change: dict[str, int], message: str
) -> None:
    edit_json(folder / f"ckpts/{stem}.json", lambda c: c["args"].update(change))
    assert message in refused(folder, roles=ROLES)


def test_a_model_in_the_role_of_another(folder: Path) -> None:
    edit_json(
        folder / "pipeline.json",
        lambda p: p["args"]["models"].update(slat_decoder_gs="ckpts/slat_enc"),
    )
    assert "models.slat_decoder_gs: is a SLatEncoder, not a SLatGaussianDecoder" in refused(folder)


def test_a_normalisation_of_another_length(folder: Path) -> None:
    edit_json(
        folder / "pipeline.json",
        lambda p: p["args"].update(slat_normalization={"mean": [0.0], "std": [1.0]}),
    )
    assert "channels of the structured latent: differ (1 of slat_normalization" in refused(folder)


def test_the_published_backbone_is_kept_apart(folder: Path) -> None:
    edit_json(
        folder / "pipeline.json", lambda p: p["args"].update(image_cond_model="dinov2_vitl14_reg")
    )
    with pytest.raises(InputError, match="dinov2: image encoder: the weights of dinov2_vitl14_reg"):
        load_checkpoint(folder)
    named = folder / "ckpts/dinov2_tiny.safetensors"
    checkpoint = load_checkpoint(folder, image_encoder=named)
    assert checkpoint.encoder.channels == 48
    assert "image_encoder" not in checkpoint.models


def test_weights_of_an_encoder_that_is_not_used(folder: Path) -> None:
    named = folder / "ckpts/dinov2_tiny.safetensors"
    with pytest.raises(InputError) as caught:
        load_checkpoint(folder, image_encoder=named)
    assert "already has one" in caught.value.problem
    edit_json(folder / "pipeline.json", lambda p: p["args"].update(image_cond_model="slat_encoder"))
    with pytest.raises(InputError, match="SLatEncoder is not an image encoder"):
        load_checkpoint(folder)
