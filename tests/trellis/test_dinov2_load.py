"""DINOv2 from each layout on disk, and one line for everything that can be wrong with one."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from recast.core.errors import InputError
from recast.trellis.dinov2 import Dinov2Config, Dinov2Encoder, config_from_shapes, load_dinov2
from support.trellis import assert_same, golden_config, golden_tensors, official_keys

CONFIG = Dinov2Config(**golden_config("dinov2_tiny")["args"])


def _refusal(path: Path, config: Dinov2Config | None = CONFIG) -> str:
    with pytest.raises(InputError) as caught:
        load_dinov2(path, config)
    line = str(caught.value)
    assert path.name in line and "\n" not in line
    assert str(path) in caught.value.where
    return line


def _assert_golden(encoder: Dinov2Encoder) -> None:
    golden = golden_tensors("dinov2_tiny_io")
    assert_same(encoder.encode(golden["image"]), golden["cond"])
    assert not any(parameter.requires_grad for parameter in encoder.parameters())


@pytest.fixture(scope="module")
def hf_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What transformers writes, of the golden network."""
    encoder = Dinov2Encoder(CONFIG)
    encoder.load_published(golden_tensors("dinov2_tiny"))
    folder = tmp_path_factory.mktemp("dinov2")
    encoder.backbone.save_pretrained(folder)
    return folder


@pytest.fixture
def damaged(hf_folder: Path, tmp_path: Path) -> Callable[..., Path]:
    """A copy of the folder with members of its config replaced, or its tensors changed."""

    def copy(change: Callable[[dict[str, Tensor]], object] | None = None, **config: object) -> Path:
        record = json.loads((hf_folder / "config.json").read_text()) | config
        (tmp_path / "config.json").write_text(json.dumps(record))
        tensors = load_file(hf_folder / "model.safetensors")
        if change is not None:
            change(tensors)
        save_file(tensors, tmp_path / "model.safetensors")
        return tmp_path

    return copy


def test_folder_of_transformers(hf_folder: Path):
    _assert_golden(load_dinov2(hf_folder))


def test_folder_gives_what_transformers_itself_reads(hf_folder: Path):
    from transformers import Dinov2WithRegistersModel

    theirs = Dinov2WithRegistersModel.from_pretrained(hf_folder, local_files_only=True).state_dict()
    ours = load_dinov2(hf_folder).backbone.state_dict()
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], tensor) for name, tensor in theirs.items())


def test_folder_with_newer_names(hf_folder: Path, tmp_path: Path):
    """Names as the modules of transformers 5 have them, should a file hold those."""
    state = load_dinov2(hf_folder).backbone.state_dict()
    save_file(state, tmp_path / "model.safetensors")
    (tmp_path / "config.json").write_bytes((hf_folder / "config.json").read_bytes())
    _assert_golden(load_dinov2(tmp_path))


def test_torch_hub_file(tmp_path: Path):
    torch.save(golden_tensors("dinov2_tiny"), tmp_path / "dinov2.pth")
    _assert_golden(load_dinov2(tmp_path / "dinov2.pth", CONFIG))


def test_safetensors_with_hub_names_and_arguments_beside(tmp_path: Path):
    save_file(golden_tensors("dinov2_tiny"), tmp_path / "dinov2.safetensors")
    (tmp_path / "dinov2.json").write_text(json.dumps(golden_config("dinov2_tiny")))
    _assert_golden(load_dinov2(tmp_path / "dinov2.safetensors"))


def test_half_precision_file_becomes_float32(tmp_path: Path):
    state = {name: tensor.half() for name, tensor in golden_tensors("dinov2_tiny").items()}
    save_file(state, tmp_path / "dinov2.safetensors")
    loaded = load_dinov2(tmp_path / "dinov2.safetensors", CONFIG).published_state()
    for name, tensor in loaded.items():
        assert torch.equal(tensor, state[name].float()), name


def test_shapes_tell_the_arguments_of_the_published_file():
    official = official_keys()["dinov2_vitl14_reg4_pretrain"]
    state = {
        name: torch.empty(entry["shape"], device="meta")
        for name, entry in official["state_dict"].items()
    }
    assert config_from_shapes(state, "dinov2.pth") == Dinov2Config(**official["args"])


@pytest.mark.parametrize("name", ["none.pth", "none.safetensors", "none"])
def test_missing_file(tmp_path: Path, name: str):
    assert "DINOv2 weights: is not a file" in _refusal(tmp_path / name)


def test_folder_without_config(tmp_path: Path):
    assert "config.json: file: is missing" in _refusal(tmp_path)


def test_folder_without_weights(hf_folder: Path, tmp_path: Path):
    (tmp_path / "config.json").write_bytes((hf_folder / "config.json").read_bytes())
    assert "model.safetensors: DINOv2 weights: is not a file" in _refusal(tmp_path)


