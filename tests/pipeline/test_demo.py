"""The demo at its smallest: a made-up drive, from nothing to a report against the truth."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from recast.core.errors import InputError
from recast.pipeline.run import DemoSize, demo
from recast.pipeline.sources import drive_log
from recast.reporting.video import read_video
from recast.synthetic import make_world

SCENE = "urban-straight"
TINY = DemoSize(2.0, 192, 128, ("front",), 40, ("cut-in-a",), 10, "idm-follower")


def run(out: Path, scene: str = SCENE, seed: int = 1, size: DemoSize = TINY) -> Path:
    console = Console(quiet=True)
    return demo(out, scene, seed, size, threads=1, console=console, generator="template")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "out"
    assert run(out) == out / "run" / "report" / "index.html"
    return out


def test_the_page_begins_with_one_moment_seen_three_ways(finished: Path) -> None:
    page = (finished / "run" / "report" / "index.html").read_text()
    first = page[: page.index("Overview")]
    for name in ("native actor", "replaced actor", "truth (oracle)"):
        assert name in first.lower()


def test_the_metrics_hold_all_arms_and_the_truth(finished: Path) -> None:
    metrics = json.loads((finished / "run" / "metrics.json").read_text())
    assert [r["arm"] for r in metrics["rollouts"]] == ["native", "replaced", "oracle"]
    assert metrics["failures"] == []
    beyond = [
        b for b in metrics["truth"]["replaced"]["summary"] if (b["low"], b["high"]) == (60, 180)
    ]
    # Even this little training gives the reconstructed actor no unseen side.
    assert beyond[0]["views"] > 4
    assert beyond[0]["candidate"]["mask_iou"] > beyond[0]["baseline"]["mask_iou"]


def test_the_oracle_films_what_the_cameras_would_see(finished: Path) -> None:
    folder = finished / "run" / "rollouts" / "cut-in-a" / "idm-follower"
    truth, _ = read_video(folder / "oracle" / "front.mp4")
    replaced, _ = read_video(folder / "replaced" / "front.mp4")
    assert truth.shape == replaced.shape == (10, 128, 192, 3)
    assert truth.std() > 20
    # The same street from the same place: unlike a black or a shifted picture.
    assert abs(truth.astype(float) - replaced.astype(float)).mean() < 30


def test_another_run_gives_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished / "log", tmp_path / "log")
    run(tmp_path)
    views, vehicle = "truth/replaced/views/oracle_views.json", "actors/replaced/actor/vehicle.ply"
    for name in ("metrics.json", views, vehicle):
        again = (tmp_path / "run" / name).read_bytes()
        assert again == (finished / "run" / name).read_bytes(), name


def test_what_is_there_is_used_again(finished: Path) -> None:
    files = {p: p.stat().st_mtime_ns for p in finished.rglob("*.mp4")}
    run(finished)
    assert {p: p.stat().st_mtime_ns for p in finished.rglob("*.mp4")} == files


def test_another_demo_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    world = make_world(SCENE, 1, TINY.seconds)
    size = TINY.width, TINY.height
    drive_log(world, tmp_path / "log", size, TINY.cameras, 1, Console(quiet=True))
    with pytest.raises(InputError, match="another drive"):
        run(tmp_path, seed=2)


def test_an_unknown_scene_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"moon.*urban-straight.*underpass"):
        run(tmp_path / "out", scene="moon")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("part", ["generator", "planner"])
def test_an_unknown_part_is_refused_before_anything_is_made(tmp_path: Path, part: str) -> None:
    console = Console(quiet=True)
    with pytest.raises(InputError, match="moon"):
        demo(tmp_path / "out", SCENE, 1, TINY, threads=1, console=console, **{part: "moon"})
    assert not (tmp_path / "out").exists()


def test_a_negative_number_of_threads_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="threads"):
        demo(tmp_path / "out", SCENE, 1, TINY, threads=-1, console=Console(quiet=True))
    assert not (tmp_path / "out").exists()
