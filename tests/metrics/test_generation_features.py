"""Features of pictures: the stand-in, and Inception with made-up weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.metrics.actor_scores import ScoredCutout, framed, photographed
from recast.metrics.frechet import CONVOLUTIONS, load_inception
from recast.metrics.perceptual import FEATURE_KINDS, TOY_DIMENSIONS, ToyFeatures, load_embedders
from support.crops import photograph, two_coloured_box

TOY = ToyFeatures()


def toy_distance(first: ScoredCutout, second: ScoredCutout) -> float:
    compare = FEATURE_KINDS["toy"].compare
    assert compare is not None
    window = framed(second.mask)
    return compare(TOY.features(first.within(window)), TOY.features(second.within(window)))


def test_the_stand_in_orders_vehicles() -> None:
    box = two_coloured_box()
    truth = photographed(photograph(box, 40.0, 10.0))
    turned = photographed(photograph(box, 43.0, 10.0))
    behind = photographed(photograph(box, 220.0, 10.0))
    recoloured = ScoredCutout(truth.rgb[..., ::-1].copy(), truth.alpha)
    nothing = ScoredCutout(np.zeros_like(truth.rgb), np.zeros_like(truth.alpha))
    assert toy_distance(truth, truth) == 0.0
    distances = [toy_distance(one, truth) for one in (turned, recoloured, behind, nothing)]
    assert 0 < distances[0] < 0.3 * distances[1]
    assert distances[0] < 0.3 * distances[2]
    assert max(distances) == distances[3]


def test_a_black_vehicle_is_seen() -> None:
    """Before black alone it would look like no vehicle at all."""
    truth = photographed(photograph(two_coloured_box(), 40.0, 10.0))
    black = ScoredCutout(np.zeros_like(truth.rgb), truth.alpha)
    nothing = ScoredCutout(np.zeros_like(truth.rgb), np.zeros_like(truth.alpha))
    assert toy_distance(nothing, black) > 0.5 * toy_distance(nothing, truth)


def test_cells_hold_colours_and_edges() -> None:
    """A square of 64 pixels, its upper left quarter red with one upright edge in the middle."""
    rgb, alpha = np.zeros((64, 64, 3)), np.zeros((64, 64))
    rgb[:32, :32, 0] = alpha[:32, :32] = 1.0
    cells = TOY.features(ScoredCutout(rgb, alpha)).reshape(4, 4, 8)
    assert cells.size == TOY_DIMENSIONS
    np.testing.assert_allclose(cells[:2, :2, :4], np.broadcast_to([1.0, 0, 0, 1.0], (2, 2, 4)))
    assert cells[2:, 2:].max() == 0.0  # flat grey
    # luma falls or rises along x at the right edge, along y at the lower one
    right, below = cells[0, 1, 4:], cells[1, 0, 4:]
    assert right[0] > 0 and right[1:].max() == 0
    assert below[2] > 0 and below[[0, 1, 3]].max() == 0


@given(st.integers(4, 90), st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_squares_of_any_size(side: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(size=(side, side))
    cutout = ScoredCutout(rng.uniform(size=(side, side, 3)) * alpha[..., None], alpha)
    features = TOY.features(cutout)
    assert features.shape == (TOY_DIMENSIONS,)
    assert np.isfinite(features).all() and features.min() >= 0


def inception_weights(classes: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    state = {"fc.weight": torch.zeros(classes, 2048)}
    for name, (before, after, height, width) in CONVOLUTIONS.items():
        fan = before * height * width
        kernel = torch.randn(after, before, height, width, generator=generator) * (2 / fan) ** 0.5
        state[f"{name}.conv.weight"] = kernel
        state[f"{name}.bn.weight"] = 1 + 0.1 * torch.randn(after, generator=generator)
        state[f"{name}.bn.bias"] = 0.1 * torch.randn(after, generator=generator)
        state[f"{name}.bn.running_mean"] = 0.1 * torch.randn(after, generator=generator)
        state[f"{name}.bn.running_var"] = 1 + torch.rand(after, generator=generator)
    return state


MEAN = 0.0876452238
IMAGE = np.random.default_rng(0).uniform(size=(40, 52, 3))


@pytest.fixture(scope="module")
def weights() -> dict[str, torch.Tensor]:
    return inception_weights(1000)


def test_inception_as_torchvision_computes_it(
    weights: dict[str, torch.Tensor], tmp_path: Path
) -> None:
    path = tmp_path / "inception.pth"
    torch.save(weights, path)
    (_, embedder) = load_embedders(inception=path)
    assert embedder.key == "inception"
    cutout = ScoredCutout(IMAGE, np.ones(IMAGE.shape[:2]))
    features = embedder.features(cutout)
    assert features.shape == (2048,)
    # by torchvision's Inception3 with these weights, the image brought to 299 x 299 the same way
    assert features[[169, 1156, 1951]] == pytest.approx([0.3527597, 0.8192189, 0.5975059], rel=1e-4)
    assert features.mean() == pytest.approx(MEAN, rel=1e-5)


def test_the_network_of_the_fid_pools_otherwise(
    weights: dict[str, torch.Tensor], tmp_path: Path
) -> None:
    path = tmp_path / "fid.pth"
    torch.save(weights | {"fc.weight": torch.zeros(1008, 2048)}, path)
    network = load_inception(path)
    assert network.fid
    assert network.features(IMAGE).mean() != pytest.approx(MEAN, rel=1e-3)


def test_inception_of_many_against_one_by_one(
    weights: dict[str, torch.Tensor], tmp_path: Path
) -> None:
    path = tmp_path / "fid.pth"
    torch.save(weights | {"fc.weight": torch.zeros(1008, 2048)}, path)
    network = load_inception(path).to("cpu")
    assert network.fid
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 256, size, dtype=np.uint8) for size in ((30, 60, 3), (320, 310, 3))]
    found = network.embeddings(pictures, batch=2)
    assert found.shape == (2, 2048)
    expected = [network.features(picture / 255) for picture in pictures]
    # float32 through about 48 layers, whatever the batch
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.abs(found[0] - found[1]).max() > 1e-3
    assert network.embeddings([]).shape == (0, 2048)


def test_inception_weights_that_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.pth"
    for state, message in (
        ({"fc.weight": torch.zeros(10, 2048)}, "not from a known network"),
        ({"fc.weight": torch.zeros(1000, 2048)}, "Conv2d_1a_3x3.conv.weight: is missing"),
        (
            {"fc.weight": torch.zeros(1000, 1), "Conv2d_1a_3x3.conv.weight": torch.zeros(1)},
            r"shape \(1,\), not \(32, 3, 3, 3\)",
        ),
    ):
        torch.save(state, path)
        with pytest.raises(InputError, match=message):
            load_inception(path)
    with pytest.raises(InputError, match="Inception weights: is not a file"):
        load_inception(tmp_path / "nowhere.pth")
