from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from recast.actors import BoxLidarSegmenter
from recast.actors.evidence import Evidence, load_evidence, save_evidence
from recast.actors.observe import gather_evidence
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig
from recast.splats import Gaussians, rasterize
from support import made_up_actors as made_up

EVERY_FRAME = SceneConfig(scale=1.0, holdout_every=0)


@pytest.fixture(scope="module")
def found(street: DrivingLog) -> Evidence:
    return gather_evidence(street, "7", segmenter=BoxLidarSegmenter(), config=EVERY_FRAME)


def test_every_image_of_the_track_with_a_mask_of_it(found: Evidence, red_car: Gaussians) -> None:
    assert [one.frame for one in found.sightings] == list(range(made_up.FRAMES))
    for one in found.sightings:
        with torch.no_grad():
            true = rasterize(
                red_car,
                torch.from_numpy(one.camera_from_object).float(),
                torch.from_numpy(one.camera.matrix).float(),
                one.camera.width,
                one.camera.height,
            ).alpha.numpy()
        shown, mask = true > 0.5, one.mask > 0.5
        assert (shown & mask).sum() / (shown | mask).sum() > 0.8
        assert 0 < one.weight <= 1
        # The crop's picture is the vehicle's, not another part of the image.
        assert np.abs(one.image[mask].mean(axis=0) / 255 - made_up.GREY).max() > 0.1


def test_held_out_images_never_enter(street: DrivingLog) -> None:
    config = SceneConfig(scale=1.0, holdout_every=2, holdout_offset=1)
    found = gather_evidence(street, "7", segmenter=BoxLidarSegmenter(), config=config)
    assert [one.frame for one in found.sightings] == [0, 2, 4]


def test_lidar_is_in_the_box_frame(found: Evidence) -> None:
    assert len(found.hits) > 1000
    assert np.all(np.abs(found.hits) <= made_up.SIZE / 2 + 0.16)


def test_a_hidden_track_has_no_image_and_a_reason(street: DrivingLog) -> None:
    found = gather_evidence(street, "8", segmenter=BoxLidarSegmenter(), config=EVERY_FRAME)
    assert not found.sightings
    assert set(found.left_out) == {"hidden by another object"}
    assert "hidden by another object" in found.explain()


def test_no_such_track(street: DrivingLog) -> None:
    with pytest.raises(InputError, match="track 42"):
        gather_evidence(street, "42", segmenter=BoxLidarSegmenter(), config=EVERY_FRAME)


def test_no_lidar_is_no_reason_to_stop(street: DrivingLog) -> None:
    found = gather_evidence(
        dataclasses.replace(street, lidars={}),
        "7",
        segmenter=BoxLidarSegmenter(),
        config=EVERY_FRAME,
    )
    assert len(found.hits) == 0 and len(found.free.centres) == 0
    assert found.sightings


def test_a_file_gives_it_back(found: Evidence, tmp_path: Path) -> None:
    save_evidence(found, tmp_path / "evidence")
    back = load_evidence(tmp_path / "evidence")
    assert back.explain() == found.explain()
    np.testing.assert_array_equal(back.hits, found.hits)
    np.testing.assert_array_equal(back.free.centres, found.free.centres)
    for one, other in zip(back.sightings, found.sightings, strict=True):
        for field in dataclasses.fields(one):
            first, second = getattr(one, field.name), getattr(other, field.name)
            if field.name in ("mask", "trust"):
                np.testing.assert_allclose(first, second, atol=0.5 / 255 + 1e-6)
            elif isinstance(first, np.ndarray):
                np.testing.assert_array_equal(first, second)
            else:
                assert first == second


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("0.mask", None, "0.mask: is missing"),
        ("0.mask", torch.zeros(3, 3, dtype=torch.uint8), "0.mask: is uint8"),
        ("hits", torch.zeros(4, 3, dtype=torch.float64), "hits: is float64"),
        ("hits", torch.full((4, 3), float("nan")), "hits: is not finite"),
        ("1.camera_from_world", torch.zeros(4, 4, dtype=torch.float64), "sighting 1"),
    ],
)
def test_a_damaged_file_is_one_line(
    found: Evidence, tmp_path: Path, name: str, value: torch.Tensor | None, problem: str
) -> None:
    path = tmp_path / "evidence"
    save_evidence(found, path)
    from safetensors import safe_open

    with safe_open(path, "pt") as opened:
        header = opened.metadata()
    tensors = load_file(path)
    tensors.pop(name)
    if value is not None:
        tensors[name] = value
    save_file(tensors, path, metadata=header)
    with pytest.raises(InputError, match=problem):
        load_evidence(path)


def test_a_scene_moves_the_poses(found: Evidence, street: DrivingLog, red_car: Gaussians) -> None:
    from recast.logs import Trajectory
    from recast.scene import SceneActor, SkyMap, StreetScene

    track = street.tracks["7"].trajectory
    shift = se3.from_rotation_translation(np.eye(3), [0.1, 0.0, 0.0])
    moved = Trajectory(track.timestamps_us, track.poses @ shift)
    own = SceneActor("7", red_car, made_up.SIZE, moved)
    scene = StreetScene(red_car, {"7": own}, SkyMap.constant(torch.zeros(3)))
    for one, other in zip(found.posed_by(scene).sightings, found.sightings, strict=True):
        np.testing.assert_allclose(
            one.world_from_object, other.world_from_object @ shift, atol=1e-12
        )
