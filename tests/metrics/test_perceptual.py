"""Distances by networks, with random weights in the published layouts."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as functional
from safetensors.torch import load, load_file, save_file
from transformers import (
    BitImageProcessor,
    CLIPImageProcessor,
    CLIPModel,
    CLIPVisionModelWithProjection,
    Dinov2Config,
    Dinov2Model,
    Dinov2WithRegistersConfig,
    Dinov2WithRegistersModel,
)

from recast.core.errors import InputError
from recast.metrics import perceptual
from recast.metrics.actor_scores import photographed, score_view
from recast.metrics.perceptual import BACKBONES, FeatureDistance, Lpips, load_distances, load_lpips
from recast.pretrained import resized
from support.tiny_clip import write_clip

HEADS = Path(perceptual.__file__).with_name("lpips_heads.safetensors")
RNG = np.random.default_rng(0)
IMAGE = RNG.uniform(size=(48, 64, 3))
NEAR = np.clip(IMAGE + RNG.normal(0, 0.02, IMAGE.shape), 0, 1)
FAR = RNG.uniform(size=(48, 64, 3))


def conv_weights(backbone: str) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    state = {}
    for layer in BACKBONES[backbone]:
        before, after = layer.channels
        shape = (after, before, layer.kernel, layer.kernel)
        spread = (2 / (before * layer.kernel**2)) ** 0.5
        state[f"features.{layer.index}.weight"] = torch.randn(shape, generator=generator) * spread
        state[f"features.{layer.index}.bias"] = torch.zeros(after)
    state["classifier.1.weight"] = torch.zeros(3, 3)  # published files have a classifier too
    return state


@pytest.fixture(scope="module")
def alex(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lpips") / "alexnet.pth"
    torch.save(conv_weights("alex"), path)
    return path


def test_layers_are_numbered_as_torchvision_numbers_them() -> None:
    assert [layer.index for layer in BACKBONES["vgg"]] == [
        0,
        2,
        5,
        7,
        10,
        12,
        14,
        17,
        19,
        21,
        24,
        26,
        28,
    ]
    assert [layer.channels[1] for layer in BACKBONES["vgg"] if layer.tapped] == [
        64,
        128,
        256,
        512,
        512,
    ]
    assert [layer.channels[1] for layer in BACKBONES["alex"]] == [64, 192, 384, 256, 256]


def test_lpips_orders_images(alex: Path) -> None:
    (distance,) = load_distances(lpips=alex)
    assert distance.key == "lpips"
    assert distance(IMAGE, IMAGE) == 0.0
    assert 0.0 < distance(NEAR, IMAGE) < 0.3 * distance(FAR, IMAGE)
    assert distance(NEAR, IMAGE) == pytest.approx(distance(IMAGE, NEAR))
    with pytest.raises(ValueError, match="32x32"):
        distance(IMAGE[:20], IMAGE[:20])


def test_lpips_by_the_formula(alex: Path) -> None:
    """Every step written out: AlexNet's convolutions, unit features, the shipped heads."""
    weights = torch.load(alex, weights_only=True)
    heads = load_file(HEADS)
    taps = []
    for image in (IMAGE, FAR):
        x = torch.from_numpy(image).float().permute(2, 0, 1)[None]
        mean, deviation = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.45])
        x = (2 * x - 1 - mean.view(3, 1, 1)) / deviation.view(3, 1, 1)
        found = []
        for index, stride, padding in ((0, 4, 2), (3, 1, 2), (6, 1, 1), (8, 1, 1), (10, 1, 1)):
            if index in (3, 6):
                x = functional.max_pool2d(x, 3, 2)
            x = functional.relu(
                functional.conv2d(
                    x,
                    weights[f"features.{index}.weight"],
                    weights[f"features.{index}.bias"],
                    stride,
                    padding,
                )
            )
            found.append(x / x.norm(dim=1, keepdim=True).clamp_min(1e-9))
        taps.append(found)
    expected = sum(
        float(functional.conv2d((a - b) ** 2, heads[f"alex.{i}"][None, :, None, None]).mean())
        for i, (a, b) in enumerate(zip(*taps, strict=True))
    )
    assert load_lpips(alex)(IMAGE, FAR) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("backbone", BACKBONES)
