"""VQAScore: the network against transformers' own loss, what is refused, and the seam."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file
from transformers import CLIPImageProcessor, CLIPVisionModel

from recast.core.errors import InputError
from recast.pretrained import VQA_SCORERS, checked_scores, clip_t5_files, load_vqa_scorer
from recast.pretrained.clip_t5 import load_clip_t5
from support.tiny_clip import SIDE, TinyClipT5, write_clip_t5

TEXTS = ["vehicle", "A driving-camera image with realistic vehicles", "x", *("abcdefg")]
RNG = np.random.default_rng(0)
IMAGES = [RNG.integers(0, 256, size, dtype=np.uint8) for size in ((40, 60, 3), (50, 20, 3))]
TOWER = "vision_tower"
SYSTEM = (
    "A chat between a curious user and an artificial intelligence assistant. The assistant gives "
    "helpful, detailed, and polite answers to the user's questions. USER: "
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TinyClipT5]:
    folder = tmp_path_factory.mktemp("vqa") / "clip-flant5-tiny"
    return folder, write_clip_t5(folder)


@torch.no_grad()
def by_the_loss(tiny: TinyClipT5, image: np.ndarray, text: str) -> float:
    """One picture, one text: exp of minus the loss that transformers computes from labels."""
    language, ids = tiny.language, lambda text: torch.tensor(tiny.tokenizer.encode(text).ids)
    side = max(image.shape)
    square = Image.new("RGB", (side, side), (122, 116, 104))
    square.paste(Image.fromarray(image), tuple((side - n) // 2 for n in image.shape[1::-1]))
    processor = CLIPImageProcessor(
        size={"shortest_edge": SIDE}, crop_size={"height": SIDE, "width": SIDE}
    )
    pixels = processor(images=[square], return_tensors="pt")["pixel_values"]
    # The layer before last is the last of a tower that is one layer shorter.
    config = type(tiny.vision.config)(**{**tiny.vision.config.to_dict(), "num_hidden_layers": 2})
    shorter = CLIPVisionModel(config).eval()
    shorter.load_state_dict(tiny.vision.state_dict(), strict=False)
    patches = tiny.projector(shorter(pixels).last_hidden_state[0, 1:])
    question = f'\nDoes this figure show "{text}"? Please answer yes or no. ASSISTANT: '
    before, after = (language.shared(ids(part)) for part in (SYSTEM, question))
    told = language(
        inputs_embeds=torch.cat([before, patches, after])[None], labels=ids("Yes")[None]
    )
    return float(torch.exp(-told.loss))


def test_scores_by_the_loss_of_transformers(made: tuple[Path, TinyClipT5]) -> None:
    folder, tiny = made
    assert tiny.tokenizer.encode("Yes").ids == [4, 1]
    scorer = load_vqa_scorer(folder)
    assert scorer.name == "clip-flant5-tiny"
    # The authors cut T5 to the tokens that there are before they score.
    head, count = tiny.language.lm_head, tiny.tokenizer.get_vocab_size()
    assert count < len(head.weight)
    head.weight = torch.nn.Parameter(head.weight[:count])
    expected = np.array([[by_the_loss(tiny, image, text) for text in TEXTS] for image in IMAGES])
    scores = scorer.score(IMAGES, TEXTS)
    np.testing.assert_allclose(scores, expected, rtol=1e-4)
    assert np.ptp(expected, axis=0).min() > 0 and np.ptp(np.log(expected), axis=1).min() > 0.1
    # A picture's scores are its own: the same bytes for any split of the pictures.
    assert np.array_equal(scores[1:], scorer.score(IMAGES[1:], TEXTS))
    assert scorer.score([], TEXTS).shape == (0, 10) and scorer.score(IMAGES, []).shape == (2, 0)


def test_bfloat16(made: tuple[Path, TinyClipT5]) -> None:
    whole, half = (load_clip_t5(made[0], dtype=kind) for kind in ("float32", "bfloat16"))
    first, second = (np.log(one.score(IMAGES, TEXTS)) for one in (whole, half))
    # 8 bits a number, through five layers, on logits of about 10
    assert 0 < np.abs(first - second).max() < 5 * 10 * 2**-8
    with pytest.raises(InputError, match="is int8; choose float32 or bfloat16"):
        load_clip_t5(made[0], dtype="int8")


def test_weights_in_every_layout(made: tuple[Path, TinyClipT5], tmp_path: Path) -> None:
    folder, tiny = made
    expected = load_clip_t5(folder).score(IMAGES, TEXTS[:2])

    def linked(name: str, state: dict[str, torch.Tensor]) -> Path:
        other = tmp_path / name
        other.mkdir()
        for part in ("config.json", "tokenizer.json", "vision_tower"):
            (other / part).symlink_to(folder / part)
        halves = list(state.items())[::2], list(state.items())[1::2]
        files = [f"part-{index}-of-2.bin" for index in (1, 2)]
        for file, half in zip(files, halves, strict=True):
            torch.save(dict(half), other / file)
        table = {key: file for file, half in zip(files, halves, strict=True) for key, _ in half}
        told = {"metadata": {}, "weight_map": table}
        (other / "pytorch_model.bin.index.json").write_text(json.dumps(told))
        return other

    sharded = linked("sharded", tiny.state)
    assert len(clip_t5_files(sharded)) == 6
    assert np.array_equal(load_clip_t5(sharded).score(IMAGES, TEXTS[:2]), expected)
    renamed = {
        {"shared.weight": "encoder.embed_tokens.weight"}.get(name, name).replace(
            "mm_projector.", "model.mm_projector."
        ): one
        for name, one in tiny.state.items()
    }
    assert np.array_equal(
        load_clip_t5(linked("renamed", renamed)).score(IMAGES, TEXTS[:2]), expected
    )


def test_a_tower_of_its_own(made: tuple[Path, TinyClipT5], tmp_path: Path) -> None:
    """Weights without a vision tower take that of vision_tower/, with names of old versions."""
    _, tiny = made
    folder = tmp_path / "clip-flant5-tiny"
    write_clip_t5(folder)
    state = {name: one for name, one in tiny.state.items() if "vision_tower" not in name}
    save_file(state, folder / "model.safetensors")
    with pytest.raises(InputError, match=r"model.safetensors or pytorch_model.bin: is missing"):
        load_clip_t5(folder)
    tower = {f"vision_model.{name}": one for name, one in tiny.vision.state_dict().items()}
    tower |= {"vision_model.embeddings.position_ids": torch.arange(5)[None]}
    torch.save(tower | {"logit_scale": torch.ones(())}, folder / "vision_tower/pytorch_model.bin")
    assert len(clip_t5_files(folder)) == 6
    expected = load_clip_t5(made[0]).score(IMAGES, TEXTS[:2])
    assert np.array_equal(load_clip_t5(folder).score(IMAGES, TEXTS[:2]), expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model_type": "llama"}, "model_type: is 'llama', not 't5' or 'clip_t5'"),
        ({"mm_projector_type": "linear"}, "mm_projector_type: is 'linear', not 'mlp2x_gelu'"),
        ({"mm_vision_select_feature": "cls_patch"}, "is 'cls_patch', not 'patch'"),
        ({"mm_use_im_start_end": True}, "mm_use_im_start_end: is True, not False"),
        ({"image_aspect_ratio": "square"}, "image_aspect_ratio: is 'square', not 'pad'"),
        ({"mm_resampler": "perceiver"}, "mm_resampler: is 'perceiver', which is not supported"),
        ({"mm_vision_select_layer": -9}, "selects layer -9 of a vision tower with 3"),
        ({"mm_vision_select_layer": "-2"}, "is '-2', not a whole number"),
        ({"mm_hidden_size": 32}, "has hidden_size 16, the projector reads 32"),
        ({"vocab_size": 9}, "the network 9"),
        ({"eos_token_id": 7}, "which does not end with 7"),
        ({"decoder_start_token_id": None}, "has no decoder_start_token_id"),
        ({"num_layers": 10**9}, "weights: has"),
        ({"d_ff": 10**9}, "asks for"),
        ({"d_ff": 33}, r"tensor .* has shape \(32, 24\), not \(33, 24\)"),
    ],
)
def test_settings_that_are_refused(
    made: tuple[Path, TinyClipT5], tmp_path: Path, change: dict[str, object], message: str
) -> None:
    folder = tmp_path / "other"
    folder.mkdir()
    for part in ("tokenizer.json", "vision_tower", "model.safetensors"):
        (folder / part).symlink_to(made[0] / part)
    (folder / "config.json").write_text(json.dumps({**made[1].settings, **change}))
    with pytest.raises(InputError, match=message) as told:
        load_clip_t5(folder)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("lost", "message"),
    [
        ("mm_projector.0.weight", "mm_projector.0.weight: is in the weights 0 times"),
        ("mm_projector.2.bias", "mm_projector.2.bias: is missing"),
        ("lm_head.weight", "lm_head.weight: is missing"),
        ("encoder.block.1.layer.0.layer_norm.weight", "lacks 1 tensors and has 0 more"),
    ],
)
def test_weights_that_are_refused(
    made: tuple[Path, TinyClipT5], tmp_path: Path, lost: str, message: str
) -> None:
    folder = tmp_path / "other"
    folder.mkdir()
    for part in ("tokenizer.json", "vision_tower", "config.json"):
        (folder / part).symlink_to(made[0] / part)
    with pytest.raises(InputError, match=r"model.safetensors or pytorch_model.bin: is missing"):
        load_clip_t5(folder)
    state = dict(made[1].state)
    taken = state.pop(lost)
    save_file(state, folder / "model.safetensors")
    with pytest.raises(InputError, match=message):
        load_clip_t5(folder)
    save_file({**state, lost: taken * torch.nan}, folder / "model.safetensors")
    with pytest.raises(InputError) as caught:
        load_clip_t5(folder)
    assert "not finite" in caught.value.problem  # behind the shape
    save_file({**state, lost: taken, "lora.weight": taken.clone()}, folder / "model.safetensors")
    with pytest.raises(InputError, match=r"has 1 more, first lora.weight"):
        load_clip_t5(folder)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("config.json", "[]", "model_type: is None"),
        ("tokenizer.json", '{"version": ', "files: cannot be read"),
        (f"{TOWER}/config.json", '{"model_type": "siglip"}', "model_type: is of model_type"),
        (f"{TOWER}/config.json", '{"model_type": "clip", "vision_config": 3}', "cannot be read"),
        (f"{TOWER}/preprocessor_config.json", '{"size": 48, "crop_size": 48}', "48 x 48, not 32"),
        ("model.safetensors", "", "weights: cannot be read"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    folder = tmp_path / "damaged"
    write_clip_t5(folder)
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=message):
        load_clip_t5(folder)


@dataclass
class StandIn:
    """The interface of t2v_metrics.VQAScore: files of images, and texts."""

    model: str
    device: str
    spoilt: float = 0.0

    def __call__(self, images: list[str], texts: list[str]) -> torch.Tensor:
        means = [np.asarray(Image.open(path)).mean() / 256 for path in images]
        return torch.tensor([[mean / len(text) for text in texts] for mean in means]) + self.spoilt


def test_the_adapter_to_t2v_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "t2v_metrics", None)
    with pytest.raises(InputError, match=r"t2v_metrics:clip-flant5-xl: package: cannot be import"):
        load_vqa_scorer("t2v_metrics:clip-flant5-xl")
    package = ModuleType("t2v_metrics")
    package.VQAScore = StandIn  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "t2v_metrics", package)
    scorer = load_vqa_scorer("t2v_metrics:clip-flant5-xl", device="cpu")
    assert scorer.name == "t2v_metrics:clip-flant5-xl"
    expected = [[image.mean() / 256 / len(text) for text in TEXTS] for image in IMAGES]
    np.testing.assert_allclose(scorer.score(IMAGES, TEXTS), expected, rtol=1e-6)
    assert scorer.score([], TEXTS).shape == (0, 10)
    monkeypatch.setattr(scorer, "_score", StandIn("", "", spoilt=1.0))
    with pytest.raises(InputError, match=r"scores: are not all in \[0, 1\]"):
        scorer.score(IMAGES, TEXTS)


class Guess:
    """A scorer of somebody's own."""

    name = "guess"

    def score(self, images: list[np.ndarray], texts: list[str]) -> np.ndarray:
        return np.full((len(images), len(texts)), 0.5)


def test_the_seam() -> None:
    assert VQA_SCORERS.group == "recast.vqa_scorers"
    assert callable(VQA_SCORERS.load(VQA_SCORERS.folder))
    assert callable(VQA_SCORERS.load(VQA_SCORERS.prefixes["t2v_metrics:"]))
    assert load_vqa_scorer("pretrained.test_vqa:Guess").name == "guess"
    with pytest.raises(InputError, match="VQA scorer: nobody: is not known"):
        load_vqa_scorer("nobody")
    with pytest.raises(InputError, match=r"no-such: config.json: is missing"):
        load_vqa_scorer("./no-such")
    for scores, message in (
        ([[0.5]], r"shape \(1, 1\), not \(1, 2\)"),
        ([[0.5, np.nan]], "not all"),
    ):
        with pytest.raises(InputError, match=message):
            checked_scores(scores, 1, 2, "guess")
