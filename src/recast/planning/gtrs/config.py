"""Settings of a GTRS planner: sizes of its model, layout of its images, what it chooses from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, Self

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from torch import Tensor

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.cameras.mounts import NUPLAN_CAMERAS, View
from recast.core.errors import InputError
from recast.core.records import Record
from recast.planning.cameras import require_cameras
from recast.planning.types import WAYPOINTS

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
        history: seconds by which a second image is older than the present one, up to half of it
            off; None for a model that looks at the present image alone, as the released one does.
    """

    backbone: BackboneConfig = BackboneConfig()
    channels: Count = 256
    feedforward: Count = 1024
    heads: Count = 8
    decoder_layers: Depth = 3
    token_rows: Count = 16
    token_columns: Count = 64
    history: float | None = Field(default=None, gt=0.0, le=4.0)

    def ages(self, there: Iterable[float]) -> list[float]:
        """Which of the ages of earlier images, seconds, the model looks at, the best one first."""
        history = self.history or 0.0
        near = [one for one in there if abs(one - history) <= 0.5 * history + 1e-6]
        return sorted(near, key=lambda one: abs(one - history)) if history else []

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
        focal = self._focal
        camera = PinholeCamera(
            self.width, self.height, focal, focal, self.width / 2, self.height / 2
        )
        sides = (self.crop_columns, 0, self.crop_columns)
        return tuple(
            View(name, camera, yaw, self.crop_rows, columns)
            for name, yaw, columns in zip(self.cameras, self.yaws, sides, strict=True)
        )

    @property
    def _focal(self) -> float:
        return float(self.width / (2 * np.tan(np.deg2rad(self.field_of_view) / 2)))

    def directions(self, count: int) -> Array:
        """(count,) angles against straight on, radians, left positive, of equal parts of the
        network's input, side by side.

        Raises:
            ValueError: the columns of the three pictures do not divide into so many parts.
        """
        every = self.width / 2 - np.arange(self.width) - 0.5
        found = []
        for yaw, cut in zip(self.yaws, (self.crop_columns, 0, self.crop_columns), strict=True):
            found.append(np.deg2rad(yaw) + np.arctan(every[cut : self.width - cut] / self._focal))
        columns = np.concatenate(found)
        if len(columns) % count:
            raise ValueError(f"{len(columns)} columns do not divide into {count} parts")
        return columns.reshape(count, -1).mean(axis=1)

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


class Pace(Record):
    """One speed of a motion primitive: an acceleration, m/s^2, between two times, s, else none.

    Attributes:
        everywhere: combined with every path; else with the main ones alone.
        jerk: m/s^3 with which the acceleration changes; None for the usual one.
    """

    acceleration: float = Field(ge=-10.0, le=5.0)
    begins: float = Field(default=0.0, ge=0.0, le=4.0)
    ends: float = Field(default=4.0, ge=0.0, le=4.0)
    everywhere: bool = False
    jerk: float | None = Field(default=None, gt=0.0, le=20.0)


class PrimitivePath(Record):
    """One path of a motion primitive, against the bend that the ego drives at present.

    All lengths are shares of the reach, see `MotionPrimitives`.

    Attributes:
        kind: "bend": the curvature changes, and stays; "straight": it falls to zero; "shift": the
            ego moves aside, and heads as before; "turn": its heading changes, its bend does not.
        by: metres aside at the end of the reach; of a turn, radians. To the left is positive.
        over: the share of the reach that it takes.
        main: combined with every pace.
    """

    kind: Literal["bend", "straight", "shift", "turn"]
    by: float = 0.0
    over: float = Field(default=0.25, gt=0.0, le=1.0)
    main: bool = False


