"""What renders the street: one sensor renderer for each method that is compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from recast.actors import insert, load_actor
from recast.logs import DrivingLog
from recast.pipeline.layout import ACTOR_FOLDER, SCENE_FOLDER, Method
from recast.planning import CameraMount
from recast.scene import StreetScene, load_scene
from recast.simulation import SensorRenderer
from recast.simulation.oracle_renderer import OracleRenderer
from recast.simulation.scene_renderer import SceneRenderer
from recast.synthetic import world_of


@contextmanager
def method_renderer(
    method: Method, run: Path, log: DrivingLog, mounts: Mapping[str, CameraMount]
) -> Iterator[SensorRenderer]:
    """The renderer of a method, from what the run made before.

    Raises:
        InputError: the scene or actor folder is broken; "oracle" of a log that is not synthetic.
    """
    if method == "oracle":
        with OracleRenderer(world_of(log), mounts) as oracle:
            yield oracle
    else:
        yield SceneRenderer(method_scene(method, run), mounts)


def method_scene(method: Method, run: Path) -> StreetScene:
    """The reconstructed street, with its own model of the target or with the generated one."""
    scene = load_scene(run / SCENE_FOLDER)
    if method == "replaced":
        scene = insert(scene, load_actor(run / ACTOR_FOLDER))
    return scene
