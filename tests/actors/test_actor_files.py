from __future__ import annotations

import json
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file, save_file

from recast.actors import (
    Actor,
    SplatGenerator,
    export_actor,
    load_actor,
    make_generator,
    save_actor,
)
from recast.actors.observation import Observation
from recast.core.errors import InputError
from recast.splats import CLASSIC, MIP, LowPass, write_ply
from recast.splats.formats import formats, read_gaussians


@pytest.mark.parametrize("low_pass", [CLASSIC, MIP])
def test_round_trip(actor: Actor, tmp_path: Path, low_pass: LowPass) -> None:
    save_actor(replace(actor, low_pass=low_pass), tmp_path / "actor")
    back = load_actor(tmp_path / "actor")
    assert back.low_pass == low_pass
    assert back.track_id == actor.track_id
    assert back.provenance == actor.provenance
    np.testing.assert_array_equal(back.size, actor.size)
    np.testing.assert_array_equal(back.source, actor.source)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert getattr(back.gaussians, name).equal(getattr(actor.gaussians, name))
        assert getattr(back.shadow, name).equal(getattr(actor.shadow, name))


def test_same_actor_same_bytes(actor: Actor, tmp_path: Path) -> None:
    for name in ("one", "two"):
        save_actor(actor, tmp_path / name)
    for file in sorted((tmp_path / "one").iterdir()):
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()


def test_an_existing_folder_is_left_alone(actor: Actor, tmp_path: Path) -> None:
    (tmp_path / "actor").mkdir()
    with pytest.raises(InputError, match="exists already"):
        save_actor(actor, tmp_path / "actor")
    assert list((tmp_path / "actor").iterdir()) == []


@pytest.mark.parametrize("name", ["actor.json", "vehicle.ply", "shadow.safetensors", "source.png"])
def test_broken_files_are_named(actor: Actor, tmp_path: Path, name: str) -> None:
    save_actor(actor, tmp_path / "actor")
    file = tmp_path / "actor" / name
    file.write_bytes(file.read_bytes()[:40])
    with pytest.raises(InputError, match=name):
        load_actor(tmp_path / "actor")


def test_another_version(actor: Actor, tmp_path: Path) -> None:
    save_actor(actor, tmp_path / "actor")
    file = tmp_path / "actor" / "actor.json"
    record = json.loads(file.read_text())
    record["version"] = 99
    file.write_text(json.dumps(record))
    with pytest.raises(InputError, match="version"):
        load_actor(tmp_path / "actor")


@pytest.mark.parametrize("size", [[4.5, -1.8, 1.5], [4.5, 0.0, 1.5], [4.5, 1e200, 1.5]])
def test_a_size_that_no_vehicle_has(actor: Actor, tmp_path: Path, size: list[float]) -> None:
    save_actor(actor, tmp_path / "actor")
    file = tmp_path / "actor" / "actor.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"size": size}))
    with pytest.raises(InputError, match=r"Actor\.size: expected three lengths of") as caught:
        load_actor(tmp_path / "actor")
    assert str(tmp_path / "actor") in str(caught.value)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
@pytest.mark.parametrize("member", ["size", "azimuth"])
def test_numbers_that_are_not_finite(
    actor: Actor, tmp_path: Path, member: str, number: str
) -> None:
    save_actor(actor, tmp_path / "actor")
    file = tmp_path / "actor" / "actor.json"
    record = json.loads(file.read_text())
    if member == "size":
        record["size"][1] = "HERE"
    else:
        record["provenance"]["azimuth"] = "HERE"
    file.write_text(json.dumps(record).replace('"HERE"', number))
    with pytest.raises(InputError, match=r"actor\.json"):
        load_actor(tmp_path / "actor")


def test_infinite_sizes_are_not_saved(actor: Actor, tmp_path: Path) -> None:
    wrong = replace(actor, size=np.array([4.5, np.inf, 1.5]))
    with pytest.raises(ValueError, match=r"Actor\.size"):
        save_actor(wrong, tmp_path / "actor")
    assert not (tmp_path / "actor").exists()


