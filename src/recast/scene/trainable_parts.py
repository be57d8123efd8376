"""What is trained beside the Gaussians: the sky, exposures of images, deformable actors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from recast.geometry import PinholeCamera
from recast.logs import Track
from recast.scene.config import SceneConfig
from recast.scene.deformation import Deformation, DeformationNetwork, layer_shapes
from recast.scene.dynamic import deforms
from recast.scene.poses import AdamTable
from recast.scene.schedule import DEFORMATION, deformation_rate, generator
from recast.scene.sky import (
    OPAQUE,
    SkyMap,
    composite,
    pixel_coordinates,
    sample_cubemap,
    sky_from_cubemap,
    texel_directions,
)
from recast.scene.street_scene import SceneActor, StreetScene
from recast.scene.views import View
from recast.splats import Gaussians
from recast.splats.sh import C0


class TrainableSky(Protocol):
    """What the trainer asks of a sky.

    Attributes:
        table: its colours, one row a cell.
    """

    table: AdamTable

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """rgb + (1 - alpha) sky, (H, W, 3); pixels above `sky.OPAQUE` are left alone."""
        ...

    def sky_map(self) -> SkyMap:
        """The sky as it stands, copied to the CPU."""
        ...


def make_sky(config: SceneConfig, start: SkyMap) -> TrainableSky:
    """The sky that the configuration asks for, with the colours of `start`."""
    return CubeSky(start, config.sky_face_px) if config.sky == "cubemap" else PanoramaSky(start)


class PanoramaSky:
    """An equirectangular map: few cells, and what is learned is what is saved."""

    def __init__(self, start: SkyMap) -> None:
        self._shape = start.colours.shape
        self.table = AdamTable(start.colours.reshape(-1, 3))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """See `TrainableSky`."""
        coordinates = pixel_coordinates(camera, camera_from_world)
        return composite(rgb, alpha, self.table.value.view(self._shape), coordinates)

    def sky_map(self) -> SkyMap:
        """See `TrainableSky`."""
        return SkyMap(self.table.value.detach().view(self._shape).to("cpu", copy=True))


class CubeSky:
    """A cubemap in world axes, as both published trainers learn it (Street Gaussians, OmniRe).

    It is resampled for `sky_map`: the folder of a scene holds one kind of sky.
    """

    def __init__(self, start: SkyMap, face_px: int) -> None:
        self._shape = (6, face_px, face_px, 3)
        self.table = AdamTable(start(texel_directions(face_px).reshape(-1, 3)))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """See `TrainableSky`.

        Raises:
            ValueError: the camera has distortion.
        """
        flat = alpha.reshape(-1)
        shown = (flat.detach() < OPAQUE).nonzero()[:, 0]
        directions = _world_directions(camera, camera_from_world, shown)
        sky = sample_cubemap(self.table.value.view(self._shape), directions)
        through = 1 - flat.index_select(0, shown)
        return rgb.reshape(-1, 3).index_add(0, shown, through[:, None] * sky).view_as(rgb)

    def sky_map(self) -> SkyMap:
        """See `TrainableSky`."""
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


class Exposures:
    """A transform [I | 0] + residual (3, 4) of the composited colours for each training view.

    Blending is linear: with alpha the sum of the weights, A (sum w c + (1 - alpha) sky) + b equals
    sum w (A c + b) + (1 - alpha) (A sky + b). So the mean transform, which views that nobody
    trained on get, can be written into a scene's colours. It holds while no Gaussian's colour is
    clamped.

    Attributes:
        table: (V, 12) the residuals.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self._rows = {(view.camera_name, view.frame): row for row, view in enumerate(views)}
        self.table = AdamTable(torch.zeros(len(views), 12))

    def applied(self, image: Tensor, view: View) -> tuple[Tensor, Tensor]:
        """The image (H, W, 3) as the view's camera exposed it, and the mean size of the residual.

        Both are differentiable, the second is what a regulariser weighs.
        """
        residual = self.table.value[self._rows[view.camera_name, view.frame]].to(image.device)
        return exposed_colours(image, _affine(residual)), residual.abs().mean()

    def mean(self) -> Tensor:
        """The transform (3, 4) of views that were not trained on."""
        return _affine(self.table.value.detach().mean(dim=0))


def exposed_colours(colours: Tensor, affine: Tensor) -> Tensor:
    """Colours (..., 3) after the transform (3, 4)."""
    return colours @ affine[:, :3].T + affine[:, 3]


