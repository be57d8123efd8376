"""The image files of one camera, decoded or passed on when asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from recast.logs.image_bytes import decode, size_of
from recast.logs.types import Image
from recast.storage import read_bytes

_LARGEST = 1 << 28
"""Bytes of an image file."""
_PNG = b"\x89PNG"


def kind_of(data: bytes) -> str:
    """ "png" or "jpeg", by how the file begins: names of files may say otherwise."""
    return "png" if data.startswith(_PNG) else "jpeg"


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of a PNG or JPEG file; its pixels are not decoded.

    Raises:
        InputError: it is no such file.
    """
    data = read_bytes(path, _LARGEST)
    return size_of(data, kind_of(data), path)


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
        """Decode frame `index` to (height, width, 3) uint8 RGB.

        Raises:
            InputError: see `encoded`.
        """
        path = self.paths[index]
        return self._decode(path, read_bytes(path, _LARGEST))

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The file's own bytes, decoded once to be sure of them.

        Raises:
            InputError: it is cut off, is no image, or has another size.
        """
        path = self.paths[index]
        data = read_bytes(path, _LARGEST)
        self._decode(path, data)
        return data, kind_of(data)

    def check(self) -> None:
        """Decode every file once.

        Raises:
            InputError: one is cut off, is no image, or has another size.
        """
        for index in range(len(self)):
            self[index]

    def _decode(self, path: Path, data: bytes) -> Image:
        return decode(data, kind_of(data), (self.width, self.height), path, self.calibration)
