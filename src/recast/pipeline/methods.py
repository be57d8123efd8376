"""What renders the street: one sensor renderer for each method that is compared."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from recast.actors import insert, load_actor
from recast.actors.coverage import CoverageMeter
from recast.pipeline.layout import SCENE_FOLDER, Method, final_actor
from recast.planning import CameraMount
from recast.scene import StreetScene, load_scene
from recast.simulation import SensorRenderer
from recast.simulation.lens_renderer import through_lenses
from recast.simulation.oracle_renderer import OracleRenderer
from recast.simulation.scene_renderer import SceneRenderer
from recast.synthetic import World


class Renderers:
    """The renderers of a run, by method; a context manager, since the oracle's holds processes.

    Args:
        run: run folder with scene and actor.
        world: what the log was made from; None where it is not synthetic.
        mounts: cameras to render, see `camera_mounts`.
        oracle_workers: processes of the oracle, see `OracleRenderer`.
    """

    def __init__(
        self,
        run: Path,
        world: World | None,
        mounts: Mapping[str, CameraMount],
        oracle_workers: int = 0,
    ) -> None:
        self._run, self._world, self._mounts = run, world, mounts
        self._oracle_workers = oracle_workers
        self._open = ExitStack()
        self._made: dict[Method, SensorRenderer] = {}
        self._meters: dict[Method, CoverageMeter | None] = {}

    def of(self, method: Method) -> SensorRenderer:
        """The renderer of a method, made when first asked for and kept.

        Raises:
            InputError: the scene or actor folder is missing or broken.
            ValueError: "oracle" without a world.
        """
        if method not in self._made:
            self._made[method] = self._make(method)
        return self._made[method]

    def meter_of(self, method: Method) -> CoverageMeter | None:
        """What measures a method's vehicle in images; None for one without shares.

        Raises:
            InputError: the scene or actor folder is missing or broken.
        """
        if method not in self._meters:
            actor = load_actor(final_actor(self._run)) if method == "replaced" else None
            self._meters[method] = (
                None
                if actor is None or actor.shares is None
                else CoverageMeter(method_scene(method, self._run), actor.track_id, actor.shares)
            )
        return self._meters[method]

    def _make(self, method: Method) -> SensorRenderer:
        if method != "oracle":
            scene = method_scene(method, self._run)
            return through_lenses(self._mounts, lambda mounts: SceneRenderer(scene, mounts))
        world = self._world
        if world is None:
            raise ValueError("Renderers.of: the oracle needs the world")
        workers, keep = self._oracle_workers, self._open.enter_context
        return through_lenses(
            self._mounts, lambda mounts: keep(OracleRenderer(world, mounts, workers))
        )

    def __enter__(self) -> Self:
        """Nothing starts before it is asked for."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the oracle's processes."""
        self._open.close()


def method_scene(method: Method, run: Path) -> StreetScene:
    """The reconstructed street, with its own model of the target or with the generated one."""
    scene = load_scene(run / SCENE_FOLDER)
    if method == "replaced":
        scene = insert(scene, load_actor(final_actor(run)))
    return scene
