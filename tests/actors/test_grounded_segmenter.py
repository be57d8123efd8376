"""Grounding DINO and SAM, tiny and with random weights, through the code that real ones take."""

from __future__ import annotations

import json
import re
import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from recast import actors
from recast.actors import GroundedSamSegmenter, Observation, SegmentationTarget, observe
from recast.actors.grounded_segmenter import (
    DetectionRule,
    agreement,
    choose_mask,
    is_segmenter_folder,
    logged_rectangle,
    segmenter_of,
)
from recast.core.errors import InputError
from recast.logs import DrivingLog
from support.tiny_networks import write_tiny_networks

ANY_DETECTION = DetectionRule(score=0.0, overlap=1e-9, tie=0.0)
NO_DETECTION = DetectionRule(score=1.0)


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_networks(tmp_path_factory.mktemp("networks"))


@pytest.fixture(scope="module")
def target(observation: Observation) -> SegmentationTarget:
    """The crop, cut so that it is far from square, with some returns of the road."""
    rows = slice(0, 2 * observation.rgba.shape[0] // 3)
    image = np.ascontiguousarray(observation.rgba[rows, :, :3])
    camera = observation.camera.cropped(0, 0, image.shape[1], image.shape[0])
    road = np.array([[-3.0, 1.3, 7.0], [-2.0, 1.4, 6.0], [3.0, 1.4, 8.0]])
    return SegmentationTarget(
        image,
        camera,
        observation.camera_from_object,
        observation.size,
        observation.points.astype(np.float64),
        road,
    )


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the network was asked")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


@pytest.mark.usefixtures("offline")
def test_a_detection_prompts_the_mask(networks: Path, target: SegmentationTarget) -> None:
    segmenter = GroundedSamSegmenter(networks, ANY_DETECTION, "cpu")
    found = segmenter.segment(target)
    assert found.alpha.shape == target.image.shape[:2]
    assert found.alpha.dtype == np.uint8
    assert 0 < (found.alpha > 127).mean() < 1
    assert found.notes[0].startswith("box from the detector: ")
    assert not any("used instead" in doubt for doubt in found.doubts)
    again = GroundedSamSegmenter(networks, ANY_DETECTION, "cpu").segment(target)
    assert np.array_equal(found.alpha, again.alpha)


def test_detections_lie_in_the_crop(networks: Path, target: SegmentationTarget) -> None:
    found = GroundedSamSegmenter(networks, ANY_DETECTION, "cpu").detect(target.image, "a car.")
    assert found
    height, width = target.image.shape[:2]
    for detection in found:
        assert (detection.box >= 0).all()
        assert (detection.box <= [width, height, width, height]).all()
        assert 0 <= detection.score <= 1
    assert any(set(d.label.split()) & {"a", "car", "car."} for d in found)


def test_the_logged_box_stands_in(networks: Path, target: SegmentationTarget) -> None:
    segmenter = GroundedSamSegmenter(networks, NO_DETECTION, "cpu")
    found = segmenter.segment(target)
    assert found.notes[0].startswith("box from the log: no object was detected as 'a car.'")
    assert any("the logged box was used instead" in doubt for doubt in found.doubts)
    masks, predicted = segmenter.propose(target.image, logged_rectangle(target))
    assert masks.shape == (3, *target.image.shape[:2])
    best = masks[choose_mask(masks, predicted, target, logged_rectangle(target))]
    overlap = (best & (found.alpha > 127)).sum() / best.sum()
    assert overlap > 0.5, "the mask of the logged box is the one that comes out"


def test_what_stood_in_is_shown(networks: Path, street: DrivingLog) -> None:
    seen = observe(street, "7", segmenter=GroundedSamSegmenter(networks, NO_DETECTION, "cpu"))
    words = seen.explain()
    assert "box from the log: no object was detected" in words
    assert "warning: the logged box was used instead: no object was detected" in words
    assert "of the crop's border" in words
    assert seen.mask_quality.notes
    assert seen.mask_quality.warnings()[-len(seen.mask_quality.doubts) :] == (
        seen.mask_quality.doubts
    )


def test_the_best_mask_is_the_whole_vehicle(
    observation: Observation, target: SegmentationTarget
) -> None:
    whole = observation.rgba[: target.image.shape[0], :, 3] > 127
    box = logged_rectangle(target)
    window = whole.copy()
    window[:, : whole.shape[1] // 2] = False
    everything = np.ones_like(whole)
    masks = np.array([window, np.zeros_like(whole), whole, everything])
    assert choose_mask(masks, np.array([0.9, 1.0, 0.9, 0.9]), target, box) == 2
    assert choose_mask(masks[:2], np.array([0.1, 1.0]), target, box) == 0, "empty ones come last"
    values = [agreement(mask, target, box) for mask in masks]
    assert values[2] == max(values)
    assert values[1] == 0.0
    surer = np.array([0.9, 0.9, 0.9 - values[2], 0.9])
    assert choose_mask(masks, surer, target, box) != 2, "the network's own judgement counts"


def remove(*names: str) -> Callable[[Path], None]:
    def from_folder(folder: Path) -> None:
        for name in names:
            (folder / name).unlink()

    return from_folder


def cut_short(folder: Path) -> None:
    path = folder / "sam/model.safetensors"
    path.write_bytes(path.read_bytes()[:-100])


def pointer(folder: Path) -> None:
    (folder / "grounding-dino/model.safetensors").write_text("version https://git-lfs.github.com/")


def other_network(folder: Path) -> None:
    path = folder / "sam/config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "model_type": "sam2"}))


def no_json(folder: Path) -> None:
    (folder / "sam/config.json").write_text("{")


def member(file: str, *path: str, value: int) -> Callable[[Path], None]:
    """Set a member of a JSON file, which may lie in objects of others."""

    def in_folder(folder: Path) -> None:
        record = json.loads((folder / file).read_text())
        inner = record
        for name in path[:-1]:
            inner = inner.setdefault(name, {})
        inner[path[-1]] = value
        (folder / file).write_text(json.dumps(record))

    return in_folder


def without_a_tensor(folder: Path) -> None:
    path = folder / "sam/model.safetensors"
    tensors = load_file(path)
    del tensors["vision_encoder.neck.conv1.weight"]
    save_file(tensors, path, {"format": "pt"})


def of_another_shape(folder: Path) -> None:
    path = folder / "sam/model.safetensors"
    tensors = load_file(path)
    tensors["vision_encoder.neck.conv1.weight"] = torch.zeros(3, 3)
    save_file(tensors, path, {"format": "pt"})


def not_finite(folder: Path) -> None:
    path = folder / "grounding-dino/model.safetensors"
    tensors = load_file(path)
    tensors["model.level_embed"] *= torch.nan
    save_file(tensors, path, {"format": "pt"})


def says_nothing(folder: Path) -> None:
    path = folder / "sam/model.safetensors"
    tensors = load_file(path)
    for name, tensor in tensors.items():
        if "output_hypernetworks_mlps" in name:
            tensor.zero_()
    save_file(tensors, path, {"format": "pt"})


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            remove("grounding-dino/model.safetensors"),
            ("grounding-dino", "model.safetensors", "missing", "IDEA-Research/grounding-dino-base"),
        ),
        (remove("sam/config.json"), ("sam", "config.json", "missing", "facebook/sam-vit-huge")),
        (remove("sam/preprocessor_config.json"), ("preprocessor_config.json", "missing")),
        (
            remove("grounding-dino/tokenizer.json", "grounding-dino/vocab.txt"),
            ("tokenizer.json or vocab.txt", "missing"),
        ),
        (lambda folder: shutil.rmtree(folder / "sam"), ("sam", "missing", "facebook/sam-vit-base")),
        (lambda folder: shutil.rmtree(folder), ("folder: is missing", "grounding-dino and sam")),
        (cut_short, ("model.safetensors", "or not a safetensors file")),
        (pointer, ("model.safetensors", "or not a safetensors file")),
        (other_network, ("config.json", "'sam2'", "not 'sam'")),
        (no_json, ("config.json", "JSON")),
        (
            member("sam/config.json", "vision_config", "num_hidden_layers", value=10**9),
            ("config.json", "vision_config.num_hidden_layers is 1000000000"),
        ),
        (
            member("sam/preprocessor_config.json", "size", "longest_edge", value=10**6),
            ("preprocessor_config.json", "size.longest_edge is 1000000"),
        ),
    ],
)
def test_refused_before_any_work(
    networks: Path, tmp_path: Path, spoil: Callable[[Path], None], words: tuple[str, ...]
) -> None:
    folder = tmp_path / "networks"
    shutil.copytree(networks, folder)
    spoil(folder)
    with pytest.raises(InputError) as caught:
        GroundedSamSegmenter(folder)
    line = str(caught.value)
    assert "\n" not in line
    assert caught.value.where.startswith(str(folder)), "a long path is shortened in the line alone"
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (without_a_tensor, ("model.safetensors", "lacks 1 tensors, first vision_encoder.neck")),
        (
            of_another_shape,
            ("vision_encoder.neck.conv1.weight has shape (3, 3), not (32, 32, 1, 1)",),
        ),
        (not_finite, ("model.level_embed", "not finite")),
        (says_nothing, ("mask: is empty", "box-lidar")),
        (
            member("sam/config.json", "vision_config", "mlp_dim", value=10**9),
            ("sam", "config.json asks for", "are stored"),
        ),
    ],
)
def test_refused_when_read(
    networks: Path,
    tmp_path: Path,
    target: SegmentationTarget,
    spoil: Callable[[Path], None],
    words: tuple[str, ...],
) -> None:
    folder = tmp_path / "networks"
    shutil.copytree(networks, folder)
    spoil(folder)
    with pytest.raises(InputError) as caught:
        GroundedSamSegmenter(folder, device="cpu").segment(target)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_by_name_or_folder(networks: Path, tmp_path: Path) -> None:
    assert type(segmenter_of("box-lidar")).__name__ == "BoxLidarSegmenter"
    assert isinstance(segmenter_of(str(networks)), GroundedSamSegmenter)
    plugged = segmenter_of("recast.actors.segment:BoxLidarSegmenter")
    assert type(plugged).__name__ == "BoxLidarSegmenter"
    assert not is_segmenter_folder("box-lidar")
    with pytest.raises(InputError, match="nonesuch: is not known; choose one of box-lidar"):
        segmenter_of("nonesuch")
    with pytest.raises(InputError, match="folder: is missing"):
        segmenter_of(str(tmp_path / "nowhere"))


def test_transformers_is_imported_only_when_needed() -> None:
    sources = sorted(Path(actors.__file__).parent.rglob("*.py"))
    assert len(sources) > 10
    for path in sources:
        assert not re.search(r"^(import|from) transformers", path.read_text(), re.M), path.name
