from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from recast.core.errors import InputError
from recast.reporting import VideoWriter, draw_frames, read_video, side_by_side, write_video
from recast.reporting.video import film_frames
from reporting.made_up_rollouts import cut_in, straight_map


def film(frames: int, height: int = 60, width: int = 80, seed: int = 0) -> list[np.ndarray]:
    """A smooth moving picture."""
    rng = np.random.default_rng(seed)
    base = cv2.resize(rng.integers(0, 255, (5, 6, 3), dtype=np.uint8), (width, height))
    return [np.roll(base, 2 * k, axis=1) for k in range(frames)]


def test_frames_come_back(tmp_path: Path) -> None:
    sent = film(12)
    write_video(tmp_path / "a.mp4", sent)
    back, fps = read_video(tmp_path / "a.mp4")
    assert back.shape == (12, 60, 80, 3)
    assert fps == 10.0
    error = back.astype(float) - np.stack(sent)
    assert 10 * np.log10(255**2 / np.mean(error**2)) > 32.0


@pytest.mark.parametrize("colour", [(200, 30, 60), (20, 180, 90), (240, 240, 240), (0, 0, 0)])
def test_colours_are_kept(tmp_path: Path, colour: tuple[int, int, int]) -> None:
    write_video(tmp_path / "a.mp4", [np.full((32, 32, 3), colour, np.uint8)])
    back, _ = read_video(tmp_path / "a.mp4")
    np.testing.assert_allclose(back.mean(axis=(0, 1, 2)), colour, atol=3)


def test_odd_sizes_gain_a_row_and_a_column(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", film(2, 33, 47))
    back, _ = read_video(tmp_path / "a.mp4")
    assert back.shape == (2, 34, 48, 3)
    np.testing.assert_allclose(back[0, 33].astype(int), back[0, 32].astype(int), atol=12)


def test_same_frames_same_bytes(tmp_path: Path) -> None:
    # Drawings with flat areas, and heap contents that change between encodings: x264's macroblock
    # tree gives other bytes almost each time under these.
    frames = list(draw_frames(cut_in(steps=8), straight_map()))
    rng = np.random.default_rng(0)
    contents = set()
    for _ in range(4):
        heap = [rng.random(int(size)) for size in rng.integers(1, 500_000, 20)]
        write_video(tmp_path / "a.mp4", frames)
        contents.add((tmp_path / "a.mp4").read_bytes())
        del heap
    assert len(contents) == 1


def test_an_error_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="renderer"), VideoWriter(tmp_path / "a.mp4") as writer:
        writer.add(film(1)[0])
        raise RuntimeError("renderer")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_film_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        write_video(tmp_path / "a.mp4", [])
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_film_survives_a_failed_one(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", film(2))
    before = (tmp_path / "a.mp4").read_bytes()
    with pytest.raises(ValueError, match="as in the first frame"):
        write_video(tmp_path / "a.mp4", [*film(1), film(1, 62, 80)[0]])
    assert (tmp_path / "a.mp4").read_bytes() == before


def test_other_arrays_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="uint8"):
        write_video(tmp_path / "a.mp4", [film(1)[0].astype(np.float32)])


def test_reading_something_else_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("no film")
    with pytest.raises(InputError, match=r"a\.mp4: video"):
        read_video(tmp_path / "a.mp4")
    with pytest.raises(InputError, match="is missing"):
        read_video(tmp_path / "b.mp4")


def test_side_by_side_holds_the_last_frame_of_the_shorter(tmp_path: Path) -> None:
    write_video(tmp_path / "left.mp4", [np.full((40, 60, 3), v, np.uint8) for v in (10, 60, 110)])
    write_video(tmp_path / "right.mp4", [np.full((20, 30, 3), 200, np.uint8)])
    films = [tmp_path / "left.mp4", tmp_path / "right.mp4"]
    side_by_side(films, tmp_path / "out.mp4", ("a", "b\nc"))
    back, _ = read_video(tmp_path / "out.mp4")
    assert len(back) == 3
    picture = back[:, -40:]
    assert picture.shape[2] == 60 + 4 + 60  # the right one scaled to the left one's height
    np.testing.assert_allclose(picture[:, 10:30, 10:50].mean(axis=(1, 2, 3)), [10, 60, 110], atol=4)
    np.testing.assert_allclose(picture[:, 10:30, 74:114].mean(axis=(1, 2, 3)), 200, atol=4)


def test_side_by_side_refuses_different_rates(tmp_path: Path) -> None:
    write_video(tmp_path / "left.mp4", film(2), fps=10)
    write_video(tmp_path / "right.mp4", film(2), fps=20)
    with pytest.raises(InputError, match="frame rate"):
        films = [tmp_path / "left.mp4", tmp_path / "right.mp4"]
        side_by_side(films, tmp_path / "o.mp4", ("a", "b"))
    assert not (tmp_path / "o.mp4").exists()


def test_side_by_side_begins_a_row_after_four_films(tmp_path: Path) -> None:
    films = [tmp_path / f"{value}.mp4" for value in (20, 60, 100, 140, 180)]
    for path in films:
        write_video(path, [np.full((40, 60, 3), int(path.stem), np.uint8)])
    side_by_side(films, tmp_path / "out.mp4", "abcde")
    [picture] = read_video(tmp_path / "out.mp4")[0]
    assert picture.shape == (2 * (28 + 40), 4 * 60 + 3 * 4, 3)
    middles = [picture[48, 30 + 64 * i].mean() for i in range(4)]
    np.testing.assert_allclose(middles, [20, 60, 100, 140], atol=4)
    np.testing.assert_allclose([picture[116, 30].mean(), picture[116, 94].mean()], [180, 0], atol=4)


def test_single_frames_are_those_of_the_film(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [np.full((40, 60, 3), v, np.uint8) for v in (10, 60, 110, 200)])
    found = film_frames(tmp_path / "a.mp4", [2, 0, 9])
    assert {step: round(float(frame.mean())) for step, frame in found.items()} == {
        0: pytest.approx(10, abs=3),
        2: pytest.approx(110, abs=3),
        9: pytest.approx(200, abs=3),
    }
