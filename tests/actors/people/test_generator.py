"""A person from a crop: made, put on its way, kept on disk, and put into a street."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from actors.people import made_up_people as made_up
from recast.actors import (
    Actor,
    Asset,
    BoxLidarSegmenter,
    Observation,
    insert,
    load_actor,
    make_generator,
    register,
    save_actor,
)
from recast.actors.actor import CoverageMeter, Shares
from recast.actors.generate import candidates_of
from recast.actors.observe import observation_of_view
from recast.actors.people import PeopleGenerator
from recast.actors.people.generator import require_person
from recast.actors.segment import SegmentationTarget
from recast.actors.vehicle_files import vehicle_generator
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.scene import SceneRasterizer, StreetScene
from recast.scene.actor import SceneActor, look_at
from recast.scene.sky import SkyMap
from recast.splats import MIP
from support import made_up_actors

CAMERA = PinholeCamera(120, 156, 300.0, 300.0, 60.0, 78.0)
POSE = look_at(np.array([3.0, 5.0, 0.3]), np.zeros(3))


def observed(category: str = "pedestrian", size: np.ndarray = made_up.BOX) -> Observation:
    shape = made_up.RIDER if category == "cyclist" else made_up.WALKER
    view = made_up.views(shape, size)[0]
    gaussians, gait = made_up.body(shape, size)
    seen = replace(
        view,
        camera=CAMERA,
        camera_from_object=POSE,
        back=torch.full((CAMERA.height, CAMERA.width, 3), made_up.BEHIND),
        front=torch.zeros(CAMERA.height, CAMERA.width, 3),
        through=torch.ones(CAMERA.height, CAMERA.width),
    )
    with torch.no_grad():
        picture, alpha = seen.drawn(gait.posed(gaussians, made_up.PHASE))
    rgba = torch.cat([picture, (alpha > 0.5).float()[..., None]], dim=-1)
    levels = (rgba.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    return observation_of_view(levels, CAMERA, POSE, size, name="7", category=category)


def walk(steps: int = 21) -> Trajectory:
    """Two metres along x, then two along y."""
    along = np.linspace(0, 4, steps)
    poses = np.tile(np.eye(4), (steps, 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = np.minimum(along, 2), np.maximum(along - 2, 0)
    poses[:, 2, 3] = made_up.BOX[2] / 2
    poses[along > 2, :3, :3] = se3.rotation_z(np.pi / 2)
    return Trajectory(np.arange(steps, dtype=np.int64) * 100_000, poses)


@pytest.fixture(scope="module")
def asset() -> Asset:
    return PeopleGenerator().generate(observed(), 0)


def registered(asset: Asset, track: Track) -> Actor:
    rng = np.random.default_rng(0)
    points = rng.normal(0, [0.1, 0.15, 0.4], (60, 3)).astype(np.float32)
    log = DrivingLog("street", {}, {}, walk(), {"7": track})
    seen = observed()
    quality = replace(seen.mask_quality, lidar_inside=1.0)
    return register(asset, replace(seen, points=points, mask_quality=quality), log, track)


@pytest.fixture(scope="module")
def actor(asset: Asset) -> Actor:
    return registered(asset, Track("7", "pedestrian", made_up.BOX, walk()))


def test_one_crop_gives_a_whole_person(asset: Asset) -> None:
    size = asset.gaussians.means.amax(dim=0) - asset.gaussians.means.amin(dim=0)
    assert size[2] == pytest.approx(made_up.BOX[2], rel=0.06)
    assert asset.details["height_m"] == pytest.approx(made_up.WALKER.height, rel=0.05)
    assert asset.gait is not None and asset.low_pass == MIP
    asset.gait.validate("gait", len(asset.gaussians))


def test_a_cyclist_has_a_bicycle() -> None:
    asset = PeopleGenerator().generate(observed("cyclist", made_up.RIDER_BOX), 0)
    means = asset.gaussians.means
    low = means[:, 2] < 0.1 - made_up.RIDER_BOX[2] / 2
    assert float(means[low, 0].max() - means[low, 0].min()) > 0.9  # two wheels
    assert float(means[:, 0].max() - means[:, 0].min()) == pytest.approx(1.75, abs=0.1)


def test_auto_makes_the_same_people_of_people(asset: Asset) -> None:
    [make] = candidates_of(make_generator("auto"), observed(), 0)
    again = make()
    assert again.generator == "people"
    assert torch.equal(again.gaussians.means, asset.gaussians.means)
    assert torch.equal(again.gaussians.sh, asset.gaussians.sh)
    assert make_generator("people").name == "people"


@pytest.mark.parametrize(
    ("category", "size", "said"),
    [
        ("car", (4.4, 1.8, 1.5), "is no pedestrian or cyclist"),
        ("pedestrian", (1.0, 2.1, 1.8), "of a group"),
        ("pedestrian", (2.4, 0.8, 1.8), "of a group"),
        ("pedestrian", (0.4, 0.4, 0.4), "nobody who walks"),
        ("pedestrian", (1.0, 0.6, 3.9), "too high"),
        ("cyclist", (2.0, 1.6, 1.8), "of a group"),
        ("cyclist", (1.7, 0.6, 1.1), "without a rider"),
    ],
)
def test_what_is_no_person_is_told_in_one_line(
    category: str, size: tuple[float, float, float], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        require_person(category, np.array(size), "12")
    assert "track 12" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_child_is_told() -> None:
    assert "child" in require_person("pedestrian", np.array([0.8, 0.4, 1.2]), "1")
    assert "child" in require_person("cyclist", np.array([1.2, 0.5, 1.3]), "1")
    assert require_person("pedestrian", made_up.BOX, "1") == ""


def test_the_way_moves_the_limbs(actor: Actor) -> None:
    poses = walk().poses
    assert actor.gait is not None
    places = [actor.at(pose).means for pose in poses]
    assert not torch.allclose(places[0], places[3], atol=0.05)
    # One cycle on, round the corner, it stands as it did.
    turned, first = np.array(poses[-1]), np.array(poses[0])
    first[0, 3] = 1.0
    turned[:2, 3] = 2.0, 1.0 + actor.gait.cycle - 2.0
    assert turned[1, 3] > 0
    assert torch.allclose(actor.at(turned).means, actor.at(first).means, atol=0.02)
    # Straight on beyond both ends; across by the metres beside the way.
    beyond, before = np.array(poses[-1]), np.array(poses[0])
    beyond[1, 3] += 3.0
    before[0, 3] -= 2.0
    gone = [actor.gait.phase_at(pose) * actor.gait.cycle for pose in (beyond, before)]
    start = actor.gait.phase * actor.gait.cycle
    assert gone == pytest.approx([start + 7.0, start - 2.0], abs=0.35)  # the corner is cut
    across = [np.array(poses[0]) for _ in range(3)]
    for pose, metres in zip(across, (-5.0, -4.0, -1.0), strict=True):
        pose[:3, :3] = se3.rotation_z(np.pi / 2)
        pose[:2, 3] = 0.5, metres
    walked = np.diff([actor.gait.phase_at(pose) * actor.gait.cycle for pose in across])
    assert walked == pytest.approx([1.0, 3.0])
    assert actor.gait.phase_at(poses[0]) == pytest.approx(actor.gait.phase)


def test_at_the_first_phase_the_body_is_as_stored(actor: Actor) -> None:
    assert actor.gait is not None
    posed = actor.gait.posed(actor.gaussians, 3.0)
    torch.testing.assert_close(posed.means, actor.gaussians.means, atol=1e-5, rtol=0)


def test_round_trip_and_broken_files(actor: Actor, tmp_path: Path) -> None:
    save_actor(actor, tmp_path / "actor")
    back = load_actor(tmp_path / "actor")
    assert actor.gait is not None and back.gait is not None
    assert (back.gait.cycle, back.gait.phase) == (actor.gait.cycle, actor.gait.phase)
    for name in ("rotations", "translations", "way"):
        np.testing.assert_array_equal(getattr(back.gait, name), getattr(actor.gait, name))
    assert torch.equal(back.gait.weights, actor.gait.weights)
    file = tmp_path / "actor" / "gait.safetensors"
    whole = load_file(file)
    wrongs = {
        "cycle": {"steps": torch.tensor([0.0, 0.0], dtype=torch.float64)},
        "weights": {"weights": whole["weights"][:-1].contiguous()},
        "rotations": {"rotations": whole["rotations"] * 2},
        "way": {"way": torch.zeros_like(whole["way"])},
        "steps": {"steps": torch.zeros(2)},
    }
    for name, wrong in wrongs.items():
        save_file({**whole, **wrong}, file)
        with pytest.raises(InputError, match=name):
            load_actor(tmp_path / "actor")
    file.write_bytes(b"no tensors")
    with pytest.raises(InputError, match="gait"):
        load_actor(tmp_path / "actor")
    file.unlink()
    with pytest.raises(InputError, match="gait"):
        load_actor(tmp_path / "actor")
    # The person of another folder becomes as tall as the box, and stands on its floor.
    save_file(whole, file)
    small = replace(observed(), size=np.array([0.8, 0.5, 1.3]))
    other = vehicle_generator(tmp_path / "actor").generate(small, 0)
    assert other.gait is not None and other.gait.cycle < actor.gait.cycle
    for phase in (0.0, 0.4):
        means = other.gait.posed(other.gaussians, phase).means
        assert float(means[:, 2].min()) == pytest.approx(-0.65, abs=0.03)
        assert float(means[:, 2].max()) == pytest.approx(0.65, abs=0.06)


def test_noise_of_who_stands_moves_no_leg(asset: Asset) -> None:
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :2, 3] = rng.normal(0, 0.03, (40, 2))
    still = Trajectory(np.arange(40, dtype=np.int64) * 100_000, poses)
    actor = registered(asset, Track("7", "pedestrian", made_up.BOX, still))
    assert actor.gait is not None
    phases = [actor.gait.phase_at(pose) for pose in poses]
    assert np.ptp(phases) * actor.gait.cycle < 0.25


def test_who_turns_on_the_spot_moves_no_leg_but_once_or_twice(actor: Actor) -> None:
    assert actor.gait is not None
    pose = np.array(walk().poses[3])
    pose[1, 3] = 25.0
    found = []
    for turn in np.linspace(0, np.pi, 60):
        pose[:3, :3] = se3.rotation_z(turn)
        found.append(actor.gait.phase_at(pose))
    assert np.count_nonzero(np.abs(np.diff(found)) > 1e-9) <= 2


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"cycle": 0.0}, "cycle"),
        ({"phase": float("nan")}, "phase"),
        ({"weights": torch.ones(3, 12)}, "weights"),
        ({"way": np.zeros((2, 2))}, "way"),
    ],
)
def test_a_wrong_gait_of_a_users_generator_is_named(
    asset: Asset, wrong: dict[str, object], said: str
) -> None:
    assert asset.gait is not None
    bad = replace(asset, gait=replace(asset.gait, **wrong), generator="theirs")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=said) as caught:
        registered(bad, Track("7", "pedestrian", made_up.BOX, walk()))
    assert "generator theirs" in str(caught.value)


def test_a_person_does_not_stand_for_a_car(asset: Asset) -> None:
    with pytest.raises(InputError, match="is a person, and track 7 is of the category car"):
        registered(asset, Track("7", "car", np.array([4.4, 1.8, 1.5]), walk()))


def street(actor: Actor) -> StreetScene:
    """Grey ground below an actor's track."""
    rng = np.random.default_rng(1)
    ground = made_up_actors.car().select(torch.arange(400))
    places = np.column_stack([rng.uniform(-6, 8, 400), rng.uniform(-6, 8, 400), np.zeros(400)])
    ground = replace(ground, means=torch.from_numpy(places).float())
    native = SceneActor("7", actor.gaussians, actor.size, walk())
    return StreetScene(ground, {"7": native}, SkyMap(torch.full((8, 16, 3), 0.7)))


