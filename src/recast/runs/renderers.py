"""The renderer of each arm: what draws its street and its vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from recast.actors import Actor
from recast.actors.coverage import CoverageMeter
from recast.cameras import CameraMount
from recast.runs.arms import Arm
from recast.scene import StreetScene
from recast.simulation import SensorRenderer
from recast.simulation.renderer import RestoringRenderer, make_restorer
from recast.simulation.scene_renderer import SceneRenderer, through_lenses

if TYPE_CHECKING:
    from recast.synthetic import World
    from recast.synthetic.oracle import OraclePool

StreetOf = Callable[[Arm, tuple[str, ...]], StreetScene]
"""Gives the street of an arm with the vehicles of these tracks replaced, if the arm does that."""


class Renderers:
    """Renderers, made when first asked for and kept; close it, as some hold processes.

    Args:
        actor_of: function that gives the vehicle that an arm puts in the place of a track.
        world_of: function that gives the world of a synthetic log.
        oracle_workers: processes of an oracle, see `OracleRenderer`.
        restorer: restorer of the images of arms that are `restorable`; None for no restorer.
    """

    def __init__(
        self,
        street_of: StreetOf,
        actor_of: Callable[[Arm, str], Actor],
        world_of: Callable[[], World],
        oracle_workers: int = 0,
        restorer: str | None = None,
    ) -> None:
        self._street_of, self._actor_of, self._world_of = street_of, actor_of, world_of
        self._oracle_workers, self._restorer = oracle_workers, restorer
        self._open = ExitStack()
        self._streets: dict[tuple[str, tuple[str, ...]], StreetScene] = {}
        self._made: dict[tuple[str, tuple[str, ...], str], SensorRenderer] = {}
        self._meters: dict[tuple[str, tuple[str, ...]], CoverageMeter | None] = {}

    def street(self, arm: Arm, tracks: tuple[str, ...]) -> StreetScene:
        """The reconstruction of an arm; `tracks` are replaced where it replaces any."""
        key = arm.name, tracks
        if key not in self._streets:
            self._streets[key] = self._street_of(arm, tracks)
        return self._streets[key]

    def of(
        self,
        arm: Arm,
        tracks: tuple[str, ...],
        planner: str,
        mounts: Mapping[str, CameraMount],
    ) -> SensorRenderer:
        """The renderer of an arm.

        Args:
            planner: name of the planner whose cameras are among `mounts`.
            tracks: tracks whose vehicles the arm exchanges or leaves out, the target first.

        Raises:
            InputError: the street has no such actor, or the log is not synthetic.
        """
        key = arm.name, tracks, planner
        if key not in self._made:
            if self._restores(arm) or arm.noise == "jitter":
                # What comes out for a pixel depends on others, beyond the window, too.
                mounts = {name: replace(mount, window=None) for name, mount in mounts.items()}
            made = through_lenses(mounts, lambda pinholes: self._make(arm, tracks, pinholes))
            self._made[key] = self._restored(arm, self._disturbed(arm, made))
        return self._made[key]

    def meter(self, arm: Arm, tracks: tuple[str, ...]) -> CoverageMeter | None:
        """What measures the coverage of an arm's target; None for a vehicle without shares."""
        if not arm.generates:
            return None
        key = arm.name, tracks
        if key not in self._meters:
            actor = self._actor_of(arm, tracks[0])
            self._meters[key] = (
                None
                if actor.shares is None
                else CoverageMeter(self.street(arm, tracks), actor.track_id, actor.shares)
            )
        return self._meters[key]

    def _make(
        self, arm: Arm, tracks: tuple[str, ...], mounts: Mapping[str, CameraMount]
    ) -> SensorRenderer:
        """The renderer of cameras without distortion."""
        absent = tracks if arm.vehicle == "none" else ()
        if not arm.needs_world:
            return SceneRenderer(self.street(arm, tracks), mounts, absent=absent)
        # With the synthetic world, which needs a ray tracer.
        from recast.simulation.oracle_renderer import (
            GeneratedVehicleRenderer,
            OracleRenderer,
            TrueVehicleRenderer,
        )

        world, pool = self._world_of(), self._oracles
        if arm.reconstructs:
            street = self.street(arm, tracks)
            return TrueVehicleRenderer(world, street, mounts, tracks=tracks, pool=pool)
        if arm.generates:
            street = self.street(arm, tracks)
            return GeneratedVehicleRenderer(world, street, mounts, tracks=tracks, pool=pool)
        seed = 1 if arm.noise == "seed" else 0
        return OracleRenderer(world, mounts, tracks=absent, noise=seed, pool=pool)

    @cached_property
    def _oracles(self) -> OraclePool:
        """Of all arms: processes that trace rays hold the whole world each."""
        from recast.synthetic.oracle import OraclePool

        return self._open.enter_context(OraclePool(self._world_of(), self._oracle_workers))

    def _disturbed(self, arm: Arm, renderer: SensorRenderer) -> SensorRenderer:
        if arm.noise not in ("grey", "jitter"):
            return renderer
        from recast.simulation.oracle_renderer import NoisyRenderer

        seed = self._world_of().seed if arm.needs_world else 0
        return NoisyRenderer(renderer, arm.noise, seed)

    def _restores(self, arm: Arm) -> bool:
        return self._restorer is not None and arm.restorable

    def _restored(self, arm: Arm, renderer: SensorRenderer) -> SensorRenderer:
        if self._restorer is None or not self._restores(arm):
            return renderer
        return RestoringRenderer(renderer, make_restorer(self._restorer))

    def close(self) -> None:
        """End the oracle's processes."""
        self._open.close()
