"""The demo at its smallest: a made-up drive, from nothing to a report against the truth."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from rich.console import Console

import recast.runs.run as run_module
from recast.core.errors import InputError
from recast.metrics.rollout_metrics import RolloutMetrics
from recast.reporting.video import read_video
from recast.runs.arms import NOISES
from recast.runs.config import RunConfig
from recast.runs.run import DemoSize, decided, demo
from recast.runs.sources import drive_log
from recast.simulation import parse_motions
from recast.synthetic import make_world, world_metadata

SCENE = "urban-straight"
TINY = DemoSize(2.0, 192, 128, ("front",), 40, parse_motions("cut-in"), 10, "idm-follower")


def run(out: Path, scene: str = SCENE, seed: int = 1, size: DemoSize = TINY) -> Path:
    console = Console(quiet=True)
    return demo(out, scene, seed, size, threads=1, console=console, generator="template")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "out"
    assert run(out) == out / "run" / "report" / "index.html"
    return out


@pytest.mark.whole
def test_the_page_begins_with_one_moment_seen_three_ways(finished: Path) -> None:
    page = (finished / "run" / "report" / "index.html").read_text()
    first = page[: page.index("Overview")]
    for name in ("reconstructed vehicle", "replaced vehicle", "true vehicle"):
        assert name in first


@pytest.mark.whole
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


@pytest.mark.whole
def test_the_oracle_films_what_the_cameras_would_see(finished: Path) -> None:
    folder = finished / "run" / "rollouts" / "cut-in-a" / "idm-follower"
    truth, _ = read_video(folder / "oracle" / "front.mp4")
    replaced, _ = read_video(folder / "replaced" / "front.mp4")
    assert truth.shape == replaced.shape == (10, 128, 192, 3)
    assert truth.std() > 20
    # The same street from the same place: unlike a black or a shifted picture.
    assert abs(truth.astype(float) - replaced.astype(float)).mean() < 30


@pytest.mark.whole
def test_what_is_there_is_used_again(finished: Path) -> None:
    files = {p: p.stat().st_mtime_ns for p in finished.rglob("*.mp4")}
    run(finished)
    assert {p: p.stat().st_mtime_ns for p in finished.rglob("*.mp4")} == files


def test_another_demo_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    world = make_world(SCENE, 1, TINY.seconds)
    size = replace(TINY, width=48, height=32)
    drive_log(
        lambda: world,
        world_metadata(world),
        tmp_path / "log",
        (48, 32),
        TINY.cameras,
        1,
        Console(quiet=True),
    )
    with pytest.raises(InputError, match="another drive"):
        run(tmp_path, seed=2, size=size)


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


@dataclass
class Ending:
    """As much of `RolloutMetrics` as tells how a rollout ended: whether it collides, and where."""

    first_collision: int | None
    steps_run: int = 10

    def over(self, steps: int) -> Ending:
        hit = self.first_collision
        return Ending(hit if hit is not None and hit <= steps else None, steps)

    def same_verdict(self, other: Any) -> bool:
        return RolloutMetrics.same_verdict(cast(Any, self), other)

    @property
    def collision(self) -> Any:
        return SimpleNamespace(nc=SimpleNamespace(value=float(self.first_collision is None)))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A log alone, and its target: `finished` takes half a minute, maybe in each worker."""
    world = make_world(SCENE, 1, 1.0)
    path = tmp_path_factory.mktemp("drive") / "log"
    return drive_log(
        lambda: world, world_metadata(world), path, (48, 32), ("front",), 1, Console(quiet=True)
    ), world.target


@pytest.fixture
def choose(
    drive: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[tuple[str, ...], str]]:
    """Chooses settings for endings by setting and arm; others end in no collision."""
    log, track = drive

    def chosen(*motions: str, **endings: Ending | InputError) -> tuple[tuple[str, ...], str]:
        def scored(_: object, motion: str, planner: str, arm: Any) -> Ending:
            ending = endings.get(f"{motion} {arm.name}", Ending(None))
            if isinstance(ending, InputError):
                raise ending
            return ending

        monkeypatch.setattr(run_module, "_scored", scored)
        monkeypatch.setattr(run_module, "prepare", lambda setup: None)  # the drive is short
        config = RunConfig(track=track, motions=motions, planners=(TINY.planner,), threads=1)
        told = io.StringIO()
        names = decided(log, tmp_path, config, Console(file=told, width=200))
        return names, told.getvalue()

    return chosen


NOISY = tuple(f"oracle:{noise}" for noise in NOISES)
BOTH = ("cut-in-a", "cut-in-b", "cut-in-stop-a", "cut-in-stop-b")


def test_the_first_setting_of_each_motion_whose_truth_holds_under_noise_is_driven(
    choose: Callable[..., tuple[tuple[str, ...], str]],
) -> None:
    assert choose(*BOTH) == (("cut-in-a", "cut-in-stop-a"), "")
    names, told = choose(*BOTH, **{"cut-in-a oracle:grey": Ending(4)})
    assert names == ("cut-in-b", "cut-in-stop-a")
    assert "cut-in-a: the noise 'grey' changes the verdict of the truth" in told
    always = {f"cut-in-stop-a {arm}": Ending(4) for arm in ("oracle", *NOISY)}
    assert choose(*BOTH, **always)[0] == ("cut-in-a", "cut-in-stop-a")


def test_a_contact_after_the_end_of_a_shorter_rollout_is_no_other_ending(
    choose: Callable[..., tuple[tuple[str, ...], str]],
) -> None:
    assert choose(*BOTH, **{"cut-in-a oracle:start": Ending(12, 14)})[0][0] == "cut-in-a"


def test_without_a_setting_that_holds_the_first_one_that_can_be_driven_is(
    choose: Callable[..., tuple[tuple[str, ...], str]],
) -> None:
    flips = {f"{name} oracle:seed": Ending(4) for name in BOTH[:2]}
    names, told = choose(*BOTH, **flips)
    assert names[0] == "cut-in-a" and "cut-in-a is used anyway" in told
    refused = InputError("log", "length", "is too short", "record more")
    assert choose(*BOTH, **{**flips, "cut-in-a oracle": refused})[0][0] == "cut-in-b"
    with pytest.raises(InputError, match="too short"):
        choose(*BOTH, **{"cut-in-a oracle": refused, "cut-in-b oracle": refused})
