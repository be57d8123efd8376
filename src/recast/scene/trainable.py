"""What is trained of a scene: Gaussians laid out for speed, what a view sees of them, and the sky.

What the rasterizer reads is one buffer a field. The background's rows come first and *are* the
background's parameters, so that nothing is copied; behind them is room for the actors, which are
written anew for every view from their own parameters in the box frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from recast.cameras import PinholeCamera
from recast.scene.appearance import coloured, mirrored
from recast.scene.config import SceneConfig
from recast.scene.densify import GradientStatistics, Measure
from recast.scene.poses import AdamTable
from recast.scene.sky import (
    OPAQUE,
    SkyMap,
    pixel_coordinates,
    sample_cubemap,
    sky_from_cubemap,
    texel_directions,
)
from recast.scene.sky_composite import fused_composite
from recast.splats import Gaussians, RasterMeta, RowAdam, concatenate
from recast.splats.sh import C0

Shape = Callable[[Gaussians], Gaussians]

STATES = ("background_adam", "local_adam", "background_statistics", "local_statistics")
"""Members of `TrainableScene` that a checkpoint holds beside the parameters."""
FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")
MIN_LOG_SCALE = -4.8
"""8 mm. Smaller ones hide between the pixel centres of the training views and show elsewhere."""
MAX_ACTOR_LOG_SCALE = -1.2
"""30 cm. Larger ones would paint what lies outside an actor's box."""
COLOUR_LIMIT = 0.5 / C0
"""Keeps the constant colour in [0, 1]: below 0 the rasterizer's clamp kills the gradient."""
REST_RATE = 0.05
"""View-dependent colour learns this much slower than the constant band (3DGS)."""


@dataclass(frozen=True)
class Span:
    """Rows of one present actor: `[first, last)` as drawn, `[start, stop)` among all actors' rows.

    Attributes:
        posed: its Gaussians in the world, with the graph back to the parameters and the pose.
    """

    first: int
    last: int
    start: int
    stop: int
    posed: Gaussians


@dataclass(frozen=True)
class DrawnView:
    """What one view sees: leaf Gaussians for the rasterizer, and where the actors are in them."""

    gaussians: Gaussians
    spans: tuple[Span, ...]


