"""Gaussians, scenes, actors, and the trained scenes of others."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fuzz.target import Target
from recast.actors import (
    Actor,
    BoxLidarSegmenter,
    TemplateGenerator,
    load_actor,
    observe,
    register,
    save_actor,
)
from recast.actors.mesh_generator import files_of_mesh, read_triangles, sampled
from recast.core.files import write_json
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig, read_config
from recast.scene import SceneActor, SkyMap, StreetScene, load_scene, save_scene
from recast.scene.exchange import import_gaussians
from recast.splats import read_ply, write_ply
from recast.splats.formats import formats
from recast.synthetic.vehicles.shapes import read_mesh
from recast_bridges.scenes import (
    hugsim_log,
    import_drivestudio,
    import_hugsim,
    import_mtgs,
    import_street_gaussians,
    mtgs_log,
)
from recast_bridges.splats.spz import read_spz, write_spz
from support import (
    drivestudio_scenes,
    hugsim_scenes,
    mtgs_scenes,
    odyssey_scenes,
    street_gaussians_scenes,
    trained_scenes,
)
from support import made_up_actors as made_up
from support import mesh_files as made


@cache
def _log() -> DrivingLog:
    return trained_scenes.make_log()


@cache
def _scene() -> StreetScene:
    log, car = _log(), trained_scenes.make_car(1)
    shadow = replace(car.select(torch.arange(9)), sh=torch.zeros(9, 1, 3))
    trajectory = log.tracks[trained_scenes.CAR].trajectory
    actors = {"car/1": SceneActor("car/1", car, np.array([4.2, 1.8, 1.6]), trajectory, shadow)}
    return StreetScene(trained_scenes.make_background(1), actors, SkyMap(torch.rand(8, 32, 3)))


@cache
def _actor() -> Actor:
    street = made_up.street_log(made_up.car())
    observation = observe(street, "7", segmenter=BoxLidarSegmenter())
    asset = TemplateGenerator(spacing=0.3).generate(observation, seed=0)
    return register(asset, observation, street, street.tracks["7"])


@cache
def _far_log() -> DrivingLog:
    offset = odyssey_scenes.ANCHOR - mtgs_scenes.RECON_FROM_OFFSET
    return replace(_log(), world_offset=offset)


def _write_config(folder: Path) -> None:
    write_json(folder / "config.json", SceneConfig().model_dump(mode="json"))


def _write_mesh(folder: Path) -> None:
    corners = [
        f"v {4 * x - 2} {2 * y - 1} {1.5 * z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)
    ]
    faces = ["f 1 2 4", "f 1 4 3", "f 5 7 8", "f 5 8 6", "f 1 5 6", "f 1 6 2", "f 3 4 8", "f 3 8 7"]
    faces += ["f 1 3 7", "f 1 7 5", "f 2 6 8", "f 2 8 4"]
    (folder / "car.obj").write_text("\n".join(corners + faces) + "\n")


def _write_glb(folder: Path) -> None:
    car = made.car()
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    one = car.primitive(made.SQUARE, made.HALVES, material=3)
    one["attributes"]["TEXCOORD_0"] = car.array(square)
    one["attributes"]["COLOR_0"] = car.array(np.full((4, 4), 200, np.uint8), normalized=True)
    car.tree["images"] = [{"bufferView": car.view(made.picture(pixels))}, {"uri": "paint.png"}]
    car.tree["textures"] = [{"source": 0}, {"source": 1}]
    for index in (0, 1):
        use = {"index": index, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}
        car.tree["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": use}})
    other = {**one, "material": 4}
    car.tree["meshes"][0]["primitives"].append(other)
    car.tree["nodes"] = [{"children": [1], "rotation": [0, 0, 0, 1]}, {"mesh": 0}]
    car.write(folder / "car.glb")
    (folder / "paint.png").write_bytes(made.picture(pixels))


def _write_obj(folder: Path) -> None:
    _write_mesh(folder)
    text = (folder / "car.obj").read_text().replace("f 1 2 4", "f 1/1 2/2 4/3")
    uv = "vt 0 0\nvt 1 0\nvt 1 1\n"
    (folder / "car.obj").write_text(f"mtllib car.mtl\n{uv}usemtl paint\n{text}")
    library = "newmtl glass\nKd 0 0 0\nd 0.3\nnewmtl paint\nKd 1 0.5 0\nNs 200\nmap_Kd paint.png\n"
    (folder / "car.mtl").write_text(library)
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)
    (folder / "paint.png").write_bytes(made.picture(pixels))


def _read_triangles(path: Path) -> object:
    """The file's triangles, and coarse points of them."""
    parts = read_triangles(path)
    return parts, sampled(parts, 4.0, 0.1), files_of_mesh(path)


def _write_street_gaussians(folder: Path) -> None:
    torch.save(street_gaussians_scenes.checkpoint(), folder / "iteration.pth")
    trained_scenes.write_street_gaussians_folder(folder / "processed", street_gaussians_scenes.ROWS)


def _import_street_gaussians(folder: Path, out: Path) -> object:
    return import_street_gaussians(
        folder / "iteration.pth", _log(), out, processed=folder / "processed"
    )


