"""How well a scene redraws images it was not trained on, and views that the log does not have.

What an evaluation found is kept in memory and as eval.json.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast.arrays import Array, Image
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.files import atomic_file, folder_name, write_json
from recast.geometry import boxes, se3
from recast.logs import DrivingLog
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.scores import (
    DepthScore,
    Distance,
    RegionScore,
    SweepsOfImages,
    capped_psnr,
    depth_score,
    mean_depth,
    mean_score,
    moving_region,
    moving_tracks,
    psnr,
    score_regions,
)
from recast.reconstruction.views import (
    TrainingView,
    camera_names,
    is_held_out,
    read_view,
    scaled_camera,
    visible_rectangle,
)
from recast.scene.street_scene import (
    GapMeter,
    SceneImage,
    SceneRasterizer,
    StreetScene,
    ViewGaps,
    pose_at,
)

CAMERA_CLEARANCE_M = 0.3
"""Between a shifted camera and any labelled box."""
EVALUATION_VERSION = 4
"""2 has all members of 1, and lpips, moving, depth, shifts and shift_truth; 3 a picture a frame; 4
gaps."""


@dataclass(frozen=True)
class ViewShift:
    """A change of the ego's pose in its own frame, at the rear axle.

    Attributes:
        lateral_m: metres to the left.
        yaw_deg: degrees, counter-clockwise from above.
    """

    lateral_m: float = 0.0
    yaw_deg: float = 0.0

    @property
    def name(self) -> str:
        """Name of files and rows, such as "left-2m" or "turned-right-5deg"."""
        parts = []
        if self.lateral_m:
            parts.append(f"{'left' if self.lateral_m > 0 else 'right'}-{abs(self.lateral_m):g}m")
        if self.yaw_deg:
            side = "left" if self.yaw_deg > 0 else "right"
            parts.append(f"turned-{side}-{abs(self.yaw_deg):g}deg")
        return "-".join(parts) or "logged"

    @property
    def rig_from_shifted(self) -> Array:
        """(4, 4)."""
        rotation = se3.rotation_z(np.deg2rad(self.yaw_deg))
        return se3.from_rotation_translation(rotation, np.array([0.0, self.lateral_m, 0.0]))


SHIFTS: tuple[ViewShift, ...] = (
    *(ViewShift(lateral_m=metres) for metres in (1.0, -1.0, 2.0, -2.0, 3.0, -3.0)),
    *(ViewShift(yaw_deg=degrees) for degrees in (5.0, -5.0, 10.0, -10.0)),
)
"""A lane's width to either side, and the yaw that changing lanes takes."""


def picture_name(camera_name: str, frame: int) -> str:
    """File name of a picture of one view: the camera's name as far as it can stand in one."""
    return f"{folder_name(camera_name)}_{frame:06d}.png"


@dataclass(frozen=True)
class ShiftedView(TrainingView):
    """A view that the log does not have: a logged one from the shifted ego.

    Attributes:
        shift: shift of the ego. Camera name, frame and time are those of the logged view; the pose
            `world_from_camera` (4, 4) is shifted.
    """

    shift: ViewShift = ViewShift()

    @property
    def picture(self) -> str:
        """File below the evaluation's folder."""
        return f"shifts/{self.shift.name}/{picture_name(self.camera_name, self.frame)}"


Truth = Callable[[Sequence[ShiftedView]], Iterator[Image]]
"""What the cameras of shifted views truly see: (H, W, 3) uint8 each, in their order."""


@dataclass(frozen=True)
class ShiftedScore:
    """Scores of one shifted view.

    Attributes:
        camera, frame, timestamp_us: the logged view that it was.
        moving: scores inside the boxes of moving objects, or None where too little moves.
    """

    camera: str
    frame: int
    timestamp_us: int
    whole: RegionScore
    moving: RegionScore | None


