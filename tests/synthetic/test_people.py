from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.geometry import boxes, se2, se3
from recast.logs import DrivingLog, Trajectory, read_log
from recast.synthetic import Oracle, populate, read_truth, world_metadata, world_of
from recast.synthetic.populate import Footing
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.world import World, touching
from recast.synthetic.write import synthesize_log
from support.small_street import box_car, small_street


def crowded(people: bool = True, seconds: float = 2.6) -> World:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(populate, "sample_vehicle", box_car)
        return populate.populate(small_street(), "urban-straight", 0, seconds, people)


@pytest.fixture(scope="module")
def world() -> World:
    return crowded()


@pytest.fixture(scope="module")
def log_folder(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four moments of the world."""
    short = {
        key: replace(vehicle, trajectory=_cut(vehicle.trajectory))
        for key, vehicle in world.vehicles.items()
    }
    out = tmp_path_factory.mktemp("crowded") / "log"
    cut = replace(world, vehicles=short, ego=_cut(world.ego))
    synthesize_log(cut, out, width=96, height=64, workers=1, truth=True)
    return out


@pytest.fixture(scope="module")
def log(log_folder: Path) -> DrivingLog:
    return read_log(log_folder)


def _cut(trajectory: Trajectory) -> Trajectory:
    rows = slice(20, 25)
    return replace(
        trajectory, timestamps_us=trajectory.timestamps_us[rows], poses=trajectory.poses[rows]
    )


def people_of(world: World) -> list[str]:
    return [key for key, vehicle in world.vehicles.items() if vehicle.model.articulation]


def test_a_world_without_people_is_the_same_as_ever(world: World) -> None:
    empty = crowded(people=False)
    assert "people" not in world_metadata(empty) and not people_of(empty)
    assert world_metadata(world) == {**world_metadata(empty), "people": "yes"}
    for key, vehicle in empty.vehicles.items():
        other = world.vehicles[key].trajectory.poses
        np.testing.assert_array_equal(vehicle.trajectory.poses, other)
    assert list(world.vehicles)[: len(empty.vehicles)] == list(empty.vehicles)


def test_people_walk_and_ride_and_touch_nobody(world: World) -> None:
    found = people_of(world)
    kinds = {world.vehicles[key].model.category for key in found}
    assert kinds == {"pedestrian", "cyclist"} and len(found) >= 3
    placed = {
        key: (se2.from_se3(v.trajectory.poses), v.model.size) for key, v in world.vehicles.items()
    }
    for key, other in itertools.product(found, placed):
        if key != other:
            assert not touching(*placed[key], *placed[other]).any(), (key, other)
    for key in found:
        steps = np.linalg.norm(np.diff(placed[key][0][:, :2], axis=0), axis=1) / 0.1
        low, high = (0.9, 1.7) if key.startswith("pedestrian") else (3.4, 6.1)
        assert low < steps.min() and steps.max() < high


def test_the_log_names_their_category_and_gives_the_world_back(
    world: World, log: DrivingLog
) -> None:
    for key in set(people_of(world)) & log.tracks.keys():
        assert log.tracks[key].category == world.vehicles[key].model.category
    assert log.metadata["people"] == "yes"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(populate, "make_world", lambda *request: request)
        known = world.name, world.seed, world.seconds, world.light, True, "fair"
        assert world_of(log) == known
    with pytest.raises(InputError, match="does not name a world"):
        world_of(replace(log, metadata={**log.metadata, "people": "many"}))


def test_masks_boxes_and_points_of_people_agree(world: World, log_folder: Path) -> None:
    log, truth = read_log(log_folder), read_truth(log_folder)
    numbers = {name: number for number, name in truth.record.instances.items()}
    seen = hit = 0
    points_of: dict[str, int] = dict.fromkeys(people_of(world), 0)
    for frame, time in enumerate(log.cameras["front"].timestamps_us.tolist()):
        for name, stream in log.cameras.items():
            mask = truth.instance(name, frame)
            pose = np.linalg.inv(log.world_from_rig.at(time) @ stream.rig_from_camera)
            for key in set(people_of(world)) & log.tracks.keys():
                rows, columns = np.nonzero(mask == numbers[key])
                if len(rows) < 6:
                    continue
                track = log.tracks[key]
                box = box_rectangle(track.size, pose @ track.trajectory.at(time), stream.camera)
                assert box is not None
                left, top, right, bottom = box
                assert left - 1 <= columns.min() and columns.max() + 1 <= right + 1
                assert top - 1 <= rows.min() and rows.max() + 1 <= bottom + 1
                seen += 1
        sweep = next(iter(log.lidars.values())).sweeps[frame]
        points = sweep.points @ log.world_from_rig.at(time)[:3, :3].T
        points = points + log.world_from_rig.at(time)[:3, 3]
        for key in points_of.keys() & log.tracks.keys():
            track = log.tracks[key]
            inside = boxes.contains(points, track.size - [0, 0, 0.1], track.trajectory.at(time))
            points_of[key] += int(inside.sum())
            hit += int(inside.sum())
    assert seen >= 5 and hit >= 50, "people are seen by cameras and LiDAR"
    assert sum(count > 0 for count in points_of.values()) >= 2


def test_the_pose_tells_the_shape(world: World) -> None:
    key = next(key for key in people_of(world) if key.startswith("pedestrian"))
    person = world.vehicles[key]
    times = person.trajectory.timestamps_us
    shapes = [person.surface_at(person.trajectory.at(t)) for t in (times[3], times[3], times[6])]
    np.testing.assert_array_equal(shapes[0].vertices, shapes[1].vertices)
    assert np.abs(shapes[0].vertices - shapes[2].vertices).max() > 0.05
    oracle = Oracle(world)
    pose = {key: person.trajectory.poses[3]}
    scene = oracle.scene_at(pose)
    np.testing.assert_array_equal(scene.models[key].vertices, shapes[0].vertices)
    assert oracle.scene_at({}) is oracle.scene
    with pytest.raises(ValueError, match="faces"):
        oracle.scene.with_models({key: oracle.scene.static})
    with pytest.raises(ValueError, match="not among"):
        oracle.scene.with_models({"9": shapes[0]})


def test_ground_is_felt_and_walls_are_met() -> None:
    square = [[0, 0, 0.1], [4, 0, 0.1], [4, 4, 0.3], [0, 4, 0.3]]
    floor = Surface.make(square, [[0, 1, 2], [0, 2, 3]], (0.5,) * 3, "concrete")
    wall = Surface.make(
        [[2, 0, 0], [2, 4, 0], [2, 4, 3], [2, 0, 3]], [[0, 1, 2], [0, 2, 3]], (0.5,) * 3, "brick"
    )
    footing = Footing(concatenate([floor, wall]))
    heights = footing.heights(np.array([[1.0, 0.0], [3.0, 2.0], [1.0, 4.0], [5.0, 1.0]]))
    np.testing.assert_allclose(heights[:3], [0.1, 0.2, 0.3], atol=1e-9)
    assert np.isnan(heights[3])
    way = np.array([[1.0, 1.0], [1.0, 3.0]])
    assert not footing.blocked(way, 0.9) and footing.blocked(way, 1.1)


def test_who_leaves_the_own_way_walks_on(world: World) -> None:
    """Ten steps across the way, 0.1 m each, have the shapes of ten steps along it."""
    key = next(key for key in people_of(world) if key.startswith("pedestrian"))
    person = world.vehicles[key]
    first = person.trajectory.poses[0]
    away = first @ se3.from_rotation_translation(se3.rotation_z(np.pi / 2), [0.0, 3.0, 0.0])
    for n in range(10):
        ahead = se3.from_rotation_translation(np.eye(3), [0.1 * n, 0.0, 0.0])
        found = person.surface_at(away @ ahead)
        assert person.model.articulation is not None
        wanted = person.model.articulation.surface_at(3.0 + 0.1 * n)
        np.testing.assert_allclose(found.vertices, wanted.vertices, atol=1e-6)