def test_the_heads_are_those_of_torchmetrics(backbone: str) -> None:
    spec = find_spec("torchmetrics")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("torchmetrics is not installed")
    folder = Path(spec.submodule_search_locations[0]) / "functional" / "image" / "lpips_models"
    published = torch.load(folder / f"{backbone}.pth", weights_only=True, map_location="cpu")
    shipped = load_file(HEADS)
    widths = [layer.channels[1] for layer in BACKBONES[backbone] if layer.tapped]
    assert len(published) == len(widths)
    for index, width in enumerate(widths):
        head = shipped[f"{backbone}.{index}"]
        assert head.shape == (width,)
        assert torch.equal(head, published[f"lin{index}.model.1.weight"].flatten())


def test_vgg_from_safetensors(tmp_path: Path) -> None:
    save_file(conv_weights("vgg"), tmp_path / "vgg16.safetensors")
    distance = load_lpips(tmp_path / "vgg16.safetensors")
    assert isinstance(distance, Lpips) and distance.backbone == "vgg"
    assert distance(IMAGE, IMAGE) == 0.0
    assert distance(FAR, IMAGE) > distance(NEAR, IMAGE) > 0


@pytest.mark.parametrize("backbone", ["alex", "vgg"])
def test_lpips_of_many_against_one_by_one(
    backbone: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    side = {"alex": 256, "vgg": 64}[backbone]  # VGG takes a second for a picture of 256
    monkeypatch.setattr(perceptual, "SIDE", side)
    torch.save(conv_weights(backbone), tmp_path / "weights.pth")
    lpips = load_lpips(tmp_path / "weights.pth")
    rng = np.random.default_rng(1)
    sizes = [(300, 300), (90, 90), (256, 200)]
    pictures = [rng.integers(0, 256, (*size, 3), dtype=np.uint8) for size in sizes]
    found = lpips.to("cpu").distances(pictures, pictures[:2], batch=2)
    squares = resized(pictures, side, antialias=True).movedim(1, -1).double().numpy()
    expected = [[lpips(one, other) for other in squares[:2]] for one in squares]
    # float32 through up to 13 layers, whatever the batch
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)
    assert found[2].min() > 0.01 and found[0, 0] <= 1e-9 and found[1, 1] <= 1e-9
    assert lpips.distances(pictures, []).shape == (3, 0)
    assert lpips.distances([], pictures[:1]).shape == (0, 1)


class Malicious:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (print, ("unpickled",))


def test_lpips_weights_that_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "weights.pth"

    def refused(state: object, message: str) -> None:
        torch.save(state, path)
        with pytest.raises(InputError, match=message):
            load_lpips(path)

    good = conv_weights("alex")
    missing = {k: v for k, v in good.items() if k != "features.8.bias"}
    refused(missing, "features.8.bias: is missing")
    refused(good | {"features.3.weight": torch.zeros(192, 64, 3, 3)}, r"shape \(192, 64, 3, 3\)")
    refused(good | {"features.6.bias": torch.full((384,), torch.nan)}, "not finite")
    refused({"a": torch.zeros(2)}, "not from a known network")
    refused(good | {"epoch": 3}, "not a table of tensors")
    refused(
        {"features.0.weight": Malicious()}, "print, which is not a tensor and is never unpickled"
    )
    assert "unpickled" not in capsys.readouterr().out
    for data in (b"", b"PK\x03\x04cut short"):
        path.write_bytes(data)
        with pytest.raises(InputError, match="LPIPS weights: is damaged"):
            load_lpips(path)
    (tmp_path / "cut.safetensors").write_bytes(b"\x10\x00")
    with pytest.raises(InputError, match="cannot be read"):
        load_lpips(tmp_path / "cut.safetensors")
    with pytest.raises(InputError, match="is not a file"):
        load_lpips(tmp_path / "nowhere.pth")


def processor(folder: Path, size: int) -> None:
    CLIPImageProcessor(
        size={"shortest_edge": size}, crop_size={"height": size, "width": size}
    ).save_pretrained(folder)


def write_dino(folder: Path, registers: bool) -> Path:
    torch.manual_seed(0)
    small = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
    small |= {"image_size": 28, "patch_size": 14}
    made = (
        Dinov2WithRegistersModel(Dinov2WithRegistersConfig(**small))
        if registers
        else Dinov2Model(Dinov2Config(**small))
    )
    made.eval().save_pretrained(folder)
    processor(folder, 28)
    return folder


