"""Deformable nodes: actors whose Gaussians move within their box (OmniRe; Yang et al. 2024).

A canonical set of Gaussians, and one network for all deformable actors of a scene that says how far
each Gaussian is from its canonical place at a time, and how it is turned. Deformable 3D Gaussians
(Yang et al. 2024, section 3.2): multilayer perceptron of encoded position and time; OmniRe (Chen et
al. 2025, section 4.2): in the box frame, with a code for each actor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from recast.logs import Track, Trajectory
from recast.scene.config import MOST_BANDS, MOST_CODE, MOST_LAYERS, MOST_WIDTH, SceneConfig
from recast.scene.dynamic import deforms
from recast.scene.poses import AdamTable
from recast.scene.schedule import DEFORMATION, deformation_rate, generator
from recast.splats import Gaussians
from recast.splats.gaussians import LARGEST

OUTPUTS = 7
"""Metres along x, y and z, and what is added to the quaternion."""
TIME_UNIT_US = 20_000_000
"""Microseconds after the first label that are 1 for the network: the length of Waymo's segments, of
which OmniRe's time is a share, so that its octaves are the same frequencies."""


@dataclass(frozen=True)
class DeformationNetwork:
    """Offsets of Gaussians by their canonical place, a time and a code.

    Attributes:
        layers: weights (out, in + 1), the last column being the bias: hidden layers with ReLU, all
            of one width, then the outputs. The inputs are joined to what enters the layer after the
            one in the middle (the sixth of eight), if that is a hidden one.
        bands: octaves of sines and cosines of each coordinate.
        time_bands: octaves of the time.
    """

    layers: Sequence[Tensor]
    bands: int
    time_bands: int

    @property
    def code_size(self) -> int:
        """Length of an actor's code."""
        return int(self.layers[0].shape[1]) - 1 - encoded_size(self.bands, self.time_bands)

    def __call__(self, places: Tensor, time: float, code: Tensor) -> Tensor:
        """Offsets (N, 7) at places (N, 3), in units of the box, and a time in `TIME_UNIT_US`."""
        octaves = encoded(places.new_full((1, 1), time), self.time_bands)
        context = torch.cat([octaves, code.to(places)[None]], dim=1).expand(len(places), -1)
        inputs = torch.cat([encoded(places, self.bands), context], dim=1)
        hidden, joined = inputs, joining_layer(len(self.layers) - 1)
        for number, layer in enumerate(self.layers[:-1]):
            if number == joined:
                hidden = torch.cat([inputs, hidden], dim=1)
            hidden = functional.relu(_linear(hidden, layer))
        return _linear(hidden, self.layers[-1])

    def to(self, device: torch.device | str) -> DeformationNetwork:
        """The same network elsewhere."""
        return replace(self, layers=tuple(layer.to(device) for layer in self.layers))

    def fault(self) -> str | None:
        """What is wrong with the layers' shapes or values, or None."""
        count = len(self.layers)
        if not 2 <= count <= MOST_LAYERS + 1:
            return f"{count} layers, 2 to {MOST_LAYERS + 1} are possible"
        if not (0 <= self.bands <= MOST_BANDS and 0 <= self.time_bands <= MOST_BANDS):
            return f"{self.bands} and {self.time_bands} bands, at most {MOST_BANDS} are possible"
        if any(layer.ndim != 2 or layer.dtype != torch.float32 for layer in self.layers):
            return "a layer is not a float32 matrix"
        width, code = int(self.layers[0].shape[0]), self.code_size
        if not (1 <= width <= MOST_WIDTH and 1 <= code <= MOST_CODE):
            return f"a width of {width} and a code of {code}"
        shapes = layer_shapes(count - 1, width, self.bands, self.time_bands, code)
        for number, (layer, shape) in enumerate(zip(self.layers, shapes, strict=True)):
            if tuple(layer.shape) != shape:
                return f"layer {number}: expected {shape}, got {tuple(layer.shape)}"
            if not bool((layer.abs() < LARGEST).all()):  # also NaN
                return f"layer {number}: a value is not finite, or out of range"
        return None