class TrainableScene:
    """Background and actors with their optimiser states.

    Attributes:
        track_ids: the actors, in order.
        owner: (A,) int64, ascending, on the CPU: the actor of each row of `local`.
        background: world-frame parameters, views into the buffer.
        local: all actors' parameters, box frames, one after the other.
        fourier: (A, F - 1, 3) how the actors' colours change over their time, see
            `recast.scene.appearance`; F is 1 where they do not.
    """

    background: Gaussians
    local: Gaussians
    owner: Tensor
    fourier: Tensor

    def __init__(
        self, background: Gaussians, actors: Mapping[str, Gaussians], fourier_terms: int = 1
    ) -> None:
        self.track_ids = tuple(actors)
        nothing = background.select(torch.zeros(0, dtype=torch.int64))
        counts = torch.tensor([len(part) for part in actors.values()], dtype=torch.int64)
        owner = torch.repeat_interleave(torch.arange(len(actors)), counts)
        local = concatenate([nothing, *actors.values()])
        fourier = local.means.new_zeros(len(local), fourier_terms - 1, 3)
        self.place(background, local, owner, fourier)
        device = self.background.means.device
        self.background_statistics = GradientStatistics(len(self.background), device)
        self.local_statistics = GradientStatistics(len(self.local), device)
        self.background_adam = _adam(self.background, rows(self.background), math.inf)
        self.local_adam = _adam(self.local, self.local_parameters(), MAX_ACTOR_LOG_SCALE)

    def place(
        self, background: Gaussians, local: Gaussians, owner: Tensor, fourier: Tensor
    ) -> None:
        """Lay out new parameter values; optimiser states are the caller's business."""
        room = concatenate([background.detach(), local.detach()])
        self._buffer = Gaussians(**{name: value.contiguous() for name, value in rows(room).items()})
        n = len(background)
        self.background = Gaussians(**{k: v[:n] for k, v in rows(self._buffer).items()})
        self.local = Gaussians(
            **{k: v.clone().requires_grad_() for k, v in rows(local.detach()).items()}
        )
        self.fourier = fourier.detach().clone().requires_grad_()
        self.owner = owner

    def local_parameters(self) -> dict[str, Tensor]:
        """The actors' leaf tensors by name."""
        parameters = rows(self.local)
        return {**parameters, "waves": self.fourier} if self.fourier.shape[1] else parameters

    def span(self, track_id: str) -> tuple[int, int]:
        """Rows [start, stop) of an actor in `local`."""
        index = self.track_ids.index(track_id)
        start, stop = torch.searchsorted(self.owner, torch.tensor([index, index + 1])).tolist()
        return start, stop

    def draw(
        self,
        poses: Mapping[str, Tensor],
        shares: Mapping[str, float] | None = None,
        flipped: Tensor | None = None,
        shapes: Mapping[str, Shape] | None = None,
    ) -> DrawnView:
        """Put the actors at `world_from_actor` poses (4, 4) behind the background.

        Args:
            shares: shares of each actor's time, where colours change with it.
            flipped: (A,) bool, rows of actors to draw mirrored; see `recast.scene.appearance`.
            shapes: what moves the Gaussians of an actor within its box, differentiable.
        """
        first = len(self.background)
        spans = []
        # One split a field: slices of their own would each bring a gradient of all rows.
        counts = torch.bincount(self.owner, minlength=len(self.track_ids)).tolist()
        ends = dict(zip(self.track_ids, np.cumsum(counts).tolist(), strict=True))
        fields = zip(*(value.split(counts) for value in rows(self.local).values()), strict=True)
        parts = {name: Gaussians(*own) for name, own in zip(self.track_ids, fields, strict=True)}
        for track_id, pose in poses.items():
            own = parts[track_id]
            start, stop = ends[track_id] - len(own), ends[track_id]
            if shares is not None and self.fourier.shape[1]:
                own = coloured(own, self.fourier[start:stop], shares[track_id])
            if flipped is not None:
                own = mirrored(own, flipped[start:stop])
            if shapes is not None and track_id in shapes:
                own = shapes[track_id](own)
            posed = own.transformed(pose)
            last = first + stop - start
            for name in FIELDS:
                getattr(self._buffer, name)[first:last] = getattr(posed, name).detach()
            spans.append(Span(first, last, start, stop, posed))
            first = last
        leaves = {k: v[:first].requires_grad_() for k, v in rows(self._buffer).items()}
        return DrawnView(Gaussians(**leaves), tuple(spans))

    def take_gradients(self, drawn: DrawnView) -> None:
        """After the loss's backward pass: carry it on to the parameters and the actors' poses."""
        gradients = {k: v.grad for k, v in rows(drawn.gaussians).items()}
        n = len(self.background)
        for name in FIELDS:
            gradient = gradients[name]
            getattr(self.background, name).grad = None if gradient is None else gradient[:n]
            getattr(self.local, name).grad = None
        self.fourier.grad = None
        outputs, given = [], []
        for name, gradient in gradients.items():
            if gradient is not None:
                outputs += [getattr(span.posed, name) for span in drawn.spans]
                given += [gradient[span.first : span.last] for span in drawn.spans]
        torch.autograd.backward(outputs, given)

    def visible(self, drawn: DrawnView, meta: RasterMeta) -> tuple[Tensor, Tensor]:
        """Which rows of the background and of the actors the view saw: two bool masks."""
        local = torch.zeros(len(self.local), dtype=torch.bool, device=meta.visible.device)
        for span in drawn.spans:
            local[span.start : span.stop] = meta.visible[span.first : span.last]
        return meta.visible[: len(self.background)], local

    def count(
        self,
        drawn: DrawnView,
        meta: RasterMeta,
        width: int,
        height: int,
        measure: Measure = "signed",
        actor_measure: Measure = "signed",
    ) -> None:
        """Add a view's screen-space gradients to the statistics for density control."""
        every = slice(0, len(self.background))
        self.background_statistics.add(meta, every, every, width, height, measure)
        for span in drawn.spans:
            source, target = slice(span.first, span.last), slice(span.start, span.stop)
            self.local_statistics.add(meta, source, target, width, height, actor_measure)

    def step(self, background: Tensor, local: Tensor, rates: Mapping[str, float]) -> None:
        """Adam on the visible rows, within the bounds that keep Gaussians honest.

        Args:
            background, local: visible rows, as `visible` gives.
            rates: learning rate by field; `sh` is that of the constant band, over time as well.
        """
        self.background_adam.step(background, rates)
        if len(self.local):
            self.local_adam.step(local, {**rates, "waves": rates["sh"]})

    def count_rows(self) -> int:
        """Number of Gaussians, actors included."""
        return len(self.background) + len(self.local)

    def restore(self, states: Mapping[str, Mapping[str, Tensor]]) -> None:
        """After `place`: take over the `STATES` of a checkpoint."""
        self.background_adam.params = rows(self.background)
        self.local_adam.params = self.local_parameters()
        for name in STATES:
            getattr(self, name).load_state_dict(states[name])

    def actor(self, track_id: str) -> tuple[Gaussians, Tensor]:
        """Copies of an actor's Gaussians in its box frame, and of their `fourier`."""
        part = slice(*self.span(track_id))
        return copy(self.local, part), self.fourier.detach()[part].clone()


