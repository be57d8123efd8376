from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig
from recast.reconstruction.first_points import sky_mask, sky_masks
from recast.reconstruction.views import DepthSamples, TrainingView, read_view

CAMERA = "image_02"


def few_views(log: DrivingLog, scale: float = 1.0) -> list[TrainingView]:
    return [read_view(log, log.cameras[CAMERA], frame, scale) for frame in (0, 5)]


def no_depths(views: list[TrainingView]) -> list[DepthSamples]:
    return [DepthSamples(np.zeros(0, np.float32), np.zeros((0, 2), np.float32)) for _ in views]


def write_masks(folder: Path, log: DrivingLog, name: str, first: int = 0) -> None:
    """One file a frame, white in as many top rows as the frame's index plus two."""
    folder.mkdir(exist_ok=True)
    stream = log.cameras[CAMERA]
    for index in range(len(stream.timestamps_us)):
        mask = np.zeros((stream.camera.height, stream.camera.width), np.uint8)
        mask[: index + 2] = 255
        cv2.imwrite(str(folder / name.format(frame=first + index)), mask)


def config(folder: Path | str, kind: str, **more: object) -> SceneConfig:
    return SceneConfig(scale=1.0, sky_mask=kind, sky_mask_path=str(folder), **more)


@pytest.mark.parametrize("pattern", ["{frame:03d}_image_02.png", "{frame:06d}_image_02.PNG"])
def test_files_belong_to_images_in_order(tiny_log: DrivingLog, tmp_path: Path, pattern: str):
    write_masks(tmp_path / "sky", tiny_log, pattern, first=98)
    (tmp_path / "sky" / "readme.txt").write_text("no mask")
    views = few_views(tiny_log)
    found = sky_masks(tiny_log, views, no_depths(views), config(tmp_path / "sky", "files"))
    for mask, rows in zip(found, (2, 7), strict=True):
        assert mask[:rows].all() and not mask[rows:].any()


def test_waymos_numbers_name_its_cameras(tiny_log: DrivingLog, tmp_path: Path) -> None:
    stream = replace(tiny_log.cameras[CAMERA], name="FRONT_LEFT")
    log = replace(tiny_log, cameras={"FRONT_LEFT": stream})
    write_masks(tmp_path / "sky", tiny_log, "{frame:03d}_1.png")
    views = [read_view(log, stream, 3, 0.5)]
    asked = config(tmp_path / "sky", "files").model_copy(update={"scale": 0.5})
    mask = sky_masks(log, views, no_depths(views), asked)[0]
    assert mask.shape == views[0].image.shape[:2]
    assert mask[:2].all() and not mask[3:].any()


def test_a_missing_mask_is_missed(tiny_log: DrivingLog, tmp_path: Path) -> None:
    write_masks(tmp_path / "sky", tiny_log, "{frame:03d}_image_02.png")
    (tmp_path / "sky" / "004_image_02.png").unlink()
    views = few_views(tiny_log)
    with pytest.raises(InputError, match="23 masks, the log 24 images"):
        sky_masks(tiny_log, views, no_depths(views), config(tmp_path / "sky", "files"))


def test_bad_files_are_named(tiny_log: DrivingLog, tmp_path: Path) -> None:
    write_masks(tmp_path / "sky", tiny_log, "{frame:03d}_image_02.png")
    views, asked = few_views(tiny_log), config(tmp_path / "sky", "files")
    (tmp_path / "sky" / "005_image_02.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"005_image_02\.png.*cannot be decoded"):
        sky_masks(tiny_log, views, no_depths(views), asked)
    cv2.imwrite(str(tmp_path / "sky" / "005_image_02.png"), np.zeros((5, 7), np.uint8))
    with pytest.raises(InputError, match="is 7x5, the image"):
        sky_masks(tiny_log, views, no_depths(views), asked)
    for kind, path, problem in (
        ("files", "", "is not given"),
        ("files", "none", "is not a folder"),
    ):
        with pytest.raises(InputError, match=problem):
            sky_masks(tiny_log, views, no_depths(views), config(path, kind))


def test_the_guess_is_the_default(tiny_log: DrivingLog) -> None:
    views = few_views(tiny_log)
    found = sky_masks(tiny_log, views, no_depths(views), SceneConfig())
    nothing = np.zeros(views[0].image.shape[:2], bool)
    assert np.array_equal(found[0], sky_mask(views[0].image, nothing))


def write_segformer(folder: Path, sky: str) -> None:
    """A network of one layer that calls everything its second class."""
    from transformers import (
        SegformerConfig,
        SegformerForSemanticSegmentation,
        SegformerImageProcessor,
    )

    made = SegformerConfig(
        num_encoder_blocks=1,
        depths=[1],
        sr_ratios=[1],
        hidden_sizes=[4],
        patch_sizes=[7],
        strides=[4],
        num_attention_heads=[1],
        mlp_ratios=[1],
        decoder_hidden_size=4,
        id2label={0: "road", 1: sky},
        label2id={"road": 0, sky: 1},
    )
    network = SegformerForSemanticSegmentation(made)
    with torch.no_grad():
        network.decode_head.classifier.weight.zero_()
        network.decode_head.classifier.bias.copy_(torch.tensor([0.0, 1.0]))
    network.save_pretrained(folder)
    SegformerImageProcessor(size={"height": 16, "width": 16}).save_pretrained(folder)


def test_a_network_in_a_folder(tiny_log: DrivingLog, tmp_path: Path) -> None:
    write_segformer(tmp_path / "net", "Sky")
    views = few_views(tiny_log, 0.5)
    found = sky_masks(tiny_log, views, no_depths(views), config(tmp_path / "net", "model"))
    assert found[0].shape == views[0].image.shape[:2] and found[0].all()
    write_segformer(tmp_path / "other", "tree")
    with pytest.raises(InputError, match="no class `sky`"):
        sky_masks(tiny_log, views, no_depths(views), config(tmp_path / "other", "model"))
    (tmp_path / "net" / "model.safetensors").unlink()
    with pytest.raises(InputError, match=r"model\.safetensors: is missing"):
        sky_masks(tiny_log, views, no_depths(views), config(tmp_path / "net", "model"))
