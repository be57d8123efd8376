"""H.264 films in MP4: written whole or not at all, the same frames giving the same bytes."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.reformatter import Colorspace, VideoReformatter
from numpy.typing import NDArray

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.files import atomic_file
from recast.core.images import draw_text

_BT709 = 1  # code point shared by primaries, transfer and matrix in ITU-T H.273
_LIMITED_RANGE = 1
_LABEL_HEIGHT = 28
_LABEL_BACKGROUND = (24, 27, 33)
_LABEL_TEXT = (236, 239, 244)
_ACROSS = 4  # films in a row: decoders stop at about 4000 pixels
_GAP = 4  # between the films of a side-by-side film, pixels


class VideoWriter:
    """Write uint8 RGB frames to an MP4 that any browser plays.

    libx264, yuv420p, BT.709, one thread and no time or version stamps, so that equal frames give
    equal bytes. yuv420p needs even sizes: an odd last row or column is doubled. The file appears
    under its name when the `with` block ends without an error, and not at all otherwise.

    Args:
        fps: frames per second; 10 for rollouts of 0.1 s steps.
        crf: constant rate factor, 0 (lossless) to 51; 18 is hard to tell from the source; 23 is
            at 38 to 43 dB on the demo's films, and 57 % of the size.
    """

    def __init__(self, path: str | Path, fps: float = 10.0, crf: int = 23) -> None:
        self.path = Path(path)
        self.fps = Fraction(fps).limit_denominator(1000)
        self.crf = crf
        self._shape: tuple[int, ...] | None = None
        self._frames = 0
        self._stack = ExitStack()
        self._reformatter = VideoReformatter()  # a frame by itself makes a new one each time

    def __enter__(self) -> VideoWriter:
        partial = self._stack.enter_context(atomic_file(self.path))
        self._container = self._stack.enter_context(
            av.open(
                str(partial),
                "w",
                format="mp4",
                options={"fflags": "+bitexact", "movflags": "+faststart"},
            )
        )
        return self

    def add(self, frame: Image) -> None:
        """Append one frame (H, W, 3) uint8 RGB.

        Raises:
            ValueError: not such an array, or of another size than the first frame.
        """
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise ValueError(f"frame: expected (H, W, 3) uint8, got {frame.shape} {frame.dtype}")
        if self._shape is None:
            self._shape = frame.shape
            self._open_stream(
                frame.shape[1] + frame.shape[1] % 2, frame.shape[0] + frame.shape[0] % 2
            )
        elif frame.shape != self._shape:
            raise ValueError(
                f"frame: shape {frame.shape}, expected {self._shape} as in the first frame"
            )
        picture = self._reformatter.reformat(
            av.VideoFrame.from_ndarray(_even(frame), format="rgb24"),
            format="yuv420p",
            dst_colorspace=Colorspace.ITU709,
        )
        picture.pts = self._frames
        picture.time_base = 1 / self.fps
        self._frames += 1
        self._container.mux(self._stream.encode(picture))

    def _open_stream(self, width: int, height: int) -> None:
        self._stream = self._container.add_stream("libx264", rate=self.fps)
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.time_base = 1 / self.fps
        self._stream.options = {
            "crf": str(self.crf),
            # Against "veryfast" at the same size: two thirds of the time, 0.4 dB less.
            "preset": "superfast",
            "threads": "1",
            # x264's vector code for the macroblock tree reads beyond its buffers: with it the bytes
            # change from one encoding to the next.
            "x264-params": "mbtree=0",
            # A key frame every second: scrubbing decodes at most that much.
            "g": str(max(1, round(self.fps))),
        }
        context = self._stream.codec_context
        context.thread_count = 1
        context.flags |= av.codec.context.Flags.bitexact
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = _LIMITED_RANGE

    def __exit__(self, *fault: Any) -> None:
        try:
            if fault[0] is None:
                if self._frames == 0:
                    raise ValueError(f"{self.path}: a video needs at least one frame")
                self._container.mux(self._stream.encode(None))
        except BaseException:
            self._stack.__exit__(*sys.exc_info())
            raise
        self._stack.__exit__(*fault)


def write_video(path: str | Path, frames: Iterable[Image], fps: float = 10.0) -> None:
    """Write frames (H, W, 3) uint8 RGB to an MP4; see `VideoWriter`."""
    with VideoWriter(path, fps) as writer:
        for frame in frames:
            writer.add(frame)


def iterate_video(path: str | Path) -> Iterator[Image]:
    """Decode a film frame by frame: (H, W, 3) uint8 RGB.

    Raises:
        InputError: the file is missing or is no film.
    """
    reformatter = VideoReformatter()
    with _decoded(path) as frames:
        for frame in frames:
            yield _rgb(frame, reformatter)


@contextmanager
def _decoded(path: str | Path) -> Iterator[Iterator[av.VideoFrame]]:
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "file", "is missing", "check the path")
    try:
        with av.open(str(path)) as container:
            yield container.decode(video=0)
    except (av.error.FFmpegError, IndexError) as error:
        raise InputError(
            path, "video", f"cannot be decoded ({error})", "write the video again"
        ) from error


def _rgb(frame: av.VideoFrame, reformatter: VideoReformatter) -> Image:
    return np.asarray(reformatter.reformat(frame, format="rgb24").to_ndarray(), np.uint8)


def film_frames(path: str | Path, steps: Iterable[int]) -> dict[int, Image]:
    """Decode some frames of a film: step to (H, W, 3) uint8 RGB.

    A step beyond the end gives the last frame.

    Raises:
        InputError: the file is missing or is no film.
    """
    wanted, found = sorted(set(steps)), {}
    reformatter = VideoReformatter()
    with _decoded(path) as frames:
        last = None
        for number, frame in enumerate(frames):
            last = frame
            if number in wanted:
                found[number] = _rgb(frame, reformatter)
            if wanted and number >= wanted[-1]:
                break
        if last is None:
            raise InputError(path, "video", "has no frame", "write the video again")
        end = _rgb(last, reformatter)
    return {step: found.get(step, end) for step in wanted}


def read_video(path: str | Path) -> tuple[NDArray[np.uint8], float]:
    """Decode a whole film: frames (F, H, W, 3) uint8 RGB and frames per second.

    Raises:
        InputError: the file is missing or is no film.
    """
    frames = np.stack(list(iterate_video(path)))
    return frames, video_fps(path)


def video_fps(path: str | Path) -> float:
    """Frames per second of a film.

    Raises:
        InputError: the film does not say.
    """
    with av.open(str(path)) as container:
        rate = container.streams.video[0].average_rate
    if rate is None:
        raise InputError(path, "frame rate", "is not given", "write the video again")
    return float(rate)


def side_by_side(films: Sequence[str | Path], out: str | Path, labels: Sequence[str]) -> None:
    """Join films into one, beside each other, each under its label, four in a row at most.

    All are scaled to the height of the first. If one ends before the others, its last frame stays
    and its label says so.

    Args:
        films: films to join, at least one.

    Raises:
        InputError: a film is missing or broken, or the films run at different rates.
    """
    parts = [iterate_video(film) for film in films]
    current = [next(part) for part in parts]
    fps = _common_fps(films)
    ended = [False] * len(parts)
    height = current[0].shape[0]
    with VideoWriter(out, fps) as writer:
        while not all(ended):
            columns = [
                _labelled(_to_height(frame, height), label, done)
                for frame, label, done in zip(current, labels, ended, strict=True)
            ]
            writer.add(_in_rows(columns))
            for i, part in enumerate(parts):
                following = next(part, None)
                ended[i] = following is None
                current[i] = current[i] if following is None else following


def _in_rows(frames: Sequence[Image]) -> Image:
    """Frames of one height beside each other, black where a row is not full."""
    rows = []
    for first in range(0, len(frames), _ACROSS):
        parts = [part for frame in frames[first : first + _ACROSS] for part in (_bar(frame), frame)]
        rows.append(np.concatenate(parts[1:], axis=1))
    width = max(row.shape[1] for row in rows)
    return np.concatenate(
        [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows]
    )


def _bar(frame: Image) -> Image:
    return np.zeros((frame.shape[0], _GAP, 3), np.uint8)


def _common_fps(films: Sequence[str | Path]) -> float:
    first, *others = [video_fps(film) for film in films]
    for film, rate in zip(films[1:], others, strict=True):
        if rate != first:
            raise InputError(
                film,
                "frame rate",
                f"is {rate:g}, but that of the first video is {first:g}",
                "render both with the same frame rate",
            )
    return first


def _even(frame: Image) -> Image:
    height, width = frame.shape[:2]
    if height % 2 or width % 2:
        frame = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.ascontiguousarray(frame)


def _to_height(frame: Image, height: int) -> Image:
    if frame.shape[0] == height:
        return frame
    width = round(frame.shape[1] * height / frame.shape[0])
    scaled = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(scaled, np.uint8)


def _labelled(frame: Image, label: str, ended: bool) -> Image:
    text = " ".join(label.split()) + (" (ended)" if ended else "")
    return np.concatenate([_strip(text, frame.shape[1]), frame], axis=0)


@lru_cache(maxsize=16)
def _strip(text: str, width: int) -> Image:
    strip = np.full((_LABEL_HEIGHT, width, 3), _LABEL_BACKGROUND, np.uint8)
    draw_text(strip, (10, _LABEL_HEIGHT // 2), text, _LABEL_TEXT, 15, "lm")
    return strip