def test_clip_similarity(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip")
    (similarity,) = load_distances(clip=tmp_path / "clip")
    assert similarity.key == "clip"
    assert similarity(IMAGE, IMAGE) == 100.0
    assert 100.0 > similarity(NEAR, IMAGE) > similarity(FAR * 0.2, IMAGE)
    # the published folders hold both towers; the vision tower alone gives the same
    both = CLIPModel.from_pretrained(tmp_path / "clip")
    config = both.config.vision_config
    config.projection_dim = both.config.projection_dim
    tower = CLIPVisionModelWithProjection(config).eval()
    tower.load_state_dict(both.state_dict(), strict=False)
    tower.save_pretrained(tmp_path / "vision")
    processor(tmp_path / "vision", 32)
    (alone,) = load_distances(clip=tmp_path / "vision")
    assert alone(FAR, IMAGE) == pytest.approx(similarity(FAR, IMAGE), rel=1e-6)


PUBLISHED = {
    "clip": CLIPImageProcessor(
        size={"shortest_edge": 224}, crop_size={"height": 224, "width": 224}
    ),
    "dino": BitImageProcessor(
        size={"shortest_edge": 256},
        crop_size={"height": 224, "width": 224},
        do_convert_rgb=True,
        image_mean=[0.485, 0.456, 0.406],
        image_std=[0.229, 0.224, 0.225],
    ),
    "siglip-like": CLIPImageProcessor(size={"height": 224, "width": 224}, do_center_crop=False),
}
"""Processors of openai/clip-vit-large-patch14 and facebook/dinov2-large, and one without a crop."""


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize(("height", "width"), [(64, 96), (40, 96), (96, 96)])
def test_networks_see_a_car_from_bumper_to_bumper(name: str, height: int, width: int) -> None:
    """A side view that fills its picture: a green car, its bumpers red and blue."""
    processor, given = PUBLISHED[name], []
    mark, body = width // 16, slice(height // 3, 2 * height // 3)
    rgba = np.zeros((height, width, 4), np.uint8)
    rgba[body, :, 3], rgba[body, :, 1] = 255, 255
    rgba[body, :mark], rgba[body, -mark:] = (255, 0, 0, 255), (0, 0, 255, 255)
    car = photographed(rgba)

    def remember(pixels: torch.Tensor) -> torch.Tensor:
        given.append(pixels)
        return pixels.flatten(1)

    distance = FeatureDistance("clip", remember, processor)
    assert score_view(car, car, [distance])["clip"] == pytest.approx(100.0)
    mean, deviation = (
        torch.tensor(values)[:, None, None]
        for values in (processor.image_mean, processor.image_std)
    )
    seen = (given[0][0] * deviation + mean).numpy()
    assert seen.shape == (3, 224, 224)
    row = seen[:, 112]  # through the middle of the car
    red, green, blue = (np.flatnonzero((row[c] > 0.5) & (row.sum(0) < 1.5)) for c in range(3))
    pixel = 224 / np.ceil(1.2 * width)
    for found, expected in ((red, mark), (green, width - 2 * mark), (blue, mark)):
        assert abs(len(found) - expected * pixel) < 2  # less than a pixel at either edge
    assert red.max() < green.min() and green.max() < blue.min()


@pytest.mark.parametrize("registers", [False, True])
def test_dino_distance(tmp_path: Path, registers: bool) -> None:
    (distance,) = load_distances(dino=write_dino(tmp_path / "dino", registers))
    assert distance.key == "dino"
    assert distance(IMAGE, IMAGE) == 0.0
    assert 0.0 < distance(NEAR, IMAGE) < distance(FAR * 0.2, IMAGE)


def test_folders_that_are_refused(tmp_path: Path) -> None:
    clip = tmp_path / "clip"
    write_clip(clip)
    with pytest.raises(InputError, match="is of model_type 'clip', not 'dinov2'"):
        load_distances(dino=clip)
    with pytest.raises(InputError, match=r"config.json: is missing"):
        load_distances(clip=tmp_path / "nowhere")
    weights = clip / "model.safetensors"
    whole = load(weights.read_bytes())
    weights.write_bytes(weights.read_bytes()[:1000])
    with pytest.raises(InputError, match="truncated or not a safetensors file"):
        load_distances(clip=clip)
    vision = {name: tensor for name, tensor in whole.items() if not name.startswith("text_")}
    save_file(vision, weights, metadata={"format": "pt"})
    with pytest.raises(InputError, match=r"lacks \d+ tensors, first text_model"):
        load_distances(clip=clip)
    weights.unlink()
    torch.save({}, clip / "pytorch_model.bin")  # pickled weights are not read
    with pytest.raises(InputError, match=r"model.safetensors: is missing"):
        load_distances(clip=clip)
    assert load_distances() == ()
