"""Pictures by step: of a log's camera, or of the film of a rollout."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from itertools import islice
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.logs import CameraStream
from recast.reporting.video import iterate_video

Image = NDArray[np.uint8]

WIDEST = 480
"""Pixels; larger pictures are scaled down before they are sent."""
_QUALITY = 85


class LogFilm:
    """The images of a log's camera nearest in time to the steps of a drive.

    Args:
        stream: the camera.
        times_us: (T,) log time of each step.
    """

    def __init__(self, stream: CameraStream, times_us: NDArray[np.int64]) -> None:
        away = np.abs(stream.timestamps_us[None] - times_us[:, None])
        self._stream, self._frames = stream, away.argmin(axis=1)
        self._picture = lru_cache(maxsize=4)(self._read)  # several tabs and panes ask for one step

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, step: int, /) -> Image:
        return self._picture(int(self._frames[step]))

    def _read(self, frame: int) -> Image:
        return shrunk(self._stream.images[frame])


class FilmFile:
    """The film of a rollout, decoded as far as it is looked at and kept as JPEG.

    Args:
        path: film that `recast.reporting.video` can read.
        steps: number of pictures that it has; more are not read.
    """

    def __init__(self, path: Path, steps: int) -> None:
        self._left, self._steps = iterate_video(path), steps
        self._kept: list[NDArray[np.uint8]] = []
        self._lock = Lock()

    def __len__(self) -> int:
        return self._steps

    def __getitem__(self, step: int, /) -> Image:
        with self._lock:
            missing = step + 1 - len(self._kept)
            self._kept += encoded(islice(self._left, max(missing, 0)))
        return _decoded(self._kept[min(step, len(self._kept) - 1)])


class FilmFrames:
    """Pictures of a rollout that was run from the page, kept as JPEG."""

    def __init__(self) -> None:
        self._kept: list[NDArray[np.uint8]] = []

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, step: int, /) -> Image:
        return _decoded(self._kept[min(step, len(self._kept) - 1)])

    def add(self, picture: Image) -> None:
        """Append the picture (H, W, 3) of the next step."""
        self._kept += encoded([picture])


def encoded(pictures: Iterable[Image]) -> list[NDArray[np.uint8]]:
    """Pictures (H, W, 3) RGB as JPEG bytes, at most `WIDEST` wide."""
    options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    return [
        np.asarray(cv2.imencode(".jpg", shrunk(picture)[..., ::-1], options)[1], np.uint8)
        for picture in pictures
    ]


def shrunk(picture: Image, widest: int = WIDEST) -> Image:
    """A picture (H, W, 3), scaled down to `widest` pixels if it is wider."""
    height, width = picture.shape[:2]
    if width <= widest:
        return picture
    size = widest, max(1, round(height * widest / width))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _decoded(kept: NDArray[np.uint8]) -> Image:
    found = cv2.imdecode(kept, cv2.IMREAD_COLOR)
    assert found is not None  # it was encoded here
    return np.asarray(found[..., ::-1], np.uint8)