@dataclass(frozen=True)
class ShiftScores:
    """All views with one shift of the ego.

    Attributes:
        frames: scores; none where the truth is not known.
        pictures: files below the evaluation's folder.
        gaps: mean over images; None for a scene that was imported, which does not tell.
    """

    shift: ViewShift
    frames: tuple[ShiftedScore, ...]
    pictures: tuple[str, ...]
    gaps: ViewGaps | None = None

    @property
    def whole(self) -> RegionScore | None:
        """Mean over images; None where the truth is not known."""
        return mean_score([frame.whole for frame in self.frames])

    @property
    def moving(self) -> RegionScore | None:
        """Mean over images in which something moves."""
        return mean_score([frame.moving for frame in self.frames if frame.moving is not None])


def shifted_views(
    log: DrivingLog, frames: Sequence[tuple[str, int]], scale: float, shift: ViewShift
) -> list[ShiftedView]:
    """Logged views from the shifted ego, but for those whose camera would be inside a labelled box.

    Args:
        frames: camera and frame of each.
        scale: scale of the images.
    """
    found = []
    for name, frame in frames:
        stream = log.cameras[name]
        timestamp_us = int(stream.timestamps_us[frame])
        world_from_rig = log.world_from_rig.at(timestamp_us) @ shift.rig_from_shifted
        pose = world_from_rig @ stream.rig_from_camera
        if not _inside_a_box(log, pose[:3, 3], timestamp_us):
            place = (name, frame, timestamp_us, scaled_camera(stream.camera, scale), pose)
            found.append(ShiftedView(*place, held_out=True, shift=shift))
    return found


def _inside_a_box(log: DrivingLog, point: Array, timestamp_us: int) -> bool:
    for track in log.tracks.values():
        pose = pose_at(track.trajectory, timestamp_us)
        if pose is None:
            continue
        if boxes.contains(point[None], track.size, pose, CAMERA_CLEARANCE_M)[0]:
            return True
    return False


@dataclass(frozen=True)
class FrameScore:
    """Scores of one held-out image.

    Attributes:
        whole: scores over all usable pixels.
        boxes: PSNR in dB inside the rectangle around each visible actor's projected box.
        moving: scores inside the boxes of all that moves, length and width times 1.5; None where
            too little moves.
        depth: depth scores against the LiDAR; None where the log has no sweep then.
    """

    camera: str
    frame: int
    timestamp_us: int
    whole: RegionScore
    boxes: Mapping[str, float]
    moving: RegionScore | None
    depth: DepthScore | None


@dataclass(frozen=True)
class SceneEvaluation:
    """Scores of all held-out images; means are over images, and over (image, actor) for boxes.

    Attributes:
        frames: held-out images.
        shifts: views beside the drive; none where they were not asked for.
        shift_truth: whether the shifted views were compared with the truth.
        gaps: mean over the held-out images; None for a scene that was imported.
    """

    frames: tuple[FrameScore, ...]
    shifts: tuple[ShiftScores, ...] = ()
    shift_truth: bool = False
    gaps: ViewGaps | None = None

    @property
    def whole(self) -> RegionScore:
        """Mean over the images."""
        found = mean_score([frame.whole for frame in self.frames])
        if found is None:
            raise ValueError("SceneEvaluation: no image was scored")
        return found

    @property
    def psnr(self) -> float:
        """Mean PSNR in dB."""
        return self.whole.psnr

    @property
    def ssim(self) -> float:
        """Mean SSIM."""
        return self.whole.ssim

    @property
    def lpips(self) -> float | None:
        """Mean LPIPS; None where no weights were given."""
        return self.whole.lpips

    @property
    def box_psnr(self) -> float | None:
        """Mean PSNR in dB inside the actors' boxes; None where no actor is seen."""
        values = [value for frame in self.frames for value in frame.boxes.values()]
        return float(np.mean(values)) if values else None

    def box_psnr_by_track(self) -> dict[str, float]:
        """Mean PSNR in dB inside each actor's box."""
        tracks = sorted({track for frame in self.frames for track in frame.boxes})
        return {
            track: float(np.mean([f.boxes[track] for f in self.frames if track in f.boxes]))
            for track in tracks
        }

    @property
    def moving(self) -> RegionScore | None:
        """Mean over the images in which something moves: PSNR*, SSIM* and LPIPS*."""
        return mean_score([frame.moving for frame in self.frames if frame.moving is not None])

    @property
    def depth(self) -> DepthScore | None:
        """Mean over the images with LiDAR."""
        return mean_depth([frame.depth for frame in self.frames if frame.depth is not None])

    def to_json(self) -> dict[str, Any]:
        """The contents of eval.json; a frame's `picture` is its file, if pictures are written."""
        return {
            "version": EVALUATION_VERSION,
            "psnr": self.psnr,
            "ssim": self.ssim,
            "lpips": self.lpips,
            "box_psnr": self.box_psnr,
            "box_psnr_by_track": self.box_psnr_by_track(),
            "moving": _plain(self.moving),
            "depth": _plain(self.depth),
            "gaps": _plain(self.gaps),
            "frames": [
                _frame(frame, picture=picture_name(frame.camera, frame.frame))
                for frame in self.frames
            ],
            "shift_truth": self.shift_truth,
            "shifts": [_shift(scores) for scores in self.shifts],
        }


