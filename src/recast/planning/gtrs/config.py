"""Sizes of a GTRS model, and the layout of the three camera images that it sees as one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

import cv2
import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from recast.arrays import Image
from recast.cameras import PinholeCamera
from recast.cameras.mounts import NUPLAN_CAMERAS, View
from recast.core.errors import InputError
from recast.core.records import Record
from recast.planning.cameras import require_cameras

Count = Annotated[int, Field(gt=0, le=65536, strict=True)]
"""A positive whole number; the upper bound keeps a typing error from asking for all memory."""


Depth = Annotated[int, Field(gt=0, le=64, strict=True)]
"""Layers in a row, seven times those of the released model: each is made in Python."""
Yaw = Annotated[float, Field(ge=-180.0, le=180.0)]


class BackboneStage(Record):
    """One stage of the backbone.

    Attributes:
        blocks: one-shot-aggregation blocks; each but the first is residual.
        conv_channels: channels of the 3x3 convolutions inside a block.
    """

    blocks: Depth
    conv_channels: Count
    out_channels: Count


def _v2_99() -> tuple[BackboneStage, ...]:
    sizes = ((1, 128, 256), (3, 160, 512), (9, 192, 768), (3, 224, 1024))
    return tuple(BackboneStage(blocks=b, conv_channels=c, out_channels=o) for b, c, o in sizes)


class BackboneConfig(Record):
    """A VoVNetV2 (Lee and Park 2020) with eSE in every block; the defaults are V2-99.

    Attributes:
        stem: channels of the three 3x3 convolutions; the first and the last have stride 2.
        stages: the first works at stride 4, each further one halves the resolution.
        layers: 3x3 convolutions in a block.
        frozen_norm: batch norms use their running statistics also in training, as in the released
            training, which starts from a pretrained backbone. False for training from scratch.
    """

    stem: tuple[Count, Count, Count] = (64, 64, 128)
    stages: tuple[BackboneStage, ...] = Field(default_factory=_v2_99, min_length=1, max_length=6)
    layers: Depth = 5
    frozen_norm: bool = True

    @property
    def out_channels(self) -> int:
        """Channels of the last stage."""
        return self.stages[-1].out_channels

    @property
    def stride(self) -> int:
        """Input pixels per pixel of the last stage."""
        return 4 * 2 ** (len(self.stages) - 1)


class GtrsConfig(Record):
    """A GTRS-Dense model (Li et al. 2025); the defaults are the released one.

    Attributes:
        channels: number of channels of all tokens, d.
        feedforward: hidden channels of the decoder, of the vocabulary embedding and of the heads.
        token_rows, token_columns: size to which the backbone's features are pooled.
        history: seconds by which a second image is older than the present one; None for a model
            that looks at the present image alone, as the released one does.
    """

    backbone: BackboneConfig = BackboneConfig()
    channels: Count = 256
    feedforward: Count = 1024
    heads: Count = 8
    decoder_layers: Depth = 3
    token_rows: Count = 16
    token_columns: Count = 64
    history: float | None = Field(default=None, gt=0.0, le=4.0)

    @model_validator(mode="after")
    def _heads_divide_channels(self) -> Self:
        if self.channels % self.heads:
            raise ValueError(f"{self.channels} channels do not divide into {self.heads} heads")
        return self

    @property
    def image_tokens(self) -> int:
        """Number of image tokens."""
        return self.token_rows * self.token_columns


class ViewLayout(Record):
    """Which pictures are stitched, and how.

    Rows are cropped from top and bottom of all three images, columns from both sides of the left
    and the right one; side by side they are resampled to the network's input, unless they have its
    size already. `fitted` gives the same layout for images of another size.

    Attributes:
        cameras: what the left, front and right picture are called here; `nuplan_rig`'s names stand
            for its cameras, others say nothing about the names in a log.
        width, height: size of each picture, pixels.
        crop_rows, crop_columns: pixels cropped at each edge.
        input_width, input_height: size of the network's input, pixels.
        yaws: viewing directions of the three cameras, degrees to the left of ahead. Like
            `field_of_view`, not used with nuPlan's rig.
        field_of_view: horizontal field of view of each, degrees; Waymo's by default.
    """

    cameras: tuple[str, str, str] = ("front_left", "front", "front_right")
    width: Count
    height: Count
    crop_rows: int = Field(ge=0, strict=True)
    crop_columns: int = Field(ge=0, strict=True)
    input_width: Count
    input_height: Count
    yaws: tuple[Yaw, Yaw, Yaw] = (45.0, 0.0, -45.0)
    field_of_view: float = Field(default=50.4, ge=5.0, le=150.0)

    @model_validator(mode="after")
    def _something_is_left(self) -> Self:
        if 2 * self.crop_rows >= self.height or 2 * self.crop_columns >= self.width:
            raise ValueError("crop_rows and crop_columns leave nothing of the images")
        if len(set(self.cameras)) != 3:
            raise ValueError(f"three different cameras are needed, got {', '.join(self.cameras)}")
        return self

    @property
    def views(self) -> tuple[View, ...]:
        """The three pictures, to be had from any rig; () for nuPlan's, which goes by its names."""
        if set(self.cameras) <= set(NUPLAN_CAMERAS):
            return ()
        focal = self.width / (2 * np.tan(np.deg2rad(self.field_of_view) / 2))
        camera = PinholeCamera(
            self.width, self.height, focal, focal, self.width / 2, self.height / 2
        )
        sides = (self.crop_columns, 0, self.crop_columns)
        return tuple(
            View(name, camera, yaw, self.crop_rows, columns)
            for name, yaw, columns in zip(self.cameras, self.yaws, sides, strict=True)
        )

    def stitch(self, images: Mapping[str, Image], where: str = "planner") -> Image:
        """The network's input (input_height, input_width, 3) uint8 RGB.

        Args:
            images: (height, width, 3) uint8 RGB by camera name; others may be there too.

        Raises:
            InputError: a camera is not there, or its image is not (height, width, 3) uint8.
        """
        require_cameras(self.cameras, images, where)
        rows = slice(self.crop_rows, self.height - self.crop_rows)
        sides = slice(self.crop_columns, self.width - self.crop_columns)
        parts = []
        for name, columns in zip(self.cameras, (sides, slice(None), sides), strict=True):
            image = np.asarray(images[name])
            if image.shape != (self.height, self.width, 3) or image.dtype != np.uint8:
                raise InputError(
                    where,
                    f"camera {name}",
                    f"gives {image.shape} {image.dtype} images",
                    f"give ({self.height}, {self.width}, 3) uint8 RGB",
                )
            parts.append(image[rows, columns])
        stitched = np.concatenate(parts, axis=1)
        size = (self.input_width, self.input_height)
        if stitched.shape[1::-1] == size:
            return stitched
        # Bilinear as in the released preprocessing, which halves; beyond that it would skip pixels.
        halves = stitched.shape[1] <= 2 * size[0] and stitched.shape[0] <= 2 * size[1]
        how = cv2.INTER_LINEAR if halves else cv2.INTER_AREA
        return np.asarray(cv2.resize(stitched, size, interpolation=how), np.uint8)

    def fitted(self, sizes: Mapping[str, tuple[int, int]], where: str = "planner") -> ViewLayout:
        """This layout for cameras of another size in the same proportion, to the pixel.

        Crops are scaled with the images; the network's input stays as it is.

        Args:
            sizes: (width, height) of the images to come, by camera name; other names may be there
                too.

        Raises:
            InputError: a camera is not there, its proportion is another, or the three differ.
        """
        require_cameras(self.cameras, sizes, where)
        first = sizes[self.cameras[0]]
        scale = first[0] / self.width
        for name in self.cameras:
            width, height = sizes[name]
            if (width, height) != first or abs(height - scale * self.height) > 1.0:
                raise InputError(
                    where,
                    f"camera {name}",
                    f"renders {width}x{height}, but the planner needs three images with the aspect "
                    f"ratio {self.width}:{self.height}",
                    "render it at such a size, or use a planner made for its size",
                )
        if first == (self.width, self.height):
            return self
        width, height = first
        changed = {
            "width": width,
            "height": height,
            "crop_rows": round(self.crop_rows * height / self.height),
            "crop_columns": round(self.crop_columns * scale),
        }
        return self.model_validate(self.model_dump() | changed)


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
