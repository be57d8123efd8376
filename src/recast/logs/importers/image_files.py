"""The image files of one camera, decoded or passed on when asked for."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

from recast.errors import InputError
from recast.logs.types import Image


@dataclass(frozen=True)
class ImageFiles:
    """PNG or JPEG files of one camera; an `EncodedImageSource`.

    Attributes:
        paths: F files in the order of time.
        width, height: pixels that every image must have.
        calibration: name of the file that says so, for messages.
    """

    paths: tuple[Path, ...]
    width: int
    height: int
    calibration: str

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.paths)

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB."""
        return self._decode(self.paths[index].read_bytes(), self.paths[index])

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The file's own bytes, decoded once to be sure of them.

        Raises:
            InputError: it is cut off, is no image, or has another size.
        """
        path = self.paths[index]
        data = path.read_bytes()
        self._decode(data, path)
        return data, "jpeg" if path.suffix in (".jpg", ".jpeg") else "png"

    def check(self) -> None:
        """Decode every file once.

        Raises:
            InputError: one is cut off, is no image, or has another size.
        """
        for index in range(len(self)):
            self[index]

    def _decode(self, data: bytes, path: Path) -> Image:
        try:
            with PillowImage.open(io.BytesIO(data)) as image:
                pixels = np.array(image.convert("RGB"))
        except (OSError, SyntaxError, ValueError) as error:
            raise InputError(
                path, "image", f"cannot be decoded ({error})", "download it again"
            ) from None
        if pixels.shape[:2] != (self.height, self.width):
            raise InputError(
                path,
                "image size",
                f"is {pixels.shape[1]}x{pixels.shape[0]}, {self.calibration} says "
                f"{self.width}x{self.height}",
                "take images and calibration of the same recording",
            )
        return pixels