def _shift(scores: ShiftScores) -> dict[str, Any]:
    return {
        "name": scores.shift.name,
        **asdict(scores.shift),
        "whole": _plain(scores.whole),
        "moving": _plain(scores.moving),
        "gaps": _plain(scores.gaps),
        "frames": [_frame(frame) for frame in scores.frames],
        "pictures": list(scores.pictures),
    }


def _frame(frame: FrameScore | ShiftedScore, **more: str) -> dict[str, Any]:
    values = asdict(frame)
    image = {name: values.pop(name) for name in ("camera", "frame", "timestamp_us")}
    return {**image, **more, **values.pop("whole"), **values}


def _plain(score: RegionScore | DepthScore | ViewGaps | None) -> dict[str, Any] | None:
    return None if score is None else asdict(score)


MIN_BOX_PX = 8
"""Boxes with a shorter edge than this in the image are not scored: too few pixels."""
EVALUATION_FILE = "eval.json"
PICTURED_MOMENTS = 3
"""Held-out moments, spread over the drive, at which shifted views are written as pictures."""


def evaluate_scene(
    scene: StreetScene,
    log: DrivingLog,
    config: SceneConfig,
    out: str | Path | None = None,
    *,
    lpips: Distance | None = None,
    shifts: Sequence[ViewShift] = (),
    truth: Truth | None = None,
    progress: Progress | None = None,
) -> SceneEvaluation:
    """Score the held-out images of a log, and views from beside its drive.

    Args:
        config: the configuration of the training, for cameras, scale and split.
        out: folder for eval.json (no timings: equal runs give equal bytes) and, for each held-out
            image and some shifted ones, a PNG with truth, rendering and three times their
            difference.
        lpips: a distance by networks, scored too.
        shifts: shifts of the ego at the held-out moments.
        truth: what shifted cameras truly see. Without it no shifted view is scored: `out` gets
            pictures of what the scene makes of them.

    Raises:
        InputError: the configuration holds no image out from training.
    """
    chosen = held_out_frames(log, config)
    if not chosen:
        raise InputError(
            "configuration", "holdout_every", "holds no image out", "set it to 8 and train again"
        )
    folder = None if out is None else Path(out)
    pictured = _pictured(log, chosen)
    planned = [shifted_views(log, chosen, config.scale, shift) for shift in shifts]
    if truth is None:
        planned = [[v for v in views if v.timestamp_us in pictured] for views in planned]
    total = len(chosen) + sum(len(views) for views in planned)
    done = iter(range(1, total + 1))
    scorer = ViewScorer(scene, log, lpips)
    scores = {}
    gaps = GapMeter(scene)
    logged_gaps = []
    # In order of time: all cameras of a moment share its sweeps.
    for name, frame in sorted(chosen, key=lambda image: _time(log, image)):
        view = read_view(log, log.cameras[name], frame, config.scale, held_out=True)
        rendered = draw_view(scorer.rasterizer, scene, view)
        scores[name, frame] = scorer.held_out(view, rendered)
        logged_gaps.append(_gaps(gaps, scene, view))
        if folder is not None:
            write_comparison(folder / picture_name(name, frame), view, rendered.rgb)
        tell(progress, next(done), total)
    found = []
    for shift, views in zip(shifts, planned, strict=True):
        seen = iter(()) if truth is None else truth(views)
        frames, pictures, shifted_gaps = [], [], []
        for shifted in views:
            shown = folder is not None and shifted.timestamp_us in pictured
            score = scorer.shifted(shifted, next(seen, None), folder if shown else None)
            frames += [score] if score is not None else []
            shifted_gaps.append(_gaps(gaps, scene, shifted))
            pictures += [shifted.picture] if shown else []
            tell(progress, next(done), total)
        mean = ViewGaps.mean(shifted_gaps)
        found.append(ShiftScores(shift, tuple(frames), tuple(pictures), mean))
    frames_scored = tuple(scores[image] for image in chosen)
    compared = bool(found) and truth is not None
    evaluation = SceneEvaluation(frames_scored, tuple(found), compared, ViewGaps.mean(logged_gaps))
    if folder is not None:
        write_json(folder / EVALUATION_FILE, evaluation.to_json())
    return evaluation