def test_a_street_shows_each_step_and_its_coverage(actor: Actor) -> None:
    scene = insert(street(actor), actor, relit=False)
    scene.validate()
    rasterizer = SceneRasterizer(scene)
    view = look_at(np.array([1.0, -7.0, 1.2]), np.array([1.0, 0.0, 0.9]))
    poses = walk().poses
    images = [rasterizer.render(CAMERA, view, {"7": poses[k]}).rgb for k in (0, 3)]
    assert np.abs(images[0] - images[1]).max() > 0.2
    again = rasterizer.render(CAMERA, view, {"7": poses[0]}).rgb
    np.testing.assert_array_equal(again, images[0])
    whole = scene.at({"7": poses[3]})
    assert len(whole) == len(scene.background) + len(actor.gaussians) + len(actor.shadow)
    count = len(actor.gaussians)
    shares = Shares(torch.ones(count), torch.zeros(count))
    meter = CoverageMeter(scene, "7", shares)
    found = meter.measure(CAMERA, view, {"7": poses[3]})
    alpha = np.abs(images[1] - rasterizer.render(CAMERA, view, {}).rgb).max(axis=2) > 0.05
    assert found.seen == pytest.approx(1.0)
    assert found.pixels == pytest.approx(float(alpha.sum()), rel=0.4)


@pytest.mark.parametrize("category", ["pedestrian", "cyclist"])
def test_masks_without_lidar_are_those_of_the_trunk(category: str) -> None:
    size = made_up.RIDER_BOX if category == "cyclist" else made_up.BOX
    seen = observed(category, size)
    target = SegmentationTarget(
        image=np.ascontiguousarray(seen.rgba[..., :3]),
        camera=seen.camera,
        camera_from_object=seen.camera_from_object,
        size=size,
        object_points=np.zeros((0, 3)),
        other_points=np.zeros((0, 3)),
        category=category,
    )
    mask = BoxLidarSegmenter().segment(target) > 127
    truth = seen.rgba[..., 3] > 127
    assert (mask & truth).sum() / (mask | truth).sum() > 0.5
