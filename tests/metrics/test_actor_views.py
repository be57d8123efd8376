"""Cases, scores and pictures of generated vehicles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.metrics.actor_scores import (
    ACTOR_COLUMNS,
    ScoredCutout,
    Window,
    drawn,
    framed,
    mean_scores,
    photographed,
    read_cases,
    score_view,
)
from recast.recar import begin_set, finish_set, regular_azimuths, write_identity
from recast.splats import CLASSIC
from recast.studies.sheets import ComparedView, comparison_sheet
from support.crops import RESERVED, SIZE, photograph, two_coloured_box, write_crops
from support.vehicle_sets import HEIGHT, WIDTH, identity_record, pictures, set_record


def write_set(folder: Path, identities: int = 4, views: int = 12, **changes: object) -> Path:
    """A set of which all are held out but the first."""
    record = set_record(identities, azimuths_deg=regular_azimuths(views), **changes)
    begin_set(folder, record, [f"car-{index}" for index in range(identities)])
    for index in range(identities):
        one = identity_record(index, split="train" if index == 0 else "held-out")
        write_identity(folder, record, one, [pictures(index)[view % 4] for view in range(views)])
    finish_set(folder, record)
    return folder


@pytest.fixture(scope="module")
def vehicle_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("sets") / "set")


def test_a_set_is_judged_on_held_out_identities(vehicle_set: Path) -> None:
    cases = read_cases(vehicle_set, seed=0)
    assert [case.id for case in cases] == ["car-1", "car-2", "car-3"]
    for case in cases:
        assert [view.azimuth_deg for view in case.targets] == pytest.approx([0, 90, 180, 270])
        (source,) = case.inputs
        assert source.name not in {view.name for view in case.targets}
        assert source.load().shape == (HEIGHT, WIDTH, 4)
        eye = -source.camera_from_actor[:3, :3].T @ source.camera_from_actor[:3, 3]
        assert np.linalg.norm(eye) == pytest.approx(8.0)
    assert cases[0].size == pytest.approx([4.6, 1.8, 1.5])


def test_inputs_are_drawn_by_seed_and_identity(vehicle_set: Path, tmp_path: Path) -> None:
    def inputs(folder: Path, seed: int) -> list[str]:
        return [case.inputs[0].name for case in read_cases(folder, seed)]

    assert inputs(vehicle_set, 0) == inputs(vehicle_set, 0)
    assert len({tuple(inputs(vehicle_set, seed)) for seed in range(8)}) > 3
    grown = write_set(tmp_path / "grown", identities=6)
    assert inputs(grown, 0)[:3] == inputs(vehicle_set, 0)
    assert [case.id for case in read_cases(grown, limit=2)] == ["car-1", "car-2"]


def test_a_set_of_the_four_targets_gives_up_one_of_them(tmp_path: Path) -> None:
    (case, *_) = read_cases(write_set(tmp_path / "four", views=4))
    assert len(case.targets) == 3
    assert case.inputs[0].name not in {view.name for view in case.targets}
    (case, *_) = read_cases(write_set(tmp_path / "thirty", views=30))
    # 90 and 270 degrees lie between two views of twelve degrees' step
    assert [round(view.azimuth_deg) for view in case.targets] == [0, 84, 180, 264]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fov_deg": None}, "camera: car-1: no camera without"),
        ({"views": 1}, "views: is 1"),
        ({"identities": 1}, "held-out: contains no vehicle"),
    ],
)
def test_sets_that_cannot_judge(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    folder = write_set(tmp_path / "set", **changes)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        read_cases(folder)


def test_folders_and_limits_that_are_refused(tmp_path: Path, vehicle_set: Path) -> None:
    with pytest.raises(InputError, match="is not a folder"):
        read_cases(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no set.json and no ID/input_views"):
        read_cases(tmp_path)
    with pytest.raises(InputError, match="`limit`: value: is 0"):
        read_cases(vehicle_set, limit=0)


def test_the_render_of_the_photographed_vehicle_scores_best(tmp_path: Path) -> None:
    """Cameras, masks and colours agree: the same Gaussians give the same picture."""
    (case,) = read_cases(write_crops(tmp_path / "crops"))
    assert case.size == pytest.approx(SIZE)
    vehicle = two_coloured_box()
    for view, where in zip(case.targets, RESERVED, strict=True):
        assert view.azimuth_deg == pytest.approx(where[0])
        truth = photographed(view.load())
        scores = score_view(drawn(vehicle, CLASSIC, view), truth)
        assert set(scores) == set(list(ACTOR_COLUMNS)[:4])
        assert scores["mask_iou"] == 1.0
        assert scores["psnr"] > 25  # rims of the hard mask against a soft alpha
        assert scores["ssim"] > 0.95
        other = score_view(drawn(replace(vehicle, means=vehicle.means * 0.8), CLASSIC, view), truth)
        assert all(other[key] < scores[key] for key in scores)


def test_scores_by_hand() -> None:
    """Half the vehicle drawn, its colour off by 0.1: mean squared errors add up by area."""
    truth = np.zeros((40, 50, 4), np.uint8)
    truth[10:30, 10:30] = (204, 204, 204, 255)
    alpha = np.zeros((40, 50))
    alpha[10:30, 10:20] = 1.0
    shown = ScoredCutout(np.repeat(alpha[..., None] * 0.7, 3, axis=2), alpha)
    scores = score_view(shown, photographed(truth))
    squares = 200 * 0.1**2 + 200 * 0.8**2
    assert scores["psnr"] == pytest.approx(-10 * np.log10(squares / 2000))
    assert scores["psnr_vehicle"] == pytest.approx(-10 * np.log10(squares / 400))
    assert scores["mask_iou"] == 0.5
    same = photographed(truth)
    assert score_view(same, same)["psnr"] == 100.0


def test_straight_alpha_is_multiplied_once() -> None:
    rgba = np.full((2, 2, 4), (200, 100, 50, 51), np.uint8)
    cutout = photographed(rgba)
    assert cutout.rgb[0, 0] == pytest.approx(np.array([200, 100, 50]) / 255 * 0.2)
    assert not cutout.mask.any()
    assert cutout.before(1.0)[0, 0, 2] == pytest.approx(50 / 255 * 0.2 + 0.8)


class Width:
    """A measure that tells how wide its images are."""

    def __init__(self, is_framed: bool) -> None:
        self.key, self.framed = "lpips", is_framed

    def __call__(self, image: np.ndarray, reference: np.ndarray) -> float:
        assert image.shape == reference.shape
        return float(image.shape[1])


def test_measures_see_the_whole_or_the_vehicle() -> None:
    truth = photographed(photograph(two_coloured_box(), 130.0, 4.0))
    assert score_view(truth, truth, [Width(False)])["lpips"] == 96.0
    width = np.ptp(np.flatnonzero(truth.mask.any(axis=0))) + 1
    assert score_view(truth, truth, [Width(True)])["lpips"] == pytest.approx(1.2 * width, abs=2)


@given(st.integers(0, 39), st.integers(0, 49), st.integers(1, 40), st.integers(1, 50))
def test_a_frame_is_a_square_that_holds_all_of_its_mask(
    top: int, left: int, height: int, width: int
) -> None:
    """At the image's edge too: what lies beyond is padded, nothing is cut."""
    mask = np.zeros((40, 50), bool)
    mask[top : top + height, left : left + width] = True
    window = framed(mask)
    seen = window.of(mask)
    assert seen.shape == (window.height, window.width) and window.height == window.width
    assert seen.sum() == mask.sum()
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    side = max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1
    # a tenth of the longer side is left free on every side; whole pixels cost up to one
    free = [*np.flatnonzero(seen.any(axis=1))[[0, -1]], *np.flatnonzero(seen.any(axis=0))[[0, -1]]]
    last = window.height - 1
    assert min(free[0], last - free[1], free[2], last - free[3]) > 0.1 * side - 1


