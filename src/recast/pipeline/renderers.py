"""What renders the arms: one sensor renderer for each arm and planner."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack

from recast.actors import Actor
from recast.actors.coverage import CoverageMeter
from recast.pipeline.arms import Arm
from recast.planning import CameraMount
from recast.scene import StreetScene
from recast.simulation import SensorRenderer
from recast.simulation.lens_renderer import through_lenses
from recast.simulation.oracle_renderer import OracleRenderer
from recast.simulation.scene_renderer import SceneRenderer
from recast.synthetic import World

StreetOf = Callable[[Arm, tuple[str, ...]], StreetScene]
"""Gives the street of an arm with the vehicles of these tracks replaced, if the arm does that."""


class Renderers:
    """Renderers, made when first asked for and kept; close it, as some hold processes.

    Args:
        street_of: see `StreetOf`.
        actor_of: gives the vehicle that an arm puts in the place of a track.
        world_of: gives the world of a synthetic log.
        oracle_workers: processes of an oracle, see `OracleRenderer`.
    """

    def __init__(
        self,
        street_of: StreetOf,
        actor_of: Callable[[Arm, str], Actor],
        world_of: Callable[[], World],
        oracle_workers: int = 0,
    ) -> None:
        self._street_of, self._actor_of, self._world_of = street_of, actor_of, world_of
        self._oracle_workers = oracle_workers
        self._open = ExitStack()
        self._streets: dict[tuple[str, tuple[str, ...]], StreetScene] = {}
        self._made: dict[tuple[str, tuple[str, ...], str], SensorRenderer] = {}
        self._meters: dict[tuple[str, tuple[str, ...]], CoverageMeter | None] = {}

    def street(self, arm: Arm, tracks: tuple[str, ...]) -> StreetScene:
        """The street of an arm; `tracks` are replaced where it replaces any."""
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
            tracks: whose vehicles are replaced where the arm does that, the target first.
            planner: whose cameras are among `mounts`.
            mounts: cameras to render.

        Raises:
            InputError: the street has no such actor, or the log is not synthetic.
        """
        key = arm.name, tracks, planner
        if key not in self._made:
            self._made[key] = self._make(arm, tracks, mounts)
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
        if not arm.is_truth:
            street = self.street(arm, tracks)
            return through_lenses(mounts, lambda pinholes: SceneRenderer(street, pinholes))
        world, keep = self._world_of(), self._open.enter_context
        return through_lenses(
            mounts, lambda pinholes: keep(OracleRenderer(world, pinholes, self._oracle_workers))
        )

    def close(self) -> None:
        """End the oracle's processes."""
        self._open.close()
