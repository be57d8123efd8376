"""Deformable nodes under training: one network and a code for each actor."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from recast.logs import Track
from recast.scene.adam_table import AdamTable
from recast.scene.chance import DEFORMATION, generator
from recast.scene.config import SceneConfig
from recast.scene.deformation import Deformation, DeformationNetwork, layer_shapes
from recast.scene.dynamic import deforms
from recast.scene.schedule import deformation_rate


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
