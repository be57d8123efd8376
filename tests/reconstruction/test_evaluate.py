from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from recast.core.errors import InputError
from recast.logs import DrivingLog, LidarSweep
from recast.logs.types import SweepSource
from recast.reconstruction import SHIFTS, SceneConfig, TrainResult, evaluate_scene, psnr
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import read_view
from recast.scene import SceneRasterizer, StreetScene, load_scene
from recast.scene.street_scene import GapMeter, ViewGaps
from support.tiny_street import TINY


def test_scores_pictures_and_repeatability(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    result = evaluate_scene(trained.scene, tiny_log, TINY, tmp_path / "a")
    assert [frame.frame for frame in result.frames] == [3, 11, 19]
    assert result.psnr == pytest.approx(trained.history[-1]["held_out_psnr"], abs=1e-9)
    record = json.loads((tmp_path / "a" / "eval.json").read_text())
    assert record["psnr"] == result.psnr and record["ssim"] == result.ssim
    assert 0.5 < result.ssim < 1.0
    assert set(result.box_psnr_by_track()) == {"0", "1"}
    assert record["version"] == 4 and record["shifts"] == [] and record["lpips"] is None
    for frame, written in zip(result.frames, record["frames"], strict=True):
        assert written["psnr"] == frame.whole.psnr and written["ssim"] == frame.whole.ssim
        assert written["boxes"] == frame.boxes
    assert result.moving is not None and record["moving"]["psnr"] == result.moving.psnr
    assert result.depth is not None and record["depth"]["points"] == result.depth.points > 300
    assert result.depth.median_abs_m < 0.5 and result.depth.missing < 0.2
    assert 80 < result.depth.lag_ms < 120  # odd frames have no sweep of their own

    picture = np.asarray(Image.open(tmp_path / "a" / "image_02_000003.png")) / 255.0
    recorded, rendered, _ = np.split(picture, 3)
    assert psnr(rendered, recorded) == pytest.approx(result.frames[0].whole.psnr, abs=0.05)

    evaluate_scene(load_scene(trained.folder), tiny_log, TINY, tmp_path / "b")
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


HOSTILE = (
    "../x",
    "/etc/x",
    "a/b",
    "a\\b",
    "a\0b",
    "a\nb",
    "x" * 300,
    "\u202egnp.x",
    "<script>",
    ".",
    "..",
    "con",
    "",
    "A",
    "a",
)


def test_camera_names_never_become_paths(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    """Pictures stay in their folder; the record says which camera each shows."""
    stream = tiny_log.cameras["image_02"]
    cameras = {name: replace(stream, name=name) for name in HOSTILE}
    log = replace(tiny_log, cameras=cameras)
    config = TINY.model_copy(update={"holdout_every": 1000})
    evaluate_scene(trained.scene, log, config, tmp_path / "e" / "eval", shifts=SHIFTS[:1])
    record = json.loads((tmp_path / "e" / "eval" / "eval.json").read_text())
    named = {frame["camera"]: frame["picture"] for frame in record["frames"]}
    assert set(named) == set(HOSTILE) and len(set(named.values())) == len(HOSTILE)
    shifted = record["shifts"][0]["pictures"]
    wanted = {"eval.json", *named.values(), *shifted}
    files = [path for path in (tmp_path / "e").rglob("*") if path.is_file()]
    assert {str(path.relative_to(tmp_path / "e" / "eval")) for path in files} == wanted
    assert all(re.fullmatch(r"[\w.+~-]+", path.name) for path in files)
    assert [path.name for path in tmp_path.iterdir()] == ["e"]


def test_box_score_looks_at_the_actor_only(trained: TrainResult, tiny_log: DrivingLog) -> None:
    whole = evaluate_scene(trained.scene, tiny_log, TINY)
    actor = trained.scene.actors["0"]
    faint = replace(
        actor.gaussians, logit_opacities=actor.gaussians.logit_opacities - 8
    )  # as good as gone
    broken = evaluate_scene(
        trained.scene.with_actor(replace(actor, gaussians=faint)), tiny_log, TINY
    )
    before, after = whole.box_psnr_by_track()["0"], broken.box_psnr_by_track()["0"]
    assert before - after > 2 * max(0.1, whole.psnr - broken.psnr)


def test_a_distance_by_networks_is_asked_for_every_image(
    trained: TrainResult, tiny_log: DrivingLog
) -> None:
    def distance(image: np.ndarray, reference: np.ndarray) -> float:
        return float(np.abs(image - reference).mean())

    result = evaluate_scene(trained.scene, tiny_log, TINY, lpips=distance)
    assert result.lpips is not None and 0 < result.lpips < 0.3
    assert result.moving is not None and result.moving.lpips is not None
    assert all(frame.whole.lpips is not None for frame in result.frames)


class CountedSweeps:
    """Sweeps of a log, and how often one of them was read."""

    def __init__(self, sweeps: SweepSource) -> None:
        self._sweeps, self.reads = sweeps, 0

    def __len__(self) -> int:
        return len(self._sweeps)

    def __getitem__(self, index: int) -> LidarSweep:
        self.reads += 1
        return self._sweeps[index]


def test_a_sweep_is_read_once_for_all_cameras(trained: TrainResult, tiny_log: DrivingLog) -> None:
    alone = evaluate_scene(trained.scene, tiny_log, TINY)
    (name, stream), (lidar_name, lidar) = *tiny_log.cameras.items(), *tiny_log.lidars.items()
    sweeps = CountedSweeps(lidar.sweeps)
    twin = replace(stream, name="twin")  # another camera that sees the same
    log = replace(
        tiny_log,
        cameras={"twin": twin, name: stream},
        lidars={lidar_name: replace(lidar, sweeps=sweeps)},
    )
    both = evaluate_scene(trained.scene, log, TINY)
    assert sweeps.reads == len(alone.frames)
    assert [frame.camera for frame in both.frames] == ["twin"] * 3 + [name] * 3
    assert both.frames[3:] == alone.frames
    assert [frame.timestamp_us for frame in both.frames[:3]] == [
        frame.timestamp_us for frame in alone.frames
    ]
    assert both.depth is not None and alone.depth is not None
    assert both.depth.points > alone.depth.points


def test_nothing_held_out(trained: TrainResult, tiny_log: DrivingLog) -> None:
    with pytest.raises(InputError, match="holdout_every"):
        evaluate_scene(trained.scene, tiny_log, SceneConfig(scale=1.0, holdout_every=0))


def test_gaps_are_what_the_log_does_not_show(trained: TrainResult, tiny_log: DrivingLog) -> None:
    scene = trained.scene
    assert scene.unseen is not None and scene.sky_seen is not None
    assert scene.unseen.any() and not scene.unseen.all()
    opaque = scene.background.logit_opacities[scene.unseen].sigmoid()
    # All but what a vehicle covered, which stays as it was learned.
    as_made = torch.isclose(opaque, torch.tensor(INIT.unseen_opacity))
    assert as_made.float().mean() > 0.5
    assert not scene.background.sh[scene.unseen][~as_made][:, 1:].any()
    view = read_view(tiny_log, tiny_log.cameras["image_02"], 3, 1.0)
    everything = torch.ones_like(scene.unseen)
    surface = SceneRasterizer(replace(scene, actors={})).render(
        view.camera, view.camera_from_world, {}
    )
    solid = float((surface.alpha > 0.5).mean())

    def gaps(of: StreetScene) -> ViewGaps | None:
        return GapMeter(of).measure(view.camera, view.camera_from_world, {})

    whole = gaps(replace(scene, actors={}, unseen=everything))
    assert whole is not None and whole.invented == pytest.approx(solid, abs=0.02)
    bare = gaps(replace(scene, actors={}, sky_seen=torch.zeros_like(scene.sky_seen)))
    assert bare is not None and bare.empty == pytest.approx(1 - solid, abs=0.02)
    seen = gaps(scene)
    assert seen is not None and seen.invented < 0.05 and seen.empty < bare.empty
    background = {"parked": np.eye(4)}  # of traffic that the scene has no model of
    assert GapMeter(scene).measure(view.camera, view.camera_from_world, background) == seen
    assert gaps(replace(scene, unseen=None)) is None
    evaluation = evaluate_scene(scene, tiny_log, TINY)
    assert evaluation.gaps is not None
    assert evaluation.to_json()["gaps"]["invented"] == evaluation.gaps.invented
