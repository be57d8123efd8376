"""Both towers of CLIP against transformers' own features."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from transformers import CLIPModel

from recast.core.errors import InputError
from recast.pretrained import Clip, ClipImages, in_batches
from support.tiny_clip import SIDE, write_clip

RNG = np.random.default_rng(0)
SIZES = [(32, 32), (40, 64), (20, 20), (64, 40), (33, 90)] * 3
PICTURES = [RNG.integers(0, 256, (*size, 3), dtype=np.uint8) for size in SIZES]
TEXTS = ["vehicle", "A driving-camera image with realistic vehicles", "a", "b c"] * 3
MEAN = np.array([0.48145466, 0.4578275, 0.40821073])
DEVIATION = np.array([0.26862954, 0.26130258, 0.27577711])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CLIPModel]:
    folder = tmp_path_factory.mktemp("clip")
    return folder, write_clip(folder)


def squares(side: int, count: int) -> tuple[list[np.ndarray], torch.Tensor]:
    """Pictures of the network's own size, and what the network is given of them."""
    pictures = [RNG.integers(0, 256, (side, side, 3), dtype=np.uint8) for _ in range(count)]
    given = (np.stack(pictures) / 255 - MEAN) / DEVIATION
    return pictures, torch.from_numpy(given).float().movedim(-1, 1)


@torch.no_grad()
def compare(clip: Clip, model: CLIPModel, side: int, count: int) -> None:
    """With transformers' features; embeddings of any batch size agree."""
    pictures, pixels = squares(side, count)
    expected = model.get_image_features(pixel_values=pixels).pooler_output.double().numpy()
    for fit in ("whole", "published", "padded"):  # the same for squares of this size
        found = clip.images(pictures, fit, unit=False)
        np.testing.assert_allclose(found, expected, atol=2e-5 * np.abs(expected).max())
    # one by one and without padding
    tokens = [clip.tokenizer(text, return_tensors="pt") for text in TEXTS]
    told = [model.get_text_features(**one).pooler_output[0].numpy() for one in tokens]
    found = clip.texts(TEXTS, unit=False)
    np.testing.assert_allclose(found, np.stack(told), atol=2e-5 * np.abs(told).max())
    embed: tuple[Callable[[int], np.ndarray], ...] = (
        lambda batch: clip.images(pictures, batch=batch),
        lambda batch: clip.texts(TEXTS, batch=batch),
    )
    for one in embed:
        whole = one(32)
        assert whole.shape[1] == clip.width
        np.testing.assert_allclose(np.linalg.norm(whole, axis=1), 1.0, rtol=1e-12)
        assert np.array_equal(whole, one(32))
        assert np.ptp(whole, axis=0).max() > 1e-3
        for batch in (1, 5):
            assert np.abs(one(batch) - whole).max() < 1e-5  # the bound that `Clip` states


def test_both_towers(written: tuple[Path, CLIPModel]) -> None:
    folder, model = written
    clip = Clip.read(folder)
    compare(clip, model, SIDE, 7)
    assert clip.mean_colour.tolist() == [122, 116, 104]
    assert clip.images([]).shape == (0, 8)


@pytest.mark.slow
def test_published_sizes(tmp_path: Path) -> None:
    """Random weights in the configuration of openai/clip-vit-base-patch32."""
    vision = {"hidden_size": 768, "intermediate_size": 3072, "patch_size": 32, "image_size": 224}
    text = {"hidden_size": 512, "intermediate_size": 2048, "num_attention_heads": 8}
    text |= {"vocab_size": 49408, "eos_token_id": 2, "bos_token_id": 0, "pad_token_id": 1}
    model = write_clip(tmp_path, vision_config=vision, text_config=text, projection_dim=512)
    assert sum(one.numel() for one in model.parameters()) == 151_277_313
    compare(Clip.read(tmp_path), model, 224, 6)


def test_pictures_of_any_size_in_any_batch(written: tuple[Path, CLIPModel]) -> None:
    clip = Clip.read(written[0])
    whole = clip.images(PICTURES, "padded")
    assert np.abs(whole - clip.images(PICTURES, "padded", batch=4)).max() < 1e-5
    # the picture alone decides, not its place
    assert np.abs(whole[::-1] - clip.images(PICTURES[::-1], "padded")).max() < 1e-5
    assert np.abs(whole - clip.images(PICTURES, "published")).max() > 1e-3


def test_what_is_refused(written: tuple[Path, CLIPModel], tmp_path: Path) -> None:
    clip = Clip.read(written[0])
    assert len(clip.tokenizer("x " * 75)["input_ids"]) == 77
    assert clip.texts(["x " * 75]).shape == (1, 8)
    with pytest.raises(ValueError, match=r"'x x x.*more than 77 tokens"):
        clip.texts(["short", "x " * 76])
    for path in written[0].iterdir():
        if path.name != "tokenizer.json":
            (tmp_path / path.name).symlink_to(path)
    with pytest.raises(InputError, match=r"tokenizer.json or vocab.txt: is missing"):
        Clip.read(tmp_path)
    ClipImages.read(tmp_path)  # images alone need none
    with pytest.raises(InputError, match=r"config.json: is missing"):
        Clip.read(tmp_path / "nowhere")


def test_batches_are_cut_in_order() -> None:
    given: list[list[int]] = []

    def compute(some: list[int]) -> torch.Tensor:
        given.append(list(some))
        return torch.tensor(some)[:, None].float() * 2

    rows = in_batches(compute, [5, 6, 7, 8, 9], width=1, size=2)
    assert given == [[5, 6], [7, 8], [9]]
    assert rows[:, 0].tolist() == [10, 12, 14, 16, 18]
    assert in_batches(compute, [], width=1).shape == (0, 1)