def exposed(gaussians: Gaussians, affine: Tensor) -> Gaussians:
    """The Gaussians with the colours' transform (3, 4) in their harmonics."""
    sh = gaussians.sh @ affine[:, :3].T
    # A colour is 0.5 + C0 constant + ...: what A makes of the half goes to the constant as well.
    shift = exposed_colours(torch.full((3,), 0.5), affine) - 0.5
    constant = sh[:, :1] + shift / C0
    return replace(gaussians, sh=torch.cat([constant, sh[:, 1:]], dim=1))


def exposed_scene(scene: StreetScene, affine: Tensor) -> StreetScene:
    """The scene with the colours' transform (3, 4) in all its parts; the sky stays in [0, 1]."""
    return replace(
        scene,
        background=exposed(scene.background, affine),
        actors={name: _exposed_actor(actor, affine) for name, actor in scene.actors.items()},
        sky=SkyMap(exposed_colours(scene.sky.colours, affine).clamp(0, 1)),
    )


def _exposed_actor(actor: SceneActor, affine: Tensor) -> SceneActor:
    appearance = actor.appearance
    if appearance is not None:
        appearance = replace(appearance, waves=appearance.waves @ affine[:, :3].T)
    return replace(actor, gaussians=exposed(actor.gaussians, affine), appearance=appearance)


def _affine(residual: Tensor) -> Tensor:
    return torch.eye(3, 4).to(residual) + residual.view(3, 4)


class DeformableNodes:
    """The network and the codes of the actors that deform.

    Weights start as torch's linear layers do, the outputs at zero: all actors start rigid.

    Args:
        tracks: actors that may deform; those that do are taken, see
            `recast.scene.dynamic.deforms`.
    """

    def __init__(
        self, config: SceneConfig, tracks: Mapping[str, Track], device: torch.device | str
    ) -> None:
        self._config = config
        self._tracks = {key: track for key, track in tracks.items() if deforms(track, config)}
        self._names = tuple(self._tracks)
        self._tables: dict[str, AdamTable] = {}
        if not self._names:
            return
        chance = generator(config.seed, 0, DEFORMATION)
        shapes = layer_shapes(
            config.deformation_layers,
            config.deformation_width,
            config.deformation_bands,
            config.deformation_time_bands,
            config.deformation_code,
        )
        for number, (rows, columns) in enumerate(shapes):
            bound = (columns - 1) ** -0.5
            first = (2 * torch.rand(rows, columns, generator=chance) - 1) * bound
            last = number == len(shapes) - 1
            self._tables[f"deformation_{number}"] = AdamTable(0 * first if last else first)
        codes = torch.randn(len(self._names), config.deformation_code, generator=chance)
        self._tables["deformation_codes"] = AdamTable(codes)
        for table in self._tables.values():
            table.to(device)

    def __contains__(self, track_id: str) -> bool:
        return track_id in self._tracks

    def tables(self) -> dict[str, AdamTable]:
        """What is learned, by name; empty if nothing deforms."""
        return dict(self._tables)

    def deformation(self, track_id: str) -> Deformation:
        """The actor's deformation, with the graph back to the network and its code."""
        *layers, codes = (table.value for table in self._tables.values())
        config = self._config
        network = DeformationNetwork(
            tuple(layers), config.deformation_bands, config.deformation_time_bands
        )
        reach = float(self._tracks[track_id].size.max()) / 2
        return Deformation(network, codes[self._names.index(track_id)], reach)

    def begun(self, u: float) -> bool:
        """Whether actors deform at a share of the run; before, they are trained as rigid."""
        return u >= self._config.deformation_from

    def step(self, u: float) -> None:
        """Adam on the network, and on the codes of the actors that were drawn."""
        for table in self._tables.values():
            table.step(deformation_rate(self._config, u))

    def learned(self) -> dict[str, Deformation]:
        """Copies on the CPU by track id; they share one network."""
        found = {name: self.deformation(name) for name in self._names}
        if not found:
            return {}
        first = next(iter(found.values())).network
        layers = tuple(layer.detach().to("cpu", copy=True) for layer in first.layers)
        network = DeformationNetwork(layers, first.bands, first.time_bands)
        return {
            name: Deformation(network, own.code.detach().to("cpu", copy=True), own.reach)
            for name, own in found.items()
        }