def _splats(name: str) -> Target:
    one, car = formats()[name], trained_scenes.make_car(1)
    file = f"car{one.suffix}"
    return Target(
        f"splats-{name}",
        lambda f: one.write(f / file, car, None),
        lambda f, out: one.read(f / file),
        weight=4.0,
    )


def _tensors(node: Any) -> Any:
    """The tree with tensors for arrays: a mutator of checkpoints reads tensors alone."""
    if isinstance(node, dict):
        return {key: _tensors(inner) for key, inner in node.items()}
    return torch.from_numpy(node) if isinstance(node, np.ndarray) else node


def _write_mtgs(folder: Path) -> None:
    content = mtgs_scenes.checkpoint()
    mtgs_scenes.save(folder, _tensors(content), mtgs_scenes.frames())


def _write_odyssey(folder: Path) -> None:
    (folder / "street").mkdir()
    torch.save(_tensors(odyssey_scenes.odyssey()), folder / "street" / "scene.ckpt")


def _write_mtgs_log(folder: Path) -> None:
    turn = se3.matrix_to_quat(trained_scenes.RIG_FROM_CAMERA[:3, :3])
    mtgs_scenes.save_whole(folder, sensor2ego_rotation=turn)


TARGETS = (
    Target(
        "ply",
        lambda f: write_ply(f / "car.ply", trained_scenes.make_car(1)),
        lambda f, out: read_ply(f / "car.ply"),
        weight=12.0,
    ),
    *(_splats(name) for name in formats() if name != "ply"),
    Target(
        "spz-3",
        lambda f: write_spz(f / "car.spz", trained_scenes.make_car(1), version=3),
        lambda f, out: read_spz(f / "car.spz"),
        weight=4.0,
    ),
    Target(
        "scene",
        lambda f: save_scene(_scene(), f / "scene"),
        lambda f, out: load_scene(f / "scene"),
        weight=6.0,
    ),
    Target(
        "scene-record",
        lambda f: save_scene(_scene(), f / "scene"),
        lambda f, out: load_scene(f / "scene"),
        files=("*.json",),
        weight=4.0,
    ),
    Target(
        "actor",
        lambda f: save_actor(_actor(), f / "actor"),
        lambda f, out: load_actor(f / "actor"),
        weight=6.0,
    ),
    Target(
        "actor-record",
        lambda f: save_actor(_actor(), f / "actor"),
        lambda f, out: load_actor(f / "actor"),
        files=("*.json",),
        weight=4.0,
    ),
    Target(
        "scene-config", _write_config, lambda f, out: read_config(f / "config.json"), weight=8.0
    ),
    Target("mesh", _write_mesh, lambda f, out: read_mesh(f / "car.obj", forward="x"), weight=4.0),
    Target(
        "glb",
        _write_glb,
        lambda f, out: _read_triangles(f / "car.glb"),
        files=("*.glb",),
        weight=5.0,
    ),
    Target("obj", _write_obj, lambda f, out: _read_triangles(f / "car.obj"), weight=4.0),
    Target(
        "ply-scene",
        lambda f: write_ply(f / "scene.ply", trained_scenes.make_background(1)),
        lambda f, out: import_gaussians(f / "scene.ply", _log(), out),
        weight=2.0,
    ),
    Target(
        "street-gaussians-checkpoint", _write_street_gaussians, _import_street_gaussians, weight=2.0
    ),
    Target(
        "drivestudio-checkpoint",
        lambda f: torch.save(drivestudio_scenes.checkpoint(), f / "checkpoint_final.pth"),
        lambda f, out: import_drivestudio(f / "checkpoint_final.pth", _log(), out, first_frame=2),
        weight=2.0,
    ),
    Target(
        "mtgs-checkpoint",
        _write_mtgs,
        lambda f, out: import_mtgs(f / mtgs_scenes.NAME, _log(), out),
        files=("*.ckpt",),
        weight=2.0,
    ),
    Target(
        "odyssey",
        _write_odyssey,
        lambda f, out: import_mtgs(f / "street", _far_log(), out),
        weight=2.0,
    ),
    Target(
        "mtgs-frames",
        _write_mtgs,
        lambda f, out: import_mtgs(f / mtgs_scenes.NAME, _log(), out),
        files=("*.pkl",),
        weight=2.0,
    ),
    Target(
        "hugsim",
        lambda f: hugsim_scenes.write(f / "street"),
        lambda f, out: import_hugsim(f / "street", hugsim_scenes.make_log(), out, first_frame=1),
        weight=4.0,
    ),
    Target(
        "mtgs-log",
        _write_mtgs_log,
        lambda f, out: mtgs_log(f / mtgs_scenes.NAME),
        files=("*.pkl",),
        weight=2.0,
    ),
    Target(
        "hugsim-log",
        lambda f: hugsim_scenes.write(f / "street"),
        lambda f, out: hugsim_log(f / "street"),
        files=("*.json", "*ground_param.pkl", "*unicycle*.pth"),
        weight=2.0,
    ),
)