@dataclass(frozen=True)
class Deformation:
    """How the Gaussians of one actor move over its time.

    Attributes:
        network: network of all deformable actors of the scene.
        code: (E,) float32 code of this actor.
        reach: metres that are one unit of the network's places.
    """

    network: DeformationNetwork
    code: Tensor
    reach: float

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where`."""
        del count
        fault = self.network.fault()
        if fault is not None:
            raise ValueError(f"{where}.network: {fault}")
        if tuple(self.code.shape) != (self.network.code_size,):
            expected = f"expected ({self.network.code_size},)"
            raise ValueError(f"{where}.code: {expected}, got {tuple(self.code.shape)}")
        if not bool((self.code.abs() < LARGEST).all()):
            raise ValueError(f"{where}.code: a value is not finite, or out of range")
        if not 1e-3 <= self.reach <= 1e3:  # also NaN
            raise ValueError(f"{where}.reach: {self.reach} is not 0.001 to 1000 m")

    def at(self, gaussians: Gaussians, trajectory: Trajectory, timestamp_us: int) -> Gaussians:
        """The Gaussians as they are at a time; before the first and after the last label, as then.

        Differentiable. The network sees where Gaussians are and does not move them by that
        (Deformable 3DGS).
        """
        first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
        time = (min(max(timestamp_us, first), last) - first) / TIME_UNIT_US
        places = gaussians.means.detach() / self.reach
        change = self.network(places, time, self.code)
        return replace(
            gaussians,
            means=gaussians.means + change[:, :3],
            quats=gaussians.quats + change[:, 3:],
        )


def encoded(values: Tensor, bands: int) -> Tensor:
    """(N, D (1 + 2 bands)): values (N, D), then sines and cosines of 1, 2, 4, ... times them.

    Mildenhall et al. 2020, section 5.1, without pi, as Deformable 3DGS encodes.
    """
    powers = [2.0**k for k in range(bands)]
    octaves = [wave(values * power) for power in powers for wave in (torch.sin, torch.cos)]
    return torch.cat([values, *octaves], dim=1)


def encoded_size(bands: int, time_bands: int) -> int:
    """Number of inputs that a place and a time make."""
    return 3 * (1 + 2 * bands) + 1 + 2 * time_bands


def joining_layer(hidden: int) -> int | None:
    """Number of the hidden layer that gets the inputs once more, of so many; None for none."""
    number = hidden // 2 + 1
    return number if number < hidden else None


def layer_shapes(
    hidden: int, width: int, bands: int, time_bands: int, code: int
) -> list[tuple[int, int]]:
    """Shapes of the hidden layers and of the outputs."""
    inputs, joined = encoded_size(bands, time_bands) + code, joining_layer(hidden)
    entering = [inputs if k == 0 else width + inputs * (k == joined) for k in range(hidden)]
    return [(width, size + 1) for size in entering] + [(OUTPUTS, width + 1)]


def _linear(values: Tensor, layer: Tensor) -> Tensor:
    return functional.linear(values, layer[:, :-1], layer[:, -1])


class DeformableNodes:
    """The network and the codes of the actors that deform.

    Weights start as torch's linear layers do, the outputs at zero: all actors start rigid.

    Args:
        tracks: actors that may deform; those that do are taken, see `deforms`.
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
        rng = generator(config.seed, 0, DEFORMATION)
        shapes = layer_shapes(
            config.deformation_layers,
            config.deformation_width,
            config.deformation_bands,
            config.deformation_time_bands,
            config.deformation_code,
        )
        for number, (rows, columns) in enumerate(shapes):
            bound = (columns - 1) ** -0.5
            first = (2 * torch.rand(rows, columns, generator=rng) - 1) * bound
            last = number == len(shapes) - 1
            self._tables[f"deformation_{number}"] = AdamTable(0 * first if last else first)
        codes = torch.randn(len(self._names), config.deformation_code, generator=rng)
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
