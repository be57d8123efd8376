"""Hostile names of tracks and cameras through a whole run, its films, its report and a grid."""

from __future__ import annotations

import dataclasses
import json
from html.parser import HTMLParser
from pathlib import Path

import pytest
from rich.console import Console

import recast.runs.report
import recast.runs.sources
from recast.logs import DrivingLog
from recast.reporting.video import read_video
from recast.runs.arms import Arm
from recast.runs.config import resolve_config
from recast.runs.rollouts import films
from recast.runs.run import run
from recast.runs.run_folder import RunFolder, use_name
from recast.studies import parse_scenes

HOSTILE = (
    "../../x",
    "/absolute",
    "nul\0nul",
    "new\nline",
    "l" * 300,
    "\u202eright to left",
    "<script>alert(1)</script>",
    "[/bold]",
    "\x1b[2Jescape",
    "..",
    "con",
)
TRACK = "".join(HOSTILE)
ARMS = (
    Arm(name="../../x\0<script>alert(1)</script>[/bold]\x1b[2Jescape", vehicle="own"),
    Arm(name="/absolute/../\nnew line\u202eright to left", vehicle="generated"),
)


@pytest.fixture
def hostile(tiny_log: DrivingLog) -> DrivingLog:
    """The tiny drive with one camera under many names."""
    [camera] = tiny_log.cameras.values()
    return dataclasses.replace(
        tiny_log,
        name=HOSTILE[0] + HOSTILE[6],
        cameras={name: dataclasses.replace(camera, name=name) for name in HOSTILE},
        tracks={TRACK: dataclasses.replace(tiny_log.tracks["0"], track_id=TRACK)},
    )


class Page(HTMLParser):
    """Notes what a browser would run or fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.scripts, self.sources = 0, []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]


def test_a_run_with_hostile_names(
    hostile: DrivingLog,
    tiny_log_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in (recast.runs.sources, recast.runs.report):
        monkeypatch.setattr(module, "read_log", lambda path: hostile)
    monkeypatch.setattr("recast.runs.actor._TURNTABLE_VIEWS", 2)
    config = resolve_config(
        TRACK,
        ["advancing-a"],
        None,
        None,
        {
            "generator": "support.own_parts:Box",
            "planners": ("idm-follower",),
            "steps": 10,
            "threads": 1,
        },
        {"iterations": 4, "scale": 0.25, "threads": 1},
    )
    config = config.model_copy(update={"arms": ARMS})
    out = tmp_path / "deep" / "run"
    with (tmp_path / "shown").open("w", encoding="utf-8") as shown:
        page = run(tiny_log_folder, out, config, Console(file=shown, width=120))

    store = tmp_path / "deep" / "store"
    inside = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert all({out, store} & {*path.parents} or path.name == "shown" for path in inside)
    links = [path for path in out.rglob("*") if path.is_symlink()]
    artefacts = {path.parent / "data" for path in store.rglob("artefact.json")}
    assert {link.resolve() for link in links} == {path.resolve() for path in artefacts}
    assert not any(path.is_symlink() for path in store.rglob("*"))
    assert "\x1b" not in (tmp_path / "shown").read_text()

    folder = RunFolder.open(out)
    assert len(folder.record.artefacts) == len(links) == 7
    for arm in ARMS:
        use = use_name("rollout", "advancing-a", "idm-follower", arm.name)
        artefact = folder.artefact(folder.store(), use)
        assert artefact is not None
        found = films(artefact.path)
        assert tuple(found) == HOSTILE
        for film in found.values():
            assert len(read_video(film)[0]) == 10

    metrics = json.loads((out / "metrics.json").read_text())
    assert {one["track_id"] for one in metrics["rollouts"]} == {TRACK}
    assert [one["arm"] for one in metrics["rollouts"]] == [arm.name for arm in ARMS]
    text = page.read_text(encoding="utf-8")
    parsed = Page()
    parsed.feed(text)
    assert parsed.scripts == 1, "the page's own"
    for source in parsed.sources:
        assert source.startswith("#") or (page.parent / source).resolve().is_relative_to(
            page.parent
        )


def test_scenes_of_a_grid_with_hostile_names(
    hostile: DrivingLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two tracks whose names differ in what folders cannot hold are two scenes."""
    track = hostile.tracks[TRACK]
    both = dataclasses.replace(hostile, tracks={TRACK: track, TRACK.replace("/", "\\"): track})
    monkeypatch.setattr("recast.studies.grid.read_log", lambda path: both)
    ids = [parse_scenes([str(tmp_path)], 0, name)[0].id for name in both.tracks]
    assert len(set(ids)) == 2
    for name in ids:
        assert len(name) < 100 and (tmp_path / name).parent == tmp_path
        (tmp_path / name).mkdir()