def held_out_frames(log: DrivingLog, config: SceneConfig) -> list[tuple[str, int]]:
    """Camera and frame of every image that is kept from training."""
    return [
        (name, frame)
        for name in camera_names(log, config)
        for frame in range(len(log.cameras[name].timestamps_us))
        if is_held_out(frame, config)
    ]


def held_out_psnr(scene: StreetScene, views: Sequence[TrainingView]) -> float:
    """Mean PSNR in dB over the usable pixels of views."""
    rasterizer = SceneRasterizer(scene)
    found = []
    for view in views:
        drawn, wanted = draw_view(rasterizer, scene, view).rgb, view.image / 255.0
        usable = slice(None) if view.mask is None else view.mask
        found.append(psnr(drawn[usable], wanted[usable]))
    return float(np.mean(found))


def _time(log: DrivingLog, image: tuple[str, int]) -> int:
    name, frame = image
    return int(log.cameras[name].timestamps_us[frame])


def _pictured(log: DrivingLog, chosen: Sequence[tuple[str, int]]) -> set[int]:
    """Times of `PICTURED_MOMENTS` held-out frames of each camera."""
    times: set[int] = set()
    for name in dict.fromkeys(name for name, _ in chosen):
        frames = [frame for other, frame in chosen if other == name]
        count = min(PICTURED_MOMENTS, len(frames))
        picked = [frames[int((i + 0.5) / count * len(frames))] for i in range(count)]
        times.update(_time(log, (name, frame)) for frame in picked)
    return times