class MotionPrimitives(Record):
    """Trajectories that begin as the ego moves now: a vocabulary that goes with its state.

    A fixed vocabulary spends most of its entries on speeds and bends other than the present ones,
    and what is nearest begins with a jolt. Each primitive here is a pace along a path: the
    acceleration goes from the present one to the wanted one with limited jerk, down to standing
    still; the path begins with the present bend. The reach, at which paths are told, is what 4 s
    at the present speed cover, or `least_reach` if that is more.

    Attributes:
        paces, paths: what is combined.
        least_reach: metres.
    """

    paces: tuple[Pace, ...] = Field(min_length=1, max_length=64)
    paths: tuple[PrimitivePath, ...] = Field(min_length=1, max_length=256)
    least_reach: float = Field(default=12.0, gt=0.0)

    @property
    def entries(self) -> NDArray[np.int64]:
        """(L, 2) index of the pace and of the path of each primitive."""
        found = [
            (i, j)
            for j, path in enumerate(self.paths)
            for i, pace in enumerate(self.paces)
            if path.main or pace.everywhere
        ]
        return np.array(found, np.int64).reshape(-1, 2)

    @property
    def mirror(self) -> NDArray[np.int64]:
        """(L,) for each primitive the one that is its mirror image, where the ego's bend is
        mirrored, too.

        Raises:
            InputError: a path has none.
        """
        other = {path: j for j, path in enumerate(self.paths)}
        twins = []
        for j, path in enumerate(self.paths):
            twin = other.get(path.model_copy(update={"by": -path.by + 0.0}))
            if twin is None:
                raise InputError("primitives", f"path {j}", "has no mirror image", "add it")
            twins.append(twin)
        order = {(i, j): index for index, (i, j) in enumerate(self.entries.tolist())}
        return np.array([order[i, twins[j]] for i, j in self.entries.tolist()], np.int64)

    @model_validator(mode="after")
    def _something_to_choose(self) -> Self:
        if len(self.entries) == 0:
            raise ValueError("no path is `main`, and no pace `everywhere`: nothing is combined")
        return self

    def __len__(self) -> int:
        return len(self.entries)

    def trajectories(self, status: ArrayLike) -> NDArray[np.float32]:
        """(K, L, 40, 3) x, y, heading at 0.1 s .. 4 s in the present ego frame.

        Args:
            status: (K, 8), see `ego_status`.
        """
        status = np.asarray(status, np.float64)
        speed = np.maximum(status[:, 4], 0.0)
        rate = np.clip(status[:, 6], *_PRESENT_RATES)
        bend = status[:, 7] / np.maximum(speed, 1.0) ** 2
        bend = np.clip(bend, -_SHARPEST, _SHARPEST)
        paces, along = self.entries.T
        s = self._driven(speed, rate)[:, paces]  # (K, L, 41)
        reach = np.maximum(speed * WAYPOINTS * _DT, self.least_reach)
        heading = np.empty((*s.shape[:2], 2 * WAYPOINTS))
        steps = np.diff(s, axis=-1)
        # At the middle of each step, where the way leads, and at its end.
        places = np.stack([s[..., :-1] + steps / 2, s[..., 1:]], axis=-1).reshape(heading.shape)
        for j, path in enumerate(self.paths):
            rows = along == j
            heading[:, rows] = _headings(path, places[:, rows], speed, bend, reach)
        x = np.cumsum(steps * np.cos(heading[..., 0::2]), axis=-1)
        y = np.cumsum(steps * np.sin(heading[..., 0::2]), axis=-1)
        return np.stack([x, y, heading[..., 1::2]], axis=-1).astype(np.float32)

    def _driven(self, speed: Array, rate: Array) -> Array:
        """Metres (K, P, 41) driven from speeds (K,) and accelerations (K,)."""
        wanted = np.array([one.acceleration for one in self.paces])
        begins, ends = np.array([(one.begins, one.ends) for one in self.paces]).T
        usual = np.where(wanted < _HARD, _JERKS[1], _JERKS[0])
        jerk = _DT * np.array([one.jerk or usual[i] for i, one in enumerate(self.paces)])
        now = np.repeat(rate[:, None], len(wanted), axis=1)
        speeds = [np.repeat(speed[:, None], len(wanted), axis=1)]
        for step in range(WAYPOINTS):
            time = (step + 0.5) * _DT
            goal = np.where((begins <= time) & (time < ends), wanted, 0.0)
            # Braking ends gently: sqrt(2 v jerk) at a speed v, with a margin for the steps' length.
            goal = np.maximum(goal, -np.sqrt(2.0 * speeds[-1] * _ENDING * jerk / _DT))
            later = now + np.clip(goal - now, -jerk, jerk)
            speeds.append(np.maximum(speeds[-1] + _DT * (now + later) / 2, 0.0))
            now = np.where(speeds[-1] > 0.0, later, np.maximum(later, 0.0))
        run = np.stack(speeds, axis=-1)
        driven = np.cumsum(_DT * (run[..., 1:] + run[..., :-1]) / 2, axis=-1)
        return np.concatenate([np.zeros_like(run[..., :1]), driven], axis=-1)


