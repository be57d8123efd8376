"""Three camera images as the one image that the network sees; nuPlan's rig, and lenses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

import cv2
import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.records import Record
from recast.geometry import PinholeCamera
from recast.planning.cameras import require_cameras
from recast.planning.gtrs.config import Count
from recast.planning.types import CameraMount
from recast.planning.views import View, camera_pose

NUPLAN_CAMERAS = ("nuplan_l0", "nuplan_f0", "nuplan_r0")
"""Left, front and right."""

NUPLAN_CAMERA = PinholeCamera(
    width=1920,
    height=1080,
    fx=1545.0,
    fy=1545.0,
    cx=960.0,
    cy=560.0,
    distortion=(-0.356123, 0.172545, -0.002130, 0.000464, -0.052310),
)
"""Intrinsics shared by all three; the images are as distorted as this says."""

_MOUNTS = (
    ((1.646, 0.143, 1.521), 55.2, -0.5),
    ((1.670, -0.026, 1.523), 0.2, -1.5),
    ((1.626, -0.162, 1.526), -55.5, 0.4),
)
Yaw = Annotated[float, Field(ge=-180.0, le=180.0)]


def nuplan_rig(scale: float = 1.0) -> dict[str, CameraMount]:
    """The virtual rig by camera name, in the rear-axle frame.

    NAVSIM feeds the planner the raw images, with their distortion. A renderer of pinhole images
    renders with `Lens(camera).source` and bends the result: see
    `recast.simulation.scene_renderer.through_lenses`.

    Args:
        scale: of width and height, rounded to whole pixels.

    Source: nuPlan's published calibration, rounded: position in metres, yaw to the left, pitch
    upwards (the optical axis of the front camera points 1.5 degrees below the horizon), no roll.
    """
    size = round(NUPLAN_CAMERA.width * scale), round(NUPLAN_CAMERA.height * scale)
    camera = NUPLAN_CAMERA.resized(*size)
    return {
        name: CameraMount(camera, camera_pose(position, yaw, pitch))
        for name, (position, yaw, pitch) in zip(NUPLAN_CAMERAS, _MOUNTS, strict=True)
    }


class ViewLayout(Record):
    """Which pictures are stitched, and how.

    Rows are cropped from top and bottom of all three images, columns from both sides of the left
    and the right one; side by side they are resampled to the network's input, unless they have its
    size already. `fitted` gives the same layout for images of another size.

    Attributes:
        cameras: what the left, front and right picture are called here; `nuplan_rig`'s names stand
            for its cameras, others say nothing about the names in a log.
        width, height: of each picture, pixels.
        crop_rows, crop_columns: pixels cropped at each edge.
        input_width, input_height: of the network's input, pixels.
        yaws: where the three look, degrees to the left of ahead. Like `field_of_view`, not used
            with nuPlan's rig.
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
            where: who asks, for messages.

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
            sizes: (width, height) of the images to come, by camera name; others may be there too.
            where: who asks, for messages.

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
                    f"renders {width}x{height}, the planner needs three images in the proportion "
                    f"{self.width}x{self.height}",
                    "render it at such a size, or take a planner made for this one",
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


class Lens:
    """Bends pinhole images to those of a camera with distortion.

    Render with `source`, then call `bend`. The map is computed once.

    Args:
        camera: of the images to be made.

    Attributes:
        camera: as given.
        source: rectified camera at the same place, with the same focal lengths, just large enough
            to see all that `camera` sees.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = camera
        rays = camera.rays(camera.pixel_grid())[..., :2] * [camera.fx, camera.fy]
        # Half a pixel beyond the outermost centres is what the outermost pixels cover.
        low = np.floor(rays.min((0, 1)) - 0.5 + 1e-6)
        width, height = np.ceil(rays.max((0, 1)) + 0.5 - 1e-6 - low).astype(int).tolist()
        self.source = PinholeCamera(width, height, camera.fx, camera.fy, *(-low).tolist())
        # OpenCV counts from the centre of the first pixel.
        x, y = np.moveaxis(rays - low - 0.5, -1, 0).astype(np.float32)
        self._x, self._y = np.ascontiguousarray(x), np.ascontiguousarray(y)

    def bend(self, image: Image) -> Image:
        """A `source` image (h, w, 3) uint8 as `camera` sees it (height, width, 3).

        Raises:
            ValueError: the image does not have the size of `source`.
        """
        if image.shape[:2] != (self.source.height, self.source.width):
            expected = (self.source.height, self.source.width)
            raise ValueError(f"Lens.bend: expected {expected} pixels, got {image.shape[:2]}")
        bent = cv2.remap(image, self._x, self._y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(bent, np.uint8)
