"""Sky masks of a training: a guess without a network, files, or a segmentation network."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.arrays import Mask
from recast.core.errors import InputError
from recast.core.images import decode_mask
from recast.logs import DrivingLog
from recast.logs.importers.waymo_proto import CAMERA_NAME
from recast.pretrained import PretrainedFolder
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import DepthSamples, TrainingView, fit_mask, near_samples

_WAYMO = tuple(CAMERA_NAME.names.values())
"""Waymo's cameras by their number in names of files."""
_FILE = re.compile(r"(\d+)_(.+)\.png", re.IGNORECASE)
_NAMES = "name them FRAME_CAMERA.png, with the log's name of the camera or Waymo's number of it"


def sky_masks(
    log: DrivingLog,
    views: Sequence[TrainingView],
    depths: Sequence[DepthSamples],
    config: SceneConfig,
) -> list[Mask]:
    """Sky of each view (H, W) bool, by the method that the configuration names.

    Args:
        depths: LiDAR depths of the views; the guess takes no pixel near a LiDAR return.

    Raises:
        InputError: files or network are missing, or are not what is needed.
    """
    if config.sky_mask == "heuristic":
        return [
            sky_mask(view.image, near_samples(view, samples))
            for view, samples in zip(views, depths, strict=True)
        ]
    if not config.sky_mask_path:
        kind = "a folder of PNG files" if config.sky_mask == "files" else "a SegFormer folder"
        raise InputError("configuration", "sky_mask_path", "is not given", f"name {kind}")
    folder = Path(config.sky_mask_path)
    if config.sky_mask == "files":
        return list(_from_files(log, views, config.scale, folder))
    return list(_from_network(views, folder))


def _from_files(
    log: DrivingLog, views: Sequence[TrainingView], scale: float, folder: Path
) -> Iterator[Mask]:
    """Masks as the processed folders of DriveStudio and Street Gaussians hold them: white is sky.

    The files of a camera, in order of their frame numbers, belong to its images in order.
    """
    if not folder.is_dir():
        raise InputError(folder, "sky masks", "is not a folder", "check sky_mask_path")
    by_camera: dict[str, dict[int, Path]] = {}
    for path in sorted(folder.iterdir()):
        found = _FILE.fullmatch(path.name)
        if found is not None:
            by_camera.setdefault(_camera(log, found[2]), {})[int(found[1])] = path
    ordered = {}
    for name in dict.fromkeys(view.camera_name for view in views):
        files, images = by_camera.get(name, {}), len(log.cameras[name].timestamps_us)
        if len(files) != images:
            raise InputError(
                folder, f"camera {name}", f"has {len(files)} masks, the log {images} images", _NAMES
            )
        ordered[name] = [files[frame] for frame in sorted(files)]
    for view in views:
        camera = log.cameras[view.camera_name].camera
        mask = _read_mask(ordered[view.camera_name][view.frame], camera.width, camera.height)
        yield fit_mask(camera, mask, scale)


def _camera(log: DrivingLog, name: str) -> str:
    """The log's camera that a file name means: by its name, or by Waymo's number."""
    numbered = _WAYMO[int(name)] if name.isdigit() and int(name) < len(_WAYMO) else name
    return name if name in log.cameras else numbered


def _read_mask(path: Path, width: int, height: int) -> Mask:
    return decode_mask(path, path, (width, height), "the image", what="sky mask") > 127


def _from_network(views: Sequence[TrainingView], folder: Path) -> Iterator[Mask]:
    """Masks of a SegFormer that knows a class called sky; no code of the folder runs."""
    published = PretrainedFolder(
        folder,
        "segformer",
        "SegformerForSemanticSegmentation",
        "SegformerImageProcessor",
        "nvidia/segformer-b5-finetuned-cityscapes-1024-1024",
    )
    processor, network = published.read("cpu")
    labels = {str(name).lower(): int(index) for index, name in network.config.id2label.items()}
    if "sky" not in labels:
        known = ", ".join(sorted(labels)[:8])
        raise InputError(
            folder,
            "config.json",
            f"has no class `sky` (its classes are {known})",
            "use a network trained on Cityscapes or ADE20K",
        )
    for view in views:
        with torch.inference_mode():
            outputs = network(**processor(images=view.image, return_tensors="pt"))
        size = (view.camera.height, view.camera.width)
        classes = processor.post_process_semantic_segmentation(outputs, target_sizes=[size])[0]
        found: NDArray[np.bool_] = (classes == labels["sky"]).numpy()
        yield found


def sky_mask(image: NDArray[np.uint8], occupied: Mask) -> Mask:
    """Guess the sky (H, W) of one image.

    A pixel is taken for sky where it is bright or clearly blue, its surroundings are smooth, no
    LiDAR point is near, and a chain of such pixels leads to the top edge. Errs on the small side:
    the sky loss only needs pixels that are surely sky.

    Args:
        image: (H, W, 3) RGB.
        occupied: (H, W) pixels on or near a LiDAR return, hence not sky.
    """
    rgb = image.astype(np.float32) / 255
    brightest = rgb.max(-1)
    blue = rgb[..., 2] - rgb[..., 0]
    grey = rgb @ np.array([0.299, 0.587, 0.114], np.float32)
    dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    smooth = np.hypot(dx, dy) < INIT.sky_largest_step
    # Foliage and walls lit by the sun are bright too, but warm: red above blue.
    bright = (brightest > INIT.sky_least_bright) & (blue > INIT.sky_least_blue)
    candidate = bright & smooth & ~occupied

    # Thin bright strips (frames of signs, lamps) touch the top edge too; the sky is wide.
    square = np.ones((5, 5), np.uint8)
    opened = cv2.dilate(cv2.erode(candidate.astype(np.uint8), square, borderValue=1), square)
    wide = candidate & (opened > 0)
    _, labels = cv2.connectedComponents(wide.astype(np.uint8), connectivity=4)
    from_top = np.unique(labels[0])
    mask = np.isin(labels, from_top[from_top > 0])
    # One pixel less at the border.
    return cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1).astype(bool)