def copy(gaussians: Gaussians, part: slice = slice(None)) -> Gaussians:
    """Rows of their own, without history."""
    return Gaussians(**{k: v.detach()[part].clone() for k, v in rows(gaussians).items()})


def rows(gaussians: Gaussians) -> dict[str, Tensor]:
    """The fields by name."""
    return {name: getattr(gaussians, name) for name in FIELDS}


def _adam(gaussians: Gaussians, parameters: Mapping[str, Tensor], max_log_scale: float) -> RowAdam:
    bases = gaussians.sh.shape[1]
    rates = torch.full((bases, 3), REST_RATE)
    rates[0] = 1
    limit = torch.full((bases, 3), math.inf)
    limit[0] = COLOUR_LIMIT
    return RowAdam(
        parameters,
        {},
        column_rates={"sh": rates},
        bounds={"sh": (-limit, limit), "log_scales": (MIN_LOG_SCALE, max_log_scale)},
    )


class PanoramaSky:
    """An equirectangular map: few cells, and what is learned is what is saved.

    Attributes:
        table: its colours, one row a cell.
    """

    def __init__(self, start: SkyMap) -> None:
        self._shape = start.colours.shape
        self.table = AdamTable(start.colours.reshape(-1, 3))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """rgb + (1 - alpha) sky, (H, W, 3); pixels above `sky.OPAQUE` are left alone."""
        coordinates = pixel_coordinates(camera, camera_from_world)
        return fused_composite(rgb, alpha, self.table.value.view(self._shape), coordinates)

    def sky_map(self) -> SkyMap:
        """The sky as it stands, copied to the CPU."""
        return SkyMap(self.table.value.detach().view(self._shape).to("cpu", copy=True))


class CubeSky:
    """A cubemap in world axes, as both published trainers learn it (Street Gaussians, OmniRe).

    It is resampled for `sky_map`: the folder of a scene holds one kind of sky.

    Attributes:
        table: its colours, one row a cell.
    """

    def __init__(self, start: SkyMap, face_px: int) -> None:
        self._shape = (6, face_px, face_px, 3)
        self.table = AdamTable(start(texel_directions(face_px).reshape(-1, 3)))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """As `PanoramaSky.behind`; ValueError if the camera has distortion."""
        flat = alpha.reshape(-1)
        shown = (flat.detach() < OPAQUE).nonzero()[:, 0]
        directions = _world_directions(camera, camera_from_world, shown)
        sky = sample_cubemap(self.table.value.view(self._shape), directions)
        through = 1 - flat.index_select(0, shown)
        return rgb.reshape(-1, 3).index_add(0, shown, through[:, None] * sky).view_as(rgb)

    def sky_map(self) -> SkyMap:
        """The sky as it stands, resampled on the CPU."""
        return sky_from_cubemap(self.table.value.detach().cpu().view(self._shape), torch.eye(3))


def _world_directions(
    camera: PinholeCamera, camera_from_world: ArrayLike, pixels: Tensor
) -> Tensor:
    """Rays (M, 3) float32, depth 1, of flat pixel indices (M,) of a rectified camera."""
    if not camera.is_rectified:
        raise ValueError("the sky needs a rectified camera: use camera.rectified()")
    axes = torch.from_numpy(np.array(camera_from_world, np.float64)[:3, :3]).float()
    axes = axes.to(pixels.device)
    x = (pixels % camera.width + (0.5 - camera.cx)) / camera.fx
    y = (pixels // camera.width + (0.5 - camera.cy)) / camera.fy
    return x[:, None] * axes[0] + y[:, None] * axes[1] + axes[2]


def make_sky(config: SceneConfig, start: SkyMap) -> PanoramaSky | CubeSky:
    """The sky that the configuration asks for, with the colours of `start`."""
    return CubeSky(start, config.sky_face_px) if config.sky == "cubemap" else PanoramaSky(start)