@pytest.mark.parametrize(
    ("config", "line"),
    [
        ({"model_type": "dinov2"}, "model_type: is 'dinov2', not 'dinov2_with_registers'"),
        ({"use_swiglu_ffn": True}, "use_swiglu_ffn: is True, not False"),
        ({"layer_norm_eps": 1e-5}, "layer_norm_eps: is 1e-05, not 1e-06"),
        ({"image_size": "large"}, "img_size: "),
    ],
)
def test_folder_of_another_model(damaged, config: dict[str, object], line: str):
    assert line in _refusal(damaged(**config), None)


def test_config_that_does_not_fit_the_weights(damaged):
    line = _refusal(damaged(num_hidden_layers=3), None)
    assert "blocks.2." in line and "14 missing" in line


def test_folder_lacks_the_key_of_an_attention(damaged):
    line = _refusal(
        damaged(lambda state: state.pop("encoder.layer.1.attention.attention.key.bias")), None
    )
    assert "'blocks.1.attn.qkv.bias' is unknown or incomplete" in line


def test_folder_with_a_foreign_tensor(damaged):
    line = _refusal(damaged(lambda state: state.update({"classifier.bias": torch.zeros(2)})), None)
    assert "'classifier.bias' is unknown" in line


def _save(path: Path, **changes: Tensor | None) -> Path:
    state = {**golden_tensors("dinov2_tiny"), **changes}
    torch.save({name: tensor for name, tensor in state.items() if tensor is not None}, path)
    return path


def test_tensor_missing(tmp_path: Path):
    line = _refusal(_save(tmp_path / "a.pth", **{"norm.bias": None}))
    assert "norm.bias: is missing (1 missing)" in line


def test_dinov2_without_registers(tmp_path: Path):
    line = _refusal(_save(tmp_path / "a.pth", register_tokens=None), None)
    assert "'register_tokens' is missing" in line and "reg4" in line


def test_tensor_unknown(tmp_path: Path):
    line = _refusal(_save(tmp_path / "a.pth", extra=torch.zeros(1)))
    assert "extra: is not expected (1 unexpected)" in line


def test_tensor_of_another_shape(tmp_path: Path):
    line = _refusal(_save(tmp_path / "a.pth", **{"blocks.0.attn.qkv.weight": torch.zeros(48, 48)}))
    assert "blocks.0.attn.qkv.weight: is float32 [48, 48], not float32 [144, 48]" in line


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_not_finite(tmp_path: Path, value: float):
    broken = golden_tensors("dinov2_tiny")["norm.weight"].clone()
    broken[5] = value
    line = _refusal(_save(tmp_path / "a.pth", **{"norm.weight": broken}))
    assert "norm.weight: holds NaN or infinite values" in line


def test_heads_that_shapes_do_not_tell(tmp_path: Path):
    """48 channels do not make a head of 64: one is assumed, and the network still loads."""
    encoder = load_dinov2(_save(tmp_path / "a.pth"))
    assert encoder.config == CONFIG.model_copy(update={"num_heads": 1})


def test_position_embedding_of_no_square(tmp_path: Path):
    line = _refusal(_save(tmp_path / "a.pth", pos_embed=torch.zeros(1, 16, 48)), None)
    assert "pos_embed: is float32 [1, 16, 48], not float32 [1, 10, 48]" in line


class _Malice:
    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return (Path.touch, (self.trace,))


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_pickle_is_not_run(tmp_path: Path):
    malice = {"cls_token": _Malice(tmp_path / "trace")}
    torch.save(malice, tmp_path / "a.pth")
    (tmp_path / "b.pth").write_bytes(pickle.dumps(malice))
    assert "getattr, which is not a tensor and is never unpickled" in _refusal(tmp_path / "a.pth")
    assert "is damaged or is not a PyTorch checkpoint" in _refusal(tmp_path / "b.pth")
    assert not (tmp_path / "trace").exists()


@pytest.mark.parametrize("value", [torch.zeros(3), {"model": {"cls_token": torch.zeros(3)}}])
def test_no_table_of_tensors(tmp_path: Path, value: object):
    torch.save(value, tmp_path / "a.pth")
    assert "is not a table of tensors" in _refusal(tmp_path / "a.pth")


@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
def test_file_cut_short(tmp_path: Path, name: str):
    write = torch.save if name == "a.pth" else save_file
    write(golden_tensors("dinov2_tiny"), tmp_path / name)
    data = (tmp_path / name).read_bytes()
    for end in (0, 10, len(data) // 2):
        (tmp_path / name).write_bytes(data[:end])
        _refusal(tmp_path / name)


def test_other_ending(tmp_path: Path):
    (tmp_path / "a.bin").write_bytes(b"")
    assert "have the unknown suffix '.bin'" in _refusal(tmp_path / "a.bin")


@pytest.mark.parametrize("text", ["[]", '{"args": 3}', '{"args": {"depth": 0}}', "{"])
def test_arguments_beside_are_checked(tmp_path: Path, text: str):
    save_file(golden_tensors("dinov2_tiny"), tmp_path / "a.safetensors")
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=r"a\.json"):
        load_dinov2(tmp_path / "a.safetensors")