def test_windows_far_from_the_image_are_empty() -> None:
    image = np.ones((4, 6, 3))
    for window in (
        Window(-9, 0, 5, 6),
        Window(0, -8, 4, 8),
        Window(4, 0, 2, 2),
        Window(0, 6, 2, 2),
    ):
        assert window.of(image).shape == (window.height, window.width, 3)
        assert window.of(image).sum() == 0


def test_means() -> None:
    assert mean_scores([{"psnr": 10.0, "ssim": 0.5}, {"psnr": 20.0, "ssim": 0.7}]) == (
        pytest.approx({"psnr": 15.0, "ssim": 0.6})
    )


def test_a_sheet_shows_what_was_compared() -> None:
    vehicle = photographed(photograph(two_coloured_box(), 130.0, 4.0))
    red = ScoredCutout(vehicle.alpha[..., None] * [1.0, 0.0, 0.0], vehicle.alpha)
    sheet = comparison_sheet("here", vehicle, [ComparedView("a", vehicle, vehicle)] * 2)
    changed = comparison_sheet("here", vehicle, [ComparedView("a", vehicle, red)] * 2)
    assert sheet.dtype == np.uint8 and sheet.shape == changed.shape
    quarter = sheet.shape[1] // 4
    columns = [sheet[60:, i * quarter : (i + 1) * quarter - 4] for i in range(4)]
    np.testing.assert_array_equal(columns[1][:200], columns[2][:200])  # the first row's tiles
    assert columns[0][-100:].min() == 255  # the input stands in the first row only
    assert columns[3][:150].max() == 0  # no difference
    assert changed[60:200, 3 * quarter : -4].max() > 100
    np.testing.assert_array_equal(changed[:, : 2 * quarter], sheet[:, : 2 * quarter])
    assert (
        changed[60:200, 2 * quarter : 3 * quarter] != sheet[60:200, 2 * quarter : 3 * quarter]
    ).any()


def test_further_inputs_show_other_sides(vehicle_set: Path) -> None:
    for one, several in zip(read_cases(vehicle_set), read_cases(vehicle_set, views=4), strict=True):
        assert several.inputs[0].name == one.inputs[0].name
        names = [view.name for view in (*several.inputs, *several.targets)]
        assert len(set(names)) == len(names) == 8
        first, second = (view.azimuth_deg for view in several.inputs[:2])
        # of twelve views those 90 degrees apart are targets: straight across is always free
        assert abs(first - second) == pytest.approx(180.0)
    everything = read_cases(vehicle_set, views=99)
    assert {len(case.inputs) for case in everything} == {8}
    with pytest.raises(InputError, match="`views`: value: is 0"):
        read_cases(vehicle_set, views=0)
