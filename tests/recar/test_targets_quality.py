"""Views, cut-outs, the stand-in score and the aesthetic predictor."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from recast.core.errors import InputError
from recast.recar import regular_azimuths
from recast.recar.target_cache import Target
from recast.recar.target_maker import FilterSettings, contact_sheet, filter_record, open_score
from recast.recar.target_quality import (
    WIDTHS,
    AestheticScore,
    AgreementScore,
    TargetCandidate,
    largest_part,
    load_predictor,
    mirror_symmetry,
)
from recast.recar.target_views import (
    TargetCutout,
    Viewpoint,
    find_heading,
    framed,
    nearest_views,
    of_picture,
    render,
    resized,
)
from recast.splats import Gaussians
from support.vehicle_sets import set_record

RESOLUTION = 24


def test_views_nearest_to_the_four_sides_in_the_pipelines_order() -> None:
    assert nearest_views(set_record(azimuths_deg=regular_azimuths(4))) == (0, 2, 1, 3)
    thirty = set_record(azimuths_deg=regular_azimuths(30))
    assert nearest_views(thirty) == (0, 15, 7, 22)  # 84 and 264: the first of equally near ones
    shifted = set_record(azimuths_deg=tuple(a + 5 for a in regular_azimuths(8)))
    assert nearest_views(shifted) == (0, 4, 2, 6)
    for views in (1, 2, 3):
        with pytest.raises(InputError, match="no view is within"):
            nearest_views(set_record(azimuths_deg=regular_azimuths(views)))


def car() -> TargetCandidate:
    """Coloured voxels of a car with a red front and a cabin towards the rear, and its pictures."""
    x, y, z = np.meshgrid(*[np.arange(RESOLUTION)] * 3, indexing="ij")
    body = (x > 1) & (x < 22) & (y > 7) & (y < 16) & (z > 8) & (z < 13)
    cabin = (x > 3) & (x < 12) & (y > 8) & (y < 15) & (z >= 13) & (z < 17)
    coords = np.argwhere(body | cabin).astype(np.int32)
    colour = np.full((len(coords), 3), 0.5, np.float32)
    colour[coords[:, 0] > 18] = (0.9, 0.1, 0.1)
    gaussians = voxels(coords, colour)
    viewpoints = [Viewpoint(azimuth) for azimuth in (0.0, 180.0, 90.0, 270.0)]
    pictures = []
    for view in viewpoints:
        made = render(gaussians, view, 128)
        straight = made.rgb / np.maximum(made.alpha[..., None], 1e-3)
        rgba = np.dstack([np.clip(straight, 0, 1), made.alpha])
        pictures.append(np.rint(rgba * 255).astype(np.uint8))
    target = Target(
        np.zeros((8, 3, 3, 3), np.float32), coords, np.zeros((len(coords), 8), np.float32)
    )
    return TargetCandidate(target, gaussians, pictures, viewpoints)


def voxels(coords: np.ndarray, colour: np.ndarray) -> Gaussians:
    n = len(coords)
    return Gaussians(
        torch.from_numpy((coords + 0.5) / RESOLUTION - 0.5).float(),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.full((n, 3), float(np.log(0.5 / RESOLUTION))),
        torch.full((n,), 4.0),
        torch.from_numpy((colour - 0.5) / 0.28209479)[:, None].float(),
    )


def part(candidate: TargetCandidate, keep: np.ndarray) -> TargetCandidate:
    target = candidate.target
    rows = np.flatnonzero(keep)
    return replace(
        candidate,
        gaussians=candidate.gaussians.select(torch.from_numpy(rows)),
        target=Target(target.structure, target.coords[rows], target.latent[rows]),
    )


def test_a_target_that_shows_its_pictures_scores_high_and_rear_to_front_less() -> None:
    quality = AgreementScore()(car())
    assert quality.score > 0.9
    assert quality.parts["iou"] > 0.9 and quality.parts["symmetry"] == 1.0
    assert quality.flipped is not None and quality.flipped < quality.score - 0.1
    turn = torch.diag(torch.tensor([-1.0, -1.0, 1.0, 1.0]))
    one = car()
    turned = AgreementScore()(replace(one, gaussians=one.gaussians.transformed(turn)))
    assert turned.flipped == pytest.approx(quality.score, abs=0.01)
    assert turned.score == pytest.approx(quality.flipped, abs=0.01)


def looking(one: TargetCandidate, heading_deg: float) -> TargetCandidate:
    """The same vehicle as a model of any heading may make it."""
    angle = np.radians(heading_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = (RESOLUTION - 1) / 2
    coords = one.target.coords.copy()
    coords[:, :2] = np.rint((coords[:, :2] - middle) @ turn.T + middle)
    coords = np.unique(coords, axis=0)
    pose = torch.eye(4)
    pose[:2, :2] = torch.from_numpy(turn).float()
    return replace(
        one,
        gaussians=one.gaussians.transformed(pose),
        target=Target(one.target.structure, coords, np.zeros((len(coords), 8), np.float32)),
    )


@pytest.mark.parametrize("heading", [0.0, 23.0, 90.0, 137.0, 180.0, 271.0, 348.0])
def test_a_target_of_any_heading_is_judged_as_it_looks(heading: float) -> None:
    """Believed to look along +x it would be kept or rejected by chance."""
    good = AgreementScore()(car()).score
    one = looking(car(), heading)
    found = find_heading(one.gaussians, one.pictures, one.viewpoints)
    # A pixel of the cut-outs is some two degrees wide at a bumper.
    assert abs((found - heading + 180) % 360 - 180) < 3.0
    aligned = AgreementScore()(replace(one, heading_deg=found))
    # Voxels of a turned grid lie up to half a voxel off, and touch by corners.
    assert aligned.score > 0.9 * good
    assert aligned.flipped is not None and aligned.flipped < aligned.score - 0.1
    away = min(heading, 360 - heading)
    if away > 20:
        assert AgreementScore()(one).score < aligned.score - 0.1


def test_the_contact_sheet_shows_each_side_under_its_picture() -> None:
    straight = decoded(contact_sheet(car()))
    aligned = decoded(contact_sheet(replace(looking(car(), 137.0), heading_deg=137.0)))
    lost = decoded(contact_sheet(looking(car(), 137.0)))
    error = [float(np.abs(straight - other).mean()) for other in (aligned, lost)]
    assert error[0] < 0.25 * error[1]


def decoded(png: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(np.float32)


def test_nothing_to_see_has_a_heading_all_the_same() -> None:
    one = car()
    hidden = replace(one.gaussians, logit_opacities=torch.full((len(one.gaussians),), -20.0))
    assert 0 <= find_heading(hidden, one.pictures, one.viewpoints) < 360


@pytest.mark.parametrize("fault", ["half", "grey", "floaters", "lopsided", "nothing"])
def test_faults_cost_score(fault: str) -> None:
    one = car()
    score = AgreementScore()
    coords = one.target.coords
    good = score(one)
    if fault == "half":
        bad = score(part(one, coords[:, 0] < 12))
        assert bad.score < 0.7 * good.score
    elif fault == "grey":
        other = replace(one, gaussians=voxels(coords, np.full((len(coords), 3), 0.9)))
        bad = score(other)
        assert bad.parts["psnr"] < good.parts["psnr"] - 0.3
    elif fault == "floaters":
        bad = score(part(one, (coords[:, 0] < 8) | (coords[:, 0] > 10)))
        assert bad.parts["connected"] < 0.8
    elif fault == "lopsided":
        bad = score(part(one, (coords[:, 1] < 12) | (coords[:, 0] < 12)))
        assert bad.parts["symmetry"] < 0.9
    else:
        unseen = replace(
            one.gaussians, logit_opacities=torch.full_like(one.gaussians.logit_opacities, -20.0)
        )
        bad = score(replace(one, gaussians=unseen))
        assert bad.parts["iou"] == 0.0 and bad.score < 0.05
    assert bad.score < good.score


def test_symmetry_and_parts_of_voxels() -> None:
    bar = np.array([[i, j, 0] for i in range(10) for j in range(3)], np.int32)
    assert mirror_symmetry(bar) == 1.0 and largest_part(bar) == 1.0
    lump = np.array([[0, 20, 0]], np.int32)
    both = np.concatenate([bar, lump])
    assert largest_part(both) == pytest.approx(30 / 31)
    # the lump moves the plane of symmetry by half a voxel and has no mirror image itself
    assert mirror_symmetry(both) == pytest.approx(30 / 31)
    slope = np.array([[i, i, 0] for i in range(10)], np.int32)
    assert mirror_symmetry(slope) < 0.5
    assert mirror_symmetry(slope, 45.0) == mirror_symmetry(slope, 225.0) == 1.0
    diagonal = np.array([[i, i, i] for i in range(5)], np.int32)
    assert largest_part(diagonal) == 1.0


@pytest.mark.parametrize(("size", "shift"), [(128, 0), (300, 37), (40, -5)])
def test_framing_removes_place_and_scale(size: int, shift: int) -> None:
    """A disc of any size becomes one whose box is 1/1.2 of the picture, in the middle."""
    y, x = np.mgrid[:size, :size] + 0.5
    radius = size / 4
    inside = (x - size / 2 - shift / 4) ** 2 + (y - size / 2) ** 2 < radius**2
    alpha = inside.astype(np.float32)
    found = framed(TargetCutout(np.dstack([alpha] * 3), alpha), 96)
    rows, columns = np.nonzero(found.mask)
    assert abs(np.ptp(rows) + 1 - 80) <= 2 and abs(np.ptp(columns) + 1 - 80) <= 2
    half_pixel = 0.5 * 80 / (2 * radius)
    assert abs(rows.mean() - 47.5) < max(0.8, half_pixel)
    assert abs(columns.mean() - 47.5) < max(0.8, half_pixel)
    empty = framed(TargetCutout(np.zeros((9, 9, 3), np.float32), np.zeros((9, 9), np.float32)), 96)
    assert empty.alpha.shape == (96, 96) and not empty.mask.any()


def test_a_picture_becomes_square_on_black() -> None:
    rgba = np.zeros((10, 30, 4), np.uint8)
    rgba[4:6, 10:20] = (200, 100, 50, 255)
    rgba[0, 0] = (255, 255, 255, 0)
    made = of_picture(rgba)
    assert made.alpha.shape == (30, 30)
    assert made.rgb[0].max() == 0 and made.rgb[10].max() == 0
    assert made.alpha[14:16, 10:20].min() == 1.0 and made.alpha.sum() == 20
    assert made.before(1.0)[0, 0].tolist() == [255, 255, 255]
    assert resized(made, 15).alpha.sum() == pytest.approx(5.0)


def write_predictor(path: Path, weights: dict[str, torch.Tensor] | None = None) -> Path:
    """A predictor in the published layout: layers 0, 2, 4, 6 and 7 of a sequence."""
    generator = torch.Generator().manual_seed(1)
    state: dict[str, torch.Tensor] = {}
    for name, (width, out) in zip("02467", pairwise(WIDTHS), strict=True):
        state[f"layers.{name}.weight"] = torch.randn(out, width, generator=generator) / width**0.5
        state[f"layers.{name}.bias"] = torch.randn(out, generator=generator)
    torch.save(state | (weights or {}), path)
    return path


def test_the_predictor_is_the_published_chain_of_linear_layers(tmp_path: Path) -> None:
    path = write_predictor(tmp_path / "predictor.pth")
    state = torch.load(path, weights_only=True)
    embedding = torch.randn(3, 768, generator=torch.Generator().manual_seed(2)) * 7
    score = AestheticScore(lambda pictures: embedding[: len(pictures)], load_predictor(path))
    expected = embedding / embedding.norm(dim=1, keepdim=True)
    for name in "02467":
        expected = expected @ state[f"layers.{name}.weight"].T + state[f"layers.{name}.bias"]
    found = score.scores([Image.new("RGB", (4, 4))] * 3)
    np.testing.assert_allclose(found, expected[:, 0].numpy(), atol=1e-4)


def test_a_wrong_predictor_is_a_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "predictor.pth"
    with pytest.raises(InputError, match="aesthetic predictor: is not a file"):
        load_predictor(path)
    path.write_bytes(b"no weights")
    with pytest.raises(InputError, match="is damaged or is not a PyTorch checkpoint; name sac"):
        load_predictor(path)
    write_predictor(path, {"layers.7.bias": torch.zeros(2)})
    with pytest.raises(InputError, match=r"layers\.7\.bias: is not of shape"):
        load_predictor(path)
    write_predictor(path, {"layers.7.bias": torch.full((1,), float("nan"))})
    with pytest.raises(InputError, match="NaN"):
        load_predictor(path)
    write_predictor(path, {"more": torch.zeros(1)})
    with pytest.raises(InputError, match="does not hold the expected network"):
        load_predictor(path)


class Malice:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (Path("/tmp/never"),)  # type: ignore[return-value]


def test_a_predictor_with_code_in_it_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "predictor.pth"
    torch.save({"layers.0.weight": Malice()}, path)
    with pytest.raises(InputError, match="is never unpickled"):
        load_predictor(path)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    transformers = pytest.importorskip("transformers")
    folder = tmp_path_factory.mktemp("clip")
    state = torch.get_rng_state()
    torch.manual_seed(0)
    config = transformers.CLIPVisionConfig(
        hidden_size=32,
        intermediate_size=32,
        num_hidden_layers=1,
        num_attention_heads=2,
        image_size=32,
        patch_size=16,
        projection_dim=768,
    )
    transformers.CLIPVisionModelWithProjection(config).save_pretrained(folder)
    torch.set_rng_state(state)
    size = {"height": 32, "width": 32}
    transformers.CLIPImageProcessor(size={"shortest_edge": 32}, crop_size=size).save_pretrained(
        folder
    )
    return folder


def test_the_aesthetic_filter_of_a_target(tmp_path: Path, clip: Path) -> None:
    settings = FilterSettings(
        kind="aesthetic", predictor=write_predictor(tmp_path / "p.pth"), clip=clip
    )
    record = filter_record(settings)
    assert record.threshold == 4.5 and set(record.weights) == {"predictor", "clip"}
    score = open_score(settings)
    assert score is not None
    quality = score(car())
    assert set(quality.parts) == {"view_0", "view_90", "view_180", "view_270"}
    assert quality.score == pytest.approx(np.mean(list(quality.parts.values())), abs=1e-3)
    assert len(set(quality.parts.values())) == 4  # the weights see the pictures
    assert quality.flipped is None


def test_unnamed_or_wrong_clip_weights(tmp_path: Path, clip: Path) -> None:
    predictor = write_predictor(tmp_path / "p.pth")
    with pytest.raises(InputError, match="`clip`: weights: are not given"):
        filter_record(FilterSettings(kind="aesthetic", predictor=predictor))
    with pytest.raises(InputError, match=r"config\.json: is missing"):
        filter_record(FilterSettings(kind="aesthetic", predictor=predictor, clip=tmp_path))
    other = tmp_path / "clip"
    other.mkdir()
    for path in clip.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    config = (other / "config.json").read_text()
    (other / "config.json").write_text(config.replace("768", "512"))
    with pytest.raises(InputError, match="projection_dim: is 512"):
        filter_record(FilterSettings(kind="aesthetic", predictor=predictor, clip=other))
    with pytest.raises(InputError, match="needs a filter"):
        filter_record(FilterSettings(kind="none", threshold=1.0))
