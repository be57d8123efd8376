"""Encoded images, in bytes and in files, decoded only if they have the size that is expected."""

from __future__ import annotations

import hashlib
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from recast.core import images
from recast.core.errors import InputError
from recast.core.files import read_bytes
from recast.core.images import rgb, rgba
from recast.logs.types import Image

_LARGEST = 1 << 28
"""Bytes of an image file."""
_PNG = b"\x89PNG"


def decode(
    data: bytes, kind: str, size: tuple[int, int], where: str | Path, says: str, mode: str = "RGB"
) -> Image:
    """The pixels of an encoded image, (height, width, 3) uint8, or (height, width, 4) of mode
    "RGBA"; upright, 16 bits scaled to 8.

    Args:
        kind: "png" or "jpeg".
        size: width and height in pixels that it must have.
        where: file that holds it, for messages.
        says: what says that size, for messages.

    Raises:
        InputError: it is of another kind or size, cut off or damaged.
    """
    with _opened(data, kind, where) as image:
        require_size(image.size, size, where, says)
        levels = image.levels()
    return rgba(levels) if mode == "RGBA" else rgb(levels)


def encode(image: Image, kind: str = "png", quality: int = 95) -> bytes:
    """The file of an image (height, width, 3 or 4) uint8, RGB or RGBA.

    Args:
        kind: "png" or "jpeg".
        quality: JPEG quality, 1 to 100.
    """
    import cv2  # 0.1 s that reading a log does without

    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if kind == "jpeg" else []
    turn = cv2.COLOR_RGBA2BGRA if image.shape[-1] == 4 else cv2.COLOR_RGB2BGR
    return cv2.imencode(f".{kind}", cv2.cvtColor(image, turn), options)[1].tobytes()


def size_of(data: bytes, kind: str, where: str | Path) -> tuple[int, int]:
    """Width and height, upright, that an encoded image says; its pixels are not decoded.

    Args:
        kind: "png" or "jpeg".
        where: file that holds it, for messages.

    Raises:
        InputError: it is of another kind or damaged.
    """
    with _opened(data, kind, where) as image:
        return image.size


def require_size(
    found: tuple[int, int], size: tuple[int, int], where: str | Path, says: str
) -> None:
    """Check the width and height of an image; arguments as of `decode`. Raises InputError: they
    differ."""
    if found != size:
        raise InputError(
            where,
            "image size",
            f"is {found[0]}x{found[1]}, but {says} says {size[0]}x{size[1]}",
            "use images and calibration of the same recording",
        )


def stored(data: bytes, kind: str, where: str | Path) -> tuple[bytes, str]:
    """An image file and its kind for a log's store, in which all are 8-bit and upright.

    Its own bytes, or a PNG of what `decode` makes of it: programs differ in how they show 16 bits,
    CMYK, or an image that its EXIF orientation turns.

    Raises:
        InputError: as of `size_of`.
    """
    with _opened(data, kind, where) as image:
        return (data, kind) if image.plain else (encode(rgb(image.levels())), "png")


def _opened(data: bytes, kind: str, where: str | Path) -> AbstractContextManager[images.OpenImage]:
    if kind not in ("png", "jpeg"):
        raise InputError(
            where, "image", f"is {kind!r}, not png or jpeg", "convert it to PNG or JPEG"
        )
    return images.opened(data, where, (kind.upper(),), mend="download it again")


def kind_of(data: bytes) -> str:
    """ "png" or "jpeg", by how the file begins: names of files may say otherwise."""
    return "png" if data.startswith(_PNG) else "jpeg"


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of a PNG or JPEG file; its pixels are not decoded. Raises InputError: it is
    no such file."""
    data = read_bytes(path, _LARGEST)
    return size_of(data, kind_of(data), path)


@dataclass(frozen=True)
class ImageFiles:
    """PNG or JPEG files of one camera; an `EncodedImageSource`."""

    paths: tuple[Path, ...]  # F files in the order of time
    # width, height: pixels that every image must have.
    width: int
    height: int
    calibration: str  # name of the file that says so, for messages
    # digests of the bytes of files that were decoded by `check`.
    checked: dict[Path, bytes] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.paths)

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB; raises as `encoded` does."""
        path = self.paths[index]
        return self._decode(path, read_bytes(path, _LARGEST))

    def encoded(self, index: int) -> tuple[bytes, str]:
        """What `stored` makes of the file, decoded once, unless `check` saw the same bytes. Raises
        InputError: it is cut off, is no image, or has another size."""
        path = self.paths[index]
        data = read_bytes(path, _LARGEST)
        if self.checked.get(path) != _digest(data):
            self._decode(path, data)
        return stored(data, kind_of(data), path)

    def check(self) -> None:
        """Decode every file once. Raises InputError: one is cut off, is no image, or has another
        size."""
        for path in self.paths:
            data = read_bytes(path, _LARGEST)
            self._decode(path, data)
            self.checked[path] = _digest(data)

    def _decode(self, path: Path, data: bytes) -> Image:
        return decode(data, kind_of(data), (self.width, self.height), path, self.calibration)


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=16).digest()
