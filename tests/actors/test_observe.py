from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from recast.actors import (
    BoxLidarSegmenter,
    Observation,
    Segmentation,
    SegmentationTarget,
    TemplateGenerator,
    observe,
)
from recast.actors.observation import NearestSweeps, ViewPool, check_lidar, score_frame
from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, Track
from recast.reconstruction import SceneConfig
from recast.runs.actor import ActorMakers, make_actor
from recast.splats import Gaussians
from support import made_up_actors as made_up


def test_takes_the_largest_view_that_is_whole(observation: Observation, street: DrivingLog) -> None:
    track, stream = street.tracks["7"], street.cameras["front"]
    nearest, second = (score_frame(street, track, stream, frame) for frame in (0, 1))
    assert nearest is not None
    assert second is not None
    assert nearest.in_image < 0.9  # cut by the border, and larger all the same
    assert nearest.size_px > second.size_px
    assert observation.view.frame == 1


def test_a_frame_that_cuts_the_vehicle_is_never_first(street: DrivingLog) -> None:
    """Nearby and hardly cut, it would be three times as large as any whole one."""
    whole = score_frame(street, street.tracks["7"], street.cameras["front"], 2)
    assert whole is not None and whole.whole
    whole = dataclasses.replace(whole, frame=0)
    cut = dataclasses.replace(whole, frame=1, size_px=3 * whole.size_px, in_image=0.9)
    tiny = dataclasses.replace(whole, frame=2, size_px=20.0)
    pool = ViewPool(street, street.tracks["7"])
    pool._bounds = [cut, tiny, whole]
    pool._checked = {view.key: view for view in pool._bounds}
    assert [view.frame for view in pool.ranked()] == [0, 1, 2]
    pool._bounds = [tiny, cut]
    assert pool.ranked()[0] is cut  # better than nothing


def test_another_track_in_front_lowers_the_score(street: DrivingLog) -> None:
    sweeps = NearestSweeps(street)
    bound = score_frame(street, street.tracks["8"], street.cameras["front"], 3)
    assert bound is not None
    score = check_lidar(street, street.tracks["8"], bound, sweeps)
    assert score.unoccluded < 0.6
    # ... and so do LiDAR returns before the box
    assert score.unblocked < 0.9
    clear = ViewPool(street, street.tracks["7"]).ranked()[0]
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
    box = box_rectangle(observation.size, observation.camera_from_object, observation.camera)
    height, width = observation.rgba.shape[:2]
    assert (observation.camera.width, observation.camera.height) == (width, height)
    assert box is not None
    assert np.all(box > 0)
    assert np.all(box < [width, height, width, height])
    image = street.cameras["front"].images[1]
    found = cv2.matchTemplate(image, observation.rgba[..., :3], cv2.TM_SQDIFF)
    _, _, corner, _ = cv2.minMaxLoc(found)
    full = box_rectangle(observation.size, observation.camera_from_object, made_up.CAMERA)
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
    assert ViewPool(street, Track("7", "car", track.size, late)).ranked() == []


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


@pytest.fixture(scope="module")
def turning(red_car: Gaussians) -> DrivingLog:
    """The car "7" shows another side in every frame."""
    return made_up.street_log(red_car, made_up.turning_poses())


def test_further_views_show_other_sides(turning: DrivingLog) -> None:
    alone = observe(turning, "7", segmenter=BoxLidarSegmenter())
    seen = observe(turning, "7", segmenter=BoxLidarSegmenter(), views=3)
    assert alone.further == ()
    assert seen.view == alone.view
    assert len(seen.further) == 2
    azimuths = np.array([one.azimuth for one in seen.views])
    apart = np.abs(np.angle(np.exp(1j * (azimuths[:, None] - azimuths))))
    assert np.degrees(apart[np.triu_indices(3, 1)]).min() > 39  # three frames, 40 degrees a frame
    for one in seen.views:  # each is whole: its own crop, camera, pose and mask
        assert one.azimuth == pytest.approx(one.view.azimuth)
        assert one.rgba.shape[:2] == (one.camera.height, one.camera.width)
        assert one.mask_quality.agrees
        assert f"frame {one.view.frame}:" in seen.explain()


def test_what_adds_nothing_is_no_further_view(street: DrivingLog, turning: DrivingLog) -> None:
    """All five frames of the street show the car from within 12 degrees of the best one."""
    assert observe(street, "7", segmenter=BoxLidarSegmenter(), views=5).further == ()
    many = observe(turning, "7", segmenter=BoxLidarSegmenter(), views=99)
    frames = [one.view.frame for one in many.views]
    assert len(set(frames)) == len(frames) == made_up.FRAMES


def test_frames_that_may_not_be_looked_at_are_not(turning: DrivingLog) -> None:
    best = observe(turning, "7", segmenter=BoxLidarSegmenter()).view.frame
    kept = {frame for frame in range(made_up.FRAMES) if frame not in (best, best + 1)}
    seen = observe(
        turning,
        "7",
        segmenter=BoxLidarSegmenter(),
        views=5,
        usable=lambda camera, frame: camera == "front" and frame in kept,
    )
    assert {one.view.frame for one in seen.views} == kept
    assert {view.frame for view in seen.candidates} <= kept
    with pytest.raises(InputError, match="never visible"):
        observe(turning, "7", segmenter=BoxLidarSegmenter(), usable=lambda camera, frame: False)


class EmptyAfterTheFirst:
    """A segmenter that finds the vehicle once only."""

    def __init__(self) -> None:
        self.calls = 0

    def segment(self, target: SegmentationTarget) -> np.ndarray:
        self.calls += 1
        found = BoxLidarSegmenter().segment(target)
        alpha = found.alpha if isinstance(found, Segmentation) else found
        return alpha if self.calls == 1 else np.zeros_like(alpha)


def test_a_further_view_with_a_wrong_mask_is_passed_over(turning: DrivingLog) -> None:
    segmenter = EmptyAfterTheFirst()
    seen = observe(turning, "7", segmenter=segmenter, views=3)
    assert seen.further == ()
    assert segmenter.calls == made_up.FRAMES  # every other frame was tried


def test_no_view_at_all_is_refused(street: DrivingLog) -> None:
    with pytest.raises(ValueError, match="views 0"):
        observe(street, "7", segmenter=BoxLidarSegmenter(), views=0)


def test_making_an_actor_counts_all_named_cameras(street: DrivingLog, tmp_path: Path) -> None:
    makers = ActorMakers(TemplateGenerator(spacing=0.2, style="estate"), BoxLidarSegmenter())
    log = with_more_cameras(street)
    actor = make_actor(log, "7", makers, 0, tmp_path, SceneConfig(cameras=("half", "most")))
    assert actor.provenance.camera == "most"