_DT = 0.1
_PRESENT_RATES = (-6.0, 2.4)
"""m/s^2 of the ego that primitives go on from."""
_SHARPEST, _SIDEWAYS = 0.18, 5.0
"""1/m, and m/s^2 of lateral acceleration: no primitive asks for more."""
_HARD, _JERKS, _ENDING = -2.3, (3.5, 7.0), 0.45
"""m/s^2 below which a pace brakes hard, the jerk, m/s^3, of the others and of these (the metric
COM allows 8.37), and the share of it with which braking ends."""
_FOLLOWED = 2.2
"""m/s^3 with which hard braking begins where there is time: followed by the tracker, with a new
plan every 0.5 s, it becomes 4 m/s^3, within nuPlan's limit on the driven path."""


def _headings(path: PrimitivePath, s: Array, speed: Array, bend: Array, reach: Array) -> Array:
    """Headings (K, N, T) on a path at s (K, N, T) metres; speed, bend and reach are (K,)."""
    bend, reach = bend[:, None, None], reach[:, None, None]
    over = np.maximum(path.over * reach, 2.0)
    u = np.minimum(s / over, 1.0)
    if path.kind == "shift":
        slope = path.by / over * 30.0 * u**2 * (1.0 - u) ** 2
        return np.asarray(bend * s + np.clip(slope, -0.3, 0.3))
    if path.kind == "turn":
        return np.asarray(bend * s + path.by * u**2 * (3.0 - 2.0 * u))
    share = over / reach
    more = path.by / (reach**2 * (share**2 / 6.0 + (1.0 - share) / 2.0))
    more = -bend if path.kind == "straight" else more
    limit = np.minimum(_SHARPEST, _SIDEWAYS / np.maximum(speed, 1.0) ** 2)[:, None, None]
    more = np.clip(bend + more, -limit, limit) - bend
    # The curvature changes linearly over the share, and stays.
    return np.asarray(bend * s + more * np.where(s < over, s * u / 2.0, s - over / 2.0))


def _standard_primitives() -> MotionPrimitives:
    held = (-6.0, -4.0, -3.0, -2.2, -1.6, -1.1, -0.7, -0.35, 0.0, 0.35, 0.7, 1.2, 1.8, 2.3)
    everywhere = (-4.0, -2.2, -0.7, 0.0, 0.7, 1.8)
    parts = ((-3.0, 0.0, 1.5), (-1.5, 0.0, 2.0), (1.2, 0.0, 2.0))
    late = ((-4.0, 1.2, 4.0), (-2.2, 1.2, 4.0), (-1.1, 1.2, 4.0))
    paces = [Pace(acceleration=a, everywhere=a in everywhere) for a in held]
    paces += [Pace(acceleration=a, begins=b, ends=e) for a, b, e in (*parts, *late)]
    paces += [Pace(acceleration=a, jerk=_FOLLOWED) for a in (-3.0, -4.0)]
    paths = [
        PrimitivePath(kind="bend", main=True),
        PrimitivePath(kind="straight", main=True),
        PrimitivePath(kind="straight", over=1.0, main=True),
    ]
    beside: list[tuple[Literal["bend", "shift", "turn"], float, float, bool]] = [
        *(("bend", by, 0.25, by < 2.0) for by in (0.7, 1.8, 4.0, 8.0, 15.0, 27.0)),
        *(("bend", by, 1.0, False) for by in (1.0, 3.0, 8.0)),
        *(("shift", by, 1.0, False) for by in (0.4, 1.0, 3.4)),
        *(("turn", by, 0.25, False) for by in (0.04, 0.1)),
    ]
    paths += [
        PrimitivePath(kind=kind, by=sign * by, over=over, main=main)
        for kind, by, over, main in beside
        for sign in (1.0, -1.0)
    ]
    return MotionPrimitives(paces=tuple(paces), paths=tuple(paths))


PRIMITIVES = _standard_primitives()
"""298 of them: from emergency braking to brisk driving on, along the lane and into side roads."""

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