@pytest.mark.parametrize(
    ("name", "value"), [("quats", 1e-30), ("log_scales", 20.0), ("sh", np.nan), ("means", 1e20)]
)
def test_a_shadow_out_of_range(actor: Actor, tmp_path: Path, name: str, value: float) -> None:
    save_actor(actor, tmp_path / "actor")
    path = tmp_path / "actor" / "shadow.safetensors"
    tensors = {key: tensor.clone() for key, tensor in load_file(path).items()}
    tensors[name][3] = value
    save_file(tensors, path)
    with pytest.raises(InputError, match=rf"shadow\.safetensors: {name}: row 3"):
        load_actor(tmp_path / "actor")


def test_the_source_image_is_measured_before_it_is_decoded(actor: Actor, tmp_path: Path) -> None:
    save_actor(actor, tmp_path / "actor")
    path = tmp_path / "actor" / "source.png"
    data = bytearray(path.read_bytes())
    data[16:24] = (9000).to_bytes(4, "big") * 2  # width and height; 324 MB of pixels
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"source\.png: size: is 9000x9000, more than 67"):
        load_actor(tmp_path / "actor")


def test_provenance_tells_the_whole_story(actor: Actor) -> None:
    provenance = actor.provenance
    assert (provenance.generator, provenance.seed) == ("template", 0)
    assert (provenance.camera, provenance.frame) == ("front", 1)
    assert provenance.details["style"] == "estate"
    assert provenance.registration.after.median > 0


def test_ply_generator_takes_what_is_there(
    actor: Actor, observation: Observation, tmp_path: Path
) -> None:
    write_ply(tmp_path / "car.ply", actor.gaussians)
    asset = SplatGenerator(tmp_path / "car.ply", axes="vehicle").generate(observation, 5)
    assert asset.gaussians.means.equal(actor.gaussians.means)
    assert asset.seed == 5
    assert asset.axes.declares_front


@pytest.mark.parametrize("name", list(formats()))
def test_exported_vehicles_are_generators(
    actor: Actor, observation: Observation, tmp_path: Path, name: str
) -> None:
    export_actor(actor, tmp_path / "out", name)
    record = json.loads((tmp_path / "out" / "actor.json").read_text())
    path = tmp_path / "out" / record["vehicle"]
    axes = {"ply": "x,z", "gltf": "z,y", "spz": "-z,y", "usd": "x,z"}[name]
    asset = make_generator(str(path), axes).generate(observation, 5)
    assert asset.generator == name and record["size"] == actor.size.tolist()
    assert np.allclose(asset.low_pass.variance, actor.low_pass.variance) or name == "spz"
    half_step = 2**-13 if name == "spz" else 0
    assert (read_gaussians(path).means - actor.gaussians.means).abs().max() <= half_step
    shadow = read_gaussians(tmp_path / "out" / record["shadow"])
    assert (shadow.means - actor.shadow.means).abs().max() <= half_step


def test_ply_errors_pass_through(actor: Actor, observation: Observation, tmp_path: Path) -> None:
    path = tmp_path / "car.ply"
    write_ply(path, actor.gaussians)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"property float opacity", b"property float opaqueX"))
    with pytest.raises(InputError, match="opacity"):
        SplatGenerator(path).generate(observation, 0)
    path.write_bytes(data[:-4] + np.float32(np.nan).tobytes())
    with pytest.raises(InputError, match=r"car\.ply"):
        SplatGenerator(path).generate(observation, 0)
    with pytest.raises(InputError):
        SplatGenerator(tmp_path / "nowhere.ply").generate(observation, 0)


def test_unknown_axes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unit_cube_y_up"):
        SplatGenerator(tmp_path / "car.ply", axes="upside_down")


def test_unknown_generator() -> None:
    with pytest.raises(InputError, match="is not known"):
        make_generator("no-such-generator")
