"""The sheet and the film of an actor, and the colours of its shares."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.actors import Actor, save_actor, turntable
from recast.actors.insert import coloured_by_shares
from recast.cli.main import main
from recast.core.images import wrapped
from recast.reporting import drawing, read_video
from recast.reporting.previews import draw_actor_sheet, turntable_frames
from reporting.made_up_actor import refined_actor

# Machado, Oliveira and Fernandes 2009: linear RGB as people see it who lack one kind of cone.
DEFICITS = {
    "none": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
FAR_APART = 10 * 2.3  # CIE Lab: ten times what is just noticeable


@pytest.fixture(scope="module")
def actor() -> Actor:
    return refined_actor()


@pytest.fixture(scope="module")
def sheet(actor: Actor) -> np.ndarray:
    return draw_actor_sheet(actor)


def lab(linear: np.ndarray) -> np.ndarray:
    xyz = XYZ @ linear.clip(0, 1) / [0.9505, 1.0, 1.089]
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("deficit", DEFICITS)
def test_the_colours_are_told_apart_by_everyone(deficit: str) -> None:
    linear = (np.array(list(drawing.SHARES.values())) / 255) ** 2.2
    seen = [lab(np.array(DEFICITS[deficit]) @ colour) for colour in linear]
    assert all(np.linalg.norm(a - b) > FAR_APART for a, b in combinations(seen, 2))


def test_each_side_has_the_colour_of_its_share(actor: Actor) -> None:
    colours = {name: np.array(colour) / 255 for name, colour in drawing.SHARES.items()}
    painted = coloured_by_shares(actor, [colour.tolist() for colour in colours.values()])
    ahead, left, behind, _ = turntable(
        painted, views=4, width=96, height=64, background=(0, 0, 0), with_shadow=False
    )
    for view, name in ((ahead, "invented"), (left, "mirrored"), (behind, "seen")):
        pixels = view[view.sum(axis=2) > 30] / 255
        hue = pixels / np.linalg.norm(pixels, axis=1, keepdims=True)
        nearest = [np.linalg.norm(hue - c / np.linalg.norm(c), axis=1) for c in colours.values()]
        counts = np.bincount(np.argmin(nearest, axis=0), minlength=3) / len(pixels)
        assert counts[list(colours).index(name)] > 0.6, name
    with pytest.raises(ValueError, match="no shares"):
        coloured_by_shares(replace(actor, shares=None), [[0.0, 0.0, 0.0]] * 3)


def test_the_sheet_shows_looks_and_shares(actor: Actor, sheet: np.ndarray) -> None:
    assert sheet.shape[1:] == (1600, 3) and sheet.dtype == np.uint8
    for colour in drawing.SHARES.values():  # the legend's squares, to the byte
        assert (sheet == colour).all(axis=2).sum() > 100
    np.testing.assert_array_equal(draw_actor_sheet(actor), sheet)


def test_an_actor_without_shares_has_a_sheet_too(actor: Actor, sheet: np.ndarray) -> None:
    story = actor.provenance.model_copy(update={"refinement": None, "candidates": ()})
    plain = draw_actor_sheet(replace(actor, shares=None, trajectory=None, provenance=story))
    assert sheet.shape[0] - plain.shape[0] > 2 * 225  # two rows of views fewer
    for colour in drawing.SHARES.values():
        assert not (plain == colour).all(axis=2).any()


def test_the_film_has_the_shares_below(actor: Actor) -> None:
    frames = list(turntable_frames(actor, 3, 64, 36))
    plain = list(turntable_frames(replace(actor, shares=None), 3, 64, 36))
    assert [frame.shape for frame in frames] == [(72, 64, 3)] * 3
    for frame, looks in zip(frames, plain, strict=True):
        np.testing.assert_array_equal(frame[:36], looks)
        assert np.abs(frame[36:].astype(int) - looks).mean() > 3


def test_text_is_broken_between_words() -> None:
    text = "one two three " * 9 + "x" * 80
    lines = wrapped(text, 17, 200)
    assert " ".join(lines) == text and len(lines) > 5
    assert lines[-1] == "x" * 80 and wrapped("", 17, 200) == [""]


def test_the_command(actor: Actor, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_actor(actor, tmp_path / "actor")
    assert main(["actor", "show", str(tmp_path / "actor")]) == 0
    with Image.open(tmp_path / "actor.png") as picture:
        assert picture.format == "PNG" and picture.width == 1600
    before = (tmp_path / "actor.png").read_bytes()
    for words, said in (
        ([str(tmp_path / "actor")], "actor.png: --out: exists already"),
        ([str(tmp_path / "actor"), "--out", str(tmp_path / "a.jpg")], "a.jpg: --out: is not a PNG"),
        ([str(tmp_path / "gone")], "actor.json"),
    ):
        capsys.readouterr()
        assert main(["actor", "show", *words]) == 2
        assert said in capsys.readouterr().err
    assert (tmp_path / "actor.png").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"actor", "actor.png"}


def test_the_film_of_the_command(
    actor: Actor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recast.runs.actor._TURNTABLE_VIEWS", 6)
    monkeypatch.setattr("recast.runs.actor._TURNTABLE_SIZE", (64, 36))
    save_actor(actor, tmp_path / "actor")
    film = tmp_path / "car.mp4"
    assert main(["actor", "turntable", str(tmp_path / "actor"), "--out", str(film)]) == 0
    assert read_video(film)[0].shape == (6, 72, 64, 3)