class ViewScorer:
    """Draws and scores views of one scene.

    Args:
        log: log that the views are from.
        lpips: a distance by networks, or None.
    """

    def __init__(self, scene: StreetScene, log: DrivingLog, lpips: Distance | None) -> None:
        self.rasterizer = SceneRasterizer(scene)
        self._scene, self._moving, self._lpips = scene, moving_tracks(log), lpips
        self._sweeps = SweepsOfImages(log, self._moving)

    def held_out(self, view: TrainingView, rendered: SceneImage) -> FrameScore:
        """Score a held-out image against its recording and the LiDAR of its moment.

        Sweeps are read once where images come in order of time.
        """
        scene, time = self._scene, view.timestamp_us
        region = moving_region(self._moving, view)
        whole, moving = score_regions(rendered.rgb, view, region, self._lpips)
        # The laser's points are looked at from where the image was drawn from.
        pose = scene.corrected_camera(view.camera_from_world, view.camera_name, time)
        drawn_from = replace(view, world_from_camera=se3.inverse(pose))
        return FrameScore(
            camera=view.camera_name,
            frame=view.frame,
            timestamp_us=time,
            whole=whole,
            boxes=_box_psnr(scene, view, rendered.rgb),
            moving=moving,
            depth=depth_score(rendered, drawn_from, self._sweeps.at(time), self._moving),
        )

    def shifted(
        self, shifted: ShiftedView, true: NDArray[np.uint8] | None, folder: Path | None
    ) -> ShiftedScore | None:
        """Score a view where its truth is known; with a folder, write its picture."""
        camera = shifted.camera
        blank = np.zeros((camera.height, camera.width, 3), np.uint8)
        view = replace(shifted, image=blank if true is None else true)
        rgb = draw_view(self.rasterizer, self._scene, view).rgb
        if true is None:
            if folder is not None:
                _write_png(folder / shifted.picture, rgb)
            return None
        if folder is not None:
            write_comparison(folder / shifted.picture, view, rgb)
        region = moving_region(self._moving, view)
        whole, moving = score_regions(rgb, view, region, self._lpips)
        return ShiftedScore(view.camera_name, view.frame, view.timestamp_us, whole, moving)


def _gaps(meter: GapMeter, scene: StreetScene, view: TrainingView) -> ViewGaps | None:
    pose = scene.corrected_camera(view.camera_from_world, view.camera_name, view.timestamp_us)
    return meter.measure(view.camera, pose, scene.actor_poses(view.timestamp_us), view.mask)


def draw_view(rasterizer: SceneRasterizer, scene: StreetScene, view: TrainingView) -> SceneImage:
    """A view redrawn: camera corrected, exposed as it was, actors where they were; unusable pixels
    as recorded."""
    pose = scene.corrected_camera(view.camera_from_world, view.camera_name, view.timestamp_us)
    poses = scene.actor_poses(view.timestamp_us)
    time = view.timestamp_us
    exposure = scene.exposure(view.camera_name, time)
    image = rasterizer.render(view.camera, pose, poses, time, time, exposure)
    if view.mask is None:
        return image
    recorded = view.image.astype(np.float32) / 255
    return replace(image, rgb=np.where(view.mask[..., None], image.rgb, recorded))


def _box_psnr(
    scene: StreetScene, view: TrainingView, rendered: NDArray[np.float32]
) -> dict[str, float]:
    recorded = view.image.astype(np.float64) / 255
    found = {}
    for track_id, pose in scene.actor_poses(view.timestamp_us).items():
        rectangle = visible_rectangle(scene.actors[track_id].size, pose, view)
        if rectangle is None:
            continue
        left, top = np.floor(rectangle[:2]).astype(int)
        right, bottom = np.ceil(rectangle[2:]).astype(int)
        if min(right - left, bottom - top) >= MIN_BOX_PX:
            inside = (slice(top, bottom), slice(left, right))
            found[track_id] = capped_psnr(rendered[inside], recorded[inside])
    return found


def write_comparison(path: Path, view: TrainingView, rendered: NDArray[np.float32]) -> None:
    """A PNG with the view's image, what was rendered, and three times their difference."""
    true = view.image.astype(np.float32) / 255
    difference = np.clip(3 * np.abs(rendered - true), 0, 1)
    _write_png(path, np.concatenate([true, rendered, difference], axis=0))


def _write_png(path: Path, image: NDArray[np.float32]) -> None:
    with atomic_file(path) as partial:
        PilImage.fromarray((image * 255 + 0.5).astype(np.uint8)).save(partial, format="PNG")
