"""Three camera images as the one image that the network sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor

from recast.errors import InputError
from recast.planning.gtrs.config import Count, GtrsRecord
from recast.planning.gtrs.rig import NUPLAN_CAMERAS

Image = NDArray[np.uint8]


class ViewLayout(GtrsRecord):
    """Which cameras are stitched, and how.

    Rows are cropped from top and bottom of all three images, columns from both sides of the left
    and the right one; side by side they are resampled to the network's input, unless they have its
    size already.

    Attributes:
        cameras: names of the left, front and right camera.
        width, height: of each camera image, pixels.
        crop_rows, crop_columns: pixels cropped at each edge.
        input_width, input_height: of the network's input, pixels.
    """

    cameras: tuple[str, str, str] = ("front_left", "front", "front_right")
    width: Count
    height: Count
    crop_rows: int = Field(ge=0, strict=True)
    crop_columns: int = Field(ge=0, strict=True)
    input_width: Count
    input_height: Count

    @model_validator(mode="after")
    def _something_is_left(self) -> Self:
        if 2 * self.crop_rows >= self.height or 2 * self.crop_columns >= self.width:
            raise ValueError("crop_rows and crop_columns leave nothing of the images")
        if len(set(self.cameras)) != 3:
            raise ValueError(f"three different cameras are needed, got {', '.join(self.cameras)}")
        return self

    def stitch(self, images: Mapping[str, Image], where: str = "planner") -> Image:
        """The network's input (input_height, input_width, 3) uint8 RGB.

        Args:
            images: (height, width, 3) uint8 RGB by camera name; others may be there too.
            where: who asks, for messages.

        Raises:
            InputError: a camera is not there, or its image is not (height, width, 3) uint8.
        """
        rows = slice(self.crop_rows, self.height - self.crop_rows)
        sides = slice(self.crop_columns, self.width - self.crop_columns)
        parts = []
        for name, columns in zip(self.cameras, (sides, slice(None), sides), strict=True):
            if name not in images:
                raise self.lacks(name, images, where)
            image = np.asarray(images[name])
            if image.shape != (self.height, self.width, 3) or image.dtype != np.uint8:
                raise InputError(
                    where, f"camera {name}", f"gives {image.shape} {image.dtype} images",
                    f"give ({self.height}, {self.width}, 3) uint8 RGB",
                )  # fmt: skip
            parts.append(image[rows, columns])
        stitched = np.concatenate(parts, axis=1)
        size = (self.input_width, self.input_height)
        if stitched.shape[1::-1] == size:
            return stitched
        return np.asarray(cv2.resize(stitched, size, interpolation=cv2.INTER_LINEAR), np.uint8)

    def check(self, sizes: Mapping[str, tuple[int, int]], where: str = "planner") -> None:
        """Check the cameras before anything is rendered.

        Args:
            sizes: (width, height) of the images to come, by camera name.

        Raises:
            InputError: a camera is not there, or has another size.
        """
        for name in self.cameras:
            if name not in sizes:
                raise self.lacks(name, sizes, where)
            if sizes[name] != (self.width, self.height):
                width, height = sizes[name]
                raise InputError(
                    where, f"camera {name}",
                    f"renders {width}x{height}, the planner needs {self.width}x{self.height}",
                    "render it at that size, or take a planner made for this one",
                )  # fmt: skip

    def lacks(self, name: str, there: Mapping[str, object], where: str) -> InputError:
        """The error for a camera that is not there."""
        return InputError(
            where, f"camera {name}", "is needed and not there",
            f"there are {', '.join(there) or 'none'}; render it, or name other cameras",
        )  # fmt: skip


WAYMO_NATIVE = ViewLayout(
    width=960, height=640, crop_rows=64, crop_columns=208, input_width=2048, input_height=512
)
"""Waymo's three front cameras at half size: 544 + 960 + 544 = 2048 columns, without resampling."""

NUPLAN_VIRTUAL = ViewLayout(
    cameras=NUPLAN_CAMERAS,
    width=1920,
    height=1080,
    crop_rows=28,
    crop_columns=416,
    input_width=2048,
    input_height=512,
)
"""The cameras that the released models were trained on; see `nuplan_rig`."""


def network_input(stitched: Image) -> Tensor:
    """(H, W, 3) uint8 to (3, H, W) float32 in [0, 1]; no mean, no standard deviation."""
    return torch.from_numpy(stitched).permute(2, 0, 1).to(torch.float32) / 255
