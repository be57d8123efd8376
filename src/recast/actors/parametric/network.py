"""The parametric model's network and what it sees.

It sees the crop unwrapped onto the sides of the box, and its geometry. The camera and the box are
known, so every pixel of a side, a front and a rear view is looked up in the crop. A lamp then lies
at the same pixels in all photographs, near or far, from left or right, and a small network can read
it. Vehicles are symmetric: one seen from its right is mirrored.

An encoder of these planes, a regression, and a flow of designs: the regression gives mean and log
variance of each number, and logits of each choice. The flow takes noise to rows that hold the
numbers, standardised, and the choices as one-hot values. It is told what the regression found, so
that it need only learn what is left open.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, silu

from recast.actors.observation import Observation
from recast.actors.template.lighting import road_level, road_light, road_tint
from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core.records import Record
from recast.geometry import boxes, se3
from recast.trellis.sampler import FlowMatching

SHAPES = {"side": (32, 96), "rear": (32, 48), "front": (32, 48), "crop": (48, 48)}
"""Rows and columns of each plane; `crop` is the photograph itself around the box."""
CHANNELS = 5
"""Colour within the mask, mask, and whether the plane is seen."""
CATEGORIES = ("car", "van", "truck", "bus")
GEOMETRY = 16 + len(CATEGORIES)
_AROUND = 1.08  # the planes reach beyond the box, whose labels are off
_FINEST = 30.0  # pixels a metre of the crop that planes are looked up in
_SEEN = 0.35  # cosine to a plane above which it counts as seen squarely


@dataclass(frozen=True)
class ConditionImages:
    """One photograph as the network takes it."""

    planes: NDArray[np.uint8]  # (pixels of all `SHAPES`, 5)
    geometry: NDArray[np.float32]  # (GEOMETRY,)


def condition_of(observation: Observation) -> ConditionImages:
    """The condition of an observation, its further views left out."""
    return unwrapped(
        observation.rgba,
        observation.camera,
        observation.camera_from_object,
        observation.size,
        observation.category,
        road_light(replace(observation, further=())),
    )


def unwrapped(
    rgba: Image,
    camera: PinholeCamera,
    camera_from_object: Array,
    size: Array,
    category: str,
    road: Array,
) -> ConditionImages:
    """Look the planes up in a photograph.

    Args:
        rgba: (H, W, 4) uint8.
        camera, camera_from_object, size, category: see `Observation`.
        road: (3,) linear light of the road, see `road_light`.
    """
    size = np.asarray(size, np.float64)
    depth = float(np.linalg.norm(camera_from_object[:3, 3]))
    scale = min(1.0, _FINEST * depth / camera.fx)
    if scale < 0.9:
        width, height = (max(8, round(scale * v)) for v in (camera.width, camera.height))
        camera = camera.resized(width, height)
        alpha = cv2.resize(rgba[..., 3], (width, height), interpolation=cv2.INTER_AREA)
        colour = cv2.resize(rgba[..., :3], (width, height), interpolation=cv2.INTER_AREA)
        rgba = np.dstack([colour, alpha])
    rotation, translation = camera_from_object[:3, :3], camera_from_object[:3, 3]
    eye = -rotation.T @ translation
    right = 1.0 if eye[1] >= 0 else -1.0  # of two mirror images, that with the eye on the left
    images = [
        _looked_up(rgba, camera, camera_from_object, _plane(name, size, right), cosine)
        for name, cosine in zip(("side", "rear", "front"), _facing(size, eye), strict=True)
    ]
    images.append(_around(rgba, camera, camera_from_object, size, right))
    planes = np.concatenate([image.reshape(-1, CHANNELS) for image in images])
    return ConditionImages(planes, _geometry(size, eye, camera.fx / scale, category, road))


def _facing(size: Array, eye: Array) -> tuple[float, float, float]:
    """Cosines between the way out of side, rear and front and the way to the eye."""
    away = [np.abs(eye[1]) - size[1] / 2, -eye[0] - size[0] / 2, eye[0] - size[0] / 2]
    return tuple(float(v / np.linalg.norm(eye)) for v in away)  # type: ignore[return-value]


def _plane(name: str, size: Array, right: float) -> Array:
    """Points (rows, columns, 3) of a plane in the object frame, the first row on top."""
    rows, columns = SHAPES[name]
    v, u = np.meshgrid(
        np.linspace(1, -1, rows) * _AROUND, np.linspace(1, -1, columns) * _AROUND, indexing="ij"
    )
    half = size / 2
    if name == "side":
        return np.stack([u * half[0], np.full_like(u, right * half[1]), v * half[2]], axis=-1)
    end = half[0] if name == "front" else -half[0]
    return np.stack([np.full_like(u, end), right * u * half[1], v * half[2]], axis=-1)


def _looked_up(
    rgba: Image, camera: PinholeCamera, camera_from_object: Array, points: Array, cosine: float
) -> Image:
    """(rows, columns, 5) of a plane."""
    flat = se3.apply(camera_from_object, points.reshape(-1, 3))
    pixels, depth = camera.project(flat)
    seen = (depth > 0.2) & np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    squarely = np.clip(cosine / _SEEN, 0.0, 1.0) * seen
    return _sampled(rgba, pixels, squarely).reshape(*points.shape[:2], CHANNELS)


def _around(
    rgba: Image, camera: PinholeCamera, camera_from_object: Array, size: Array, right: float
) -> Image:
    """(rows, columns, 5) of the square around the box in the photograph."""
    rows, columns = SHAPES["crop"]
    corners, _ = camera.project(boxes.corners(size, camera_from_object))
    low, high = corners.min(axis=0), corners.max(axis=0)
    edge = float(np.clip(_AROUND * (high - low).max(), 4.0, 1e5))
    middle = (low + high) / 2
    v, u = np.meshgrid(
        np.linspace(-0.5, 0.5, rows), right * np.linspace(-0.5, 0.5, columns), indexing="ij"
    )
    pixels = (middle + edge * np.stack([u, v], axis=-1)).reshape(-1, 2)
    seen = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    return _sampled(rgba, pixels, seen.astype(np.float64)).reshape(rows, columns, CHANNELS)


def _sampled(rgba: Image, pixels: Array, seen: Array) -> Image:
    """Bilinear values (N, 5) at pixels (N, 2): colour where the mask is, black elsewhere."""
    u, v = np.clip(pixels - 0.5, -1e4, 1e4).astype(np.float32).T
    found = cv2.remap(rgba, u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(found[0], np.uint8)
    values[:, 3][seen == 0] = 0
    values[:, :3][values[:, 3] < 128] = 0
    return np.concatenate([values, np.round(255 * seen)[:, None].astype(np.uint8)], axis=1)


def _geometry(
    size: Array, eye: Array, focal: float, category: str, road: Array
) -> NDArray[np.float32]:
    """Numbers (GEOMETRY,), each of order one."""
    distance = float(np.linalg.norm(eye))
    azimuth, elevation = np.arctan2(abs(eye[1]), eye[0]), np.arcsin(eye[2] / distance)
    named = [float(category == name) for name in CATEGORIES]
    return np.array(
        [
            *(np.log(size) - np.log([4.5, 1.8, 1.5])) * 3,
            np.cos(azimuth),
            np.sin(azimuth),
            np.cos(2 * azimuth),
            np.sin(2 * azimuth),
            5 * elevation,
            np.log(distance / 12),
            np.log(focal / distance / 40),
            *_facing(size, eye)[:2],
            np.log(road_level(road)),
            float(np.isfinite(road).all()),
            *(10 * np.log(road_tint(road)[::2])),
            *named,
        ],
        np.float32,
    )


_LOGVAR = (-7.0, 2.0)
_SPLITS = tuple(rows * columns for rows, columns in SHAPES.values())
_STRIDE = 16  # of the trunk


class ParametricConfig(Record):
    """Sizes of the network.

    Attributes:
        numbers: count of numbers of a design.
        choices: count of options of each choice.
        channels: channels of the trunk's four levels.
        feature, hidden, depth: width of the feature and of the flow; inner width; flow's blocks.
    """

    numbers: int
    choices: tuple[int, ...]
    channels: tuple[int, int, int, int] = (16, 48, 64, 96)
    feature: int = 256
    hidden: int = 384
    depth: int = 3

    @property
    def row(self) -> int:
        """Values of a row of the flow."""
        return self.numbers + sum(self.choices)


@dataclass(frozen=True)
class Regressed:
    """What the regression tells of B photographs, in standardised numbers."""

    mean: Tensor  # (B, N)
    logvar: Tensor  # (B, N)
    logits: tuple[Tensor, ...]  # (B, options) of each choice


@dataclass(frozen=True)
class ParametricLoss:
    """Parts of the loss of a batch; `flow` is (B,), the others scalars."""

    numbers: Tensor
    choices: Tensor
    flow: Tensor


class ParametricNetwork(nn.Module):
    """Photographs to designs; standardised by `centre` and `spread`, which are its buffers."""

    centre: Tensor
    spread: Tensor

    def __init__(self, config: ParametricConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("centre", torch.zeros(config.numbers))
        self.register_buffer("spread", torch.ones(config.numbers))
        levels = [CHANNELS, *config.channels]
        self.trunk = nn.ModuleList(
            nn.Conv2d(low, high, 3, stride=2, padding=1) for low, high in itertools.pairwise(levels)
        )
        self.norms = nn.ModuleList(nn.GroupNorm(8, channels) for channels in config.channels)
        self.places = nn.Parameter(torch.zeros(len(SHAPES), config.channels[0]))
        width = config.feature
        self.ends = nn.ModuleList(
            nn.Linear(config.channels[-1] * (rows // _STRIDE) * (columns // _STRIDE), width)
            for rows, columns in SHAPES.values()
        )
        self.geometry = nn.Sequential(nn.Linear(GEOMETRY, 128), nn.SiLU(), nn.Linear(128, width))
        self.mixing = nn.ModuleList(_Residual(width, config.hidden) for _ in range(2))
        self.head = nn.Linear(width, 2 * config.numbers + sum(config.choices))
        self.told = nn.Linear(width + config.row + config.numbers, 128)
        self.time = nn.Linear(32, 128)
        self.into = nn.Linear(config.row, width)
        self.blocks = nn.ModuleList(
            _Modulated(width, config.hidden, 128) for _ in range(config.depth)
        )
        self.out = nn.Linear(width, config.row)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def encode(self, planes: Tensor, geometry: Tensor) -> Tensor:
        """Features (B, F) of planes (B, pixels, 5) uint8 and geometry (B, G)."""
        x = self.geometry(geometry)
        parts = planes.split(_SPLITS, dim=1)
        for index, (part, shape) in enumerate(zip(parts, SHAPES.values(), strict=True)):
            seen = part[..., -1].amax(dim=1).nonzero()[:, 0]  # a third is turned away
            if len(seen) == 0:
                continue
            image = part[seen].float().div(255).transpose(1, 2)
            image = image.reshape(len(seen), CHANNELS, *shape)
            for level, (conv, norm) in enumerate(zip(self.trunk, self.norms, strict=True)):
                image = conv(image)
                if level == 0:
                    image = image + self.places[index][:, None, None]
                image = silu(norm(image))
            x = x.index_add(0, seen, self.ends[index](image.flatten(1)))
        for block in self.mixing:
            x = block(x)
        return x

    def regress(self, feature: Tensor) -> Regressed:
        """The regression of features (B, F)."""
        n = self.config.numbers
        mean, logvar, rest = self.head(silu(feature)).split([n, n, sum(self.config.choices)], dim=1)
        return Regressed(mean, logvar.clamp(*_LOGVAR), rest.split(list(self.config.choices), dim=1))

    def known(self, feature: Tensor, found: Regressed) -> Tensor:
        """What the flow is told (B, 128)."""
        odds = [logits.softmax(dim=1) for logits in found.logits]
        told = torch.cat([found.mean, found.logvar, *odds], dim=1).detach()
        return self.told(torch.cat([silu(feature), told], dim=1))

    def velocity(self, x: Tensor, t: Tensor, known: Tensor) -> Tensor:
        """Velocity (B, R) of rows x (B, R) at times t (B,) in [0, 1], 1 being noise."""
        angles = t[:, None] * 2.0 ** torch.arange(16, device=t.device) * 0.05
        condition = silu(known + self.time(torch.cat([angles.sin(), angles.cos()], dim=1)))
        h = self.into(x)
        for block in self.blocks:
            h = block(h, condition)
        return self.out(silu(h))

    def rows(self, numbers: Tensor, choices: Tensor) -> Tensor:
        """Rows (B, R) of numbers (B, N) and indices of choices (B, M)."""
        plain = (numbers - self.centre) / self.spread
        hot = [
            2.0 * nn.functional.one_hot(choices[:, index], count) - 1.0
            for index, count in enumerate(self.config.choices)
        ]
        return torch.cat([plain, *hot], dim=1).float()

    def apart(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Numbers (B, N) and indices of choices (B, M) of rows (B, R)."""
        plain, *hot = rows.split([self.config.numbers, *self.config.choices], dim=1)
        return self.natural(plain), torch.stack([one.argmax(dim=1) for one in hot], dim=1)

    def natural(self, numbers: Tensor) -> Tensor:
        """Standardised numbers (B, N) in their own units."""
        return numbers * self.spread + self.centre

    def loss(
        self,
        feature: Tensor,
        numbers: Tensor,
        choices: Tensor,
        generator: torch.Generator,
        repeats: int = 4,
        dropout: float = 0.0,
    ) -> ParametricLoss:
        """Losses of a batch: Gaussian likelihood, cross-entropy, and flow matching.

        The likelihood of a number is weighed by its standard deviation (beta-NLL, Seitzer et al.
        2022), or what is hard to see would not be learned. The flow gets `repeats` noises for each
        photograph, since they cost less than its encoding. `dropout` is the share of the feature
        that is left out.
        """
        kept = torch.rand(feature.shape, generator=generator) >= dropout
        feature = feature * kept / (1 - dropout)
        found, rows = self.regress(feature), self.rows(numbers, choices)
        error = (found.mean - rows[:, : self.config.numbers]).square()
        weight = (0.5 * found.logvar).exp().detach()
        likelihood = (error * (-found.logvar).exp() + found.logvar) * weight
        entropy = [
            cross_entropy(logits, choices[:, index]) for index, logits in enumerate(found.logits)
        ]
        known = self.known(feature, found).repeat(repeats, 1)
        target = rows.repeat(repeats, 1)
        noise = torch.randn(target.shape, generator=generator)
        t = torch.rand(len(target), generator=generator)
        matching = FlowMatching()
        moved = matching.interpolate(target, noise, t)
        wrong = (self.velocity(moved, t, known) - matching.target(target, noise)).square()
        return ParametricLoss(
            likelihood.mean(),
            torch.stack(entropy).mean(),
            wrong.mean(dim=1).view(repeats, -1).mean(dim=0),
        )

    @torch.no_grad()
    def sample(self, known: Tensor, generator: torch.Generator, steps: int = 24) -> Tensor:
        """Rows (B, R) that the flow draws for what it is told (B, 128), by Heun's method."""
        x = torch.randn(len(known), self.config.row, generator=generator)
        times = torch.linspace(1, 0, steps + 1)
        for t, after in itertools.pairwise(times):
            slope = self.velocity(x, t.expand(len(x)), known)
            ahead = x - (t - after) * slope
            if after > 0:
                slope = 0.5 * (slope + self.velocity(ahead, after.expand(len(x)), known))
            x = x - (t - after) * slope
        return x


class _Residual(nn.Module):
    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.inner = nn.Sequential(nn.Linear(width, hidden), nn.SiLU(), nn.Linear(hidden, width))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.inner(self.norm(x))


class _Modulated(nn.Module):
    """A residual block whose norm is scaled and shifted, and its result scaled (adaLN-zero)."""

    def __init__(self, width: int, hidden: int, told: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.inner = nn.Sequential(nn.Linear(width, hidden), nn.SiLU(), nn.Linear(hidden, width))
        self.modulation = nn.Linear(told, 3 * width)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        shift, scale, gate = self.modulation(condition).chunk(3, dim=1)
        return x + gate * self.inner(self.norm(x) * (1 + scale) + shift)
