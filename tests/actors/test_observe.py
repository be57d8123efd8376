from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from actors import made_up
from recast.actors import BoxLidarSegmenter, Observation, TemplateGenerator, observe
from recast.actors.observe import rank_views
from recast.actors.view_score import NearestSweeps, check_lidar, score_frame
from recast.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, Track
from recast.pipeline.actor import ActorMakers, make_actor


def test_takes_the_largest_view_that_is_whole(observation: Observation, street: DrivingLog) -> None:
    track, stream = street.tracks["7"], street.cameras["front"]
    nearest, second = (score_frame(street, track, stream, frame) for frame in (0, 1))
    assert nearest is not None
    assert second is not None
    assert nearest.in_image < 0.9  # cut by the border, and larger all the same
    assert nearest.size_px > second.size_px
    assert observation.view.frame == 1


def test_another_track_in_front_lowers_the_score(street: DrivingLog) -> None:
    sweeps = NearestSweeps(street)
    bound = score_frame(street, street.tracks["8"], street.cameras["front"], 3)
    assert bound is not None
    score = check_lidar(street, street.tracks["8"], bound, sweeps)
    assert score.unoccluded < 0.6
    # ... and so do LiDAR returns before the box
    assert score.unblocked < 0.9
    clear = rank_views(street, street.tracks["7"])[0]
    assert clear.unoccluded == 1.0
    assert clear.unblocked > 0.95


def test_the_explanation_names_every_term(observation: Observation) -> None:
    text = observation.explain()
    for word in ("size", "in image", "not hidden", "no LiDAR return", "azimuth", "next:"):
        assert word in text
    assert observation.view.score == max(c.score for c in observation.candidates)


def test_crop_camera_sees_what_the_image_shows(
    observation: Observation, street: DrivingLog
) -> None:
    box = boxes.project(observation.size, observation.camera_from_object, observation.camera)
    height, width = observation.rgba.shape[:2]
    assert (observation.camera.width, observation.camera.height) == (width, height)
    assert box is not None
    assert np.all(box > 0)
    assert np.all(box < [width, height, width, height])
    image = street.cameras["front"].images[1]
    found = cv2.matchTemplate(image, observation.rgba[..., :3], cv2.TM_SQDIFF)
    _, _, corner, _ = cv2.minMaxLoc(found)
    full = boxes.project(observation.size, observation.camera_from_object, made_up.CAMERA)
    assert full is not None
    np.testing.assert_allclose(box + np.array([*corner, *corner]), full)


def test_azimuth_and_sides(observation: Observation) -> None:
    assert 130 < np.degrees(observation.azimuth) < 165  # behind on the left
    assert set(observation.sides_seen()) == {"rear", "left", "top"}


def test_distortion_is_undone(street: DrivingLog) -> None:
    """A camera that bends nothing much gives the crop of one that bends nothing."""
    stream = street.cameras["front"]
    bent = dataclasses.replace(stream.camera, distortion=(1e-9, 0.0, 0.0, 0.0, 0.0))
    log = dataclasses.replace(street, cameras={"front": dataclasses.replace(stream, camera=bent)})
    plain = observe(street, "7", segmenter=BoxLidarSegmenter())
    remapped = observe(log, "7", segmenter=BoxLidarSegmenter())
    assert remapped.camera.is_rectified
    difference = plain.rgba[..., :3].astype(int) - remapped.rgba[..., :3]
    assert np.abs(difference).max() <= 1


def test_unknown_track_lists_the_known_ones(street: DrivingLog) -> None:
    with pytest.raises(InputError, match="7, 8, 9, 10"):
        observe(street, "99", segmenter=BoxLidarSegmenter())


def test_unknown_camera(street: DrivingLog) -> None:
    with pytest.raises(InputError, match="front"):
        observe(street, "7", segmenter=BoxLidarSegmenter(), cameras=("front", "rear"))


def test_too_few_lidar_points(street: DrivingLog) -> None:
    with pytest.raises(InputError, match="0 LiDAR points in its boxes, at least 20"):
        observe(street, "10", segmenter=BoxLidarSegmenter())


def test_never_visible(street: DrivingLog) -> None:
    """A car behind the camera that the LiDAR sees all the same."""
    track = street.tracks["9"]
    lidar = street.lidars["top"]
    rng = np.random.default_rng(0)
    sweeps = []
    for sweep in lidar.sweeps:  # type: ignore[attr-defined]
        local = rng.uniform(-0.6, 0.6, (40, 3))
        points = se3.apply(track.trajectory.at(sweep.timestamp_us), local).astype(np.float32)
        sweeps.append(dataclasses.replace(sweep, points=points, intensity=np.zeros(40, np.float32)))
    log = dataclasses.replace(
        street, lidars={"top": dataclasses.replace(lidar, sweeps=made_up.Sweeps(sweeps))}
    )
    with pytest.raises(InputError, match="never visible"):
        observe(log, "9", segmenter=BoxLidarSegmenter())


def test_a_track_without_a_label_at_the_frames_is_not_scored(street: DrivingLog) -> None:
    track = street.tracks["7"]
    late = dataclasses.replace(
        track.trajectory, timestamps_us=track.trajectory.timestamps_us + 10_000_000
    )
    assert rank_views(street, Track("7", "car", track.size, late)) == []


def with_more_cameras(street: DrivingLog) -> DrivingLog:
    """The log with two further cameras in the same place, in which the car is smaller."""
    front = street.cameras["front"]
    cameras = dict(street.cameras)
    for name, scale in (("half", 0.5), ("most", 0.75)):
        size = (round(made_up.CAMERA.width * scale), round(made_up.CAMERA.height * scale))
        images = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in front.images]
        cameras[name] = dataclasses.replace(
            front, name=name, camera=made_up.CAMERA.resized(*size), images=made_up.Frames(images)
        )
    return dataclasses.replace(street, cameras=cameras)


@pytest.mark.parametrize(
    ("named", "chosen"),
    [((), "front"), (("half",), "half"), (("half", "most"), "most"), (("most", "front"), "front")],
)
def test_the_best_view_of_the_named_cameras_is_taken(
    street: DrivingLog, named: tuple[str, ...], chosen: str
) -> None:
    log = with_more_cameras(street)
    seen = observe(log, "7", segmenter=BoxLidarSegmenter(), cameras=named)
    assert seen.view.camera == chosen
    assert {view.camera for view in seen.candidates} <= set(named or log.cameras)


def test_making_an_actor_counts_all_named_cameras(
    street: DrivingLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recast.pipeline.actor.film_turntable", lambda actor, path: None)
    makers = ActorMakers(TemplateGenerator(spacing=0.1), BoxLidarSegmenter())
    log = with_more_cameras(street)
    actor = make_actor(log, "7", makers, 0, tmp_path, cameras=("half", "most"))
    assert actor.provenance.camera == "most"
