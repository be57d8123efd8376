"""The compact image encoder: size, determinism, gradients, what its tokens depend on."""

from __future__ import annotations

import pytest
import torch
from pydantic import ValidationError

from recast.trellis.conditioning import (
    CompactImageEncoder,
    CompactImageEncoderConfig,
    ImageEncoder,
    grid_positions,
)

SMALL = CompactImageEncoderConfig(
    image_size=32, stem_channels=(8, 12), channels=16, num_blocks=2, num_heads=2
)


def _encoder(seed: int = 0, config: CompactImageEncoderConfig = SMALL) -> CompactImageEncoder:
    encoder = CompactImageEncoder(config)
    encoder.initialise(torch.Generator().manual_seed(seed))
    return encoder


def _images(count: int = 2, side: int = 32, seed: int = 1) -> torch.Tensor:
    return torch.rand(count, 3, side, side, generator=torch.Generator().manual_seed(seed))


def test_default_size_and_tokens():
    encoder = CompactImageEncoder(CompactImageEncoderConfig())
    assert isinstance(encoder, ImageEncoder)
    assert 0.5e6 < sum(parameter.numel() for parameter in encoder.parameters()) < 1.5e6
    with torch.no_grad():
        tokens = encoder.encode(_images(1, encoder.image_size))
    assert tokens.shape == (1, 1 + 16 * 16, encoder.channels) and tokens.dtype == torch.float32


def test_tokens_are_layer_normalised():
    tokens = _encoder().encode(_images())
    assert tokens.mean(-1).abs().max() < 1e-5
    torch.testing.assert_close(tokens.var(-1, unbiased=False), torch.ones(2, 17), atol=1e-3, rtol=0)


def test_same_seed_same_bytes():
    a, b = _encoder(3), _encoder(3)
    assert all(torch.equal(a.published_state()[k], v) for k, v in b.published_state().items())
    assert torch.equal(a.encode(_images()), b.encode(_images()))
    assert not torch.equal(a.encode(_images()), _encoder(4).encode(_images()))


def test_a_picture_does_not_depend_on_its_batch():
    encoder = _encoder()
    images = _images(3)
    torch.testing.assert_close(encoder.encode(images)[1:2], encoder.encode(images[1:2]))


def test_gradients_reach_every_parameter_and_the_picture():
    encoder, images = _encoder(), _images().requires_grad_()
    target = torch.randn(2, 17, 16, generator=torch.Generator().manual_seed(2))
    (encoder.encode(images) * target).sum().backward()
    assert images.grad is not None and images.grad.abs().min() > 0
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


def test_recomputed_activations_give_the_same_gradients():
    def gradients(checkpointing: bool) -> list[torch.Tensor]:
        encoder = _encoder().train()
        encoder.checkpointing = checkpointing
        encoder.encode(_images())[..., 0].sum().backward()
        return [parameter.grad for parameter in encoder.parameters()]

    for plain, recomputed in zip(gradients(False), gradients(True), strict=True):
        torch.testing.assert_close(plain, recomputed)


def test_leading_token_learns_where_the_bright_side_is():
    """It sees the whole picture and, through the positions, where something is."""
    encoder = _encoder()
    head = torch.nn.Linear(16, 1)
    torch.nn.init.zeros_(head.weight)
    optimizer = torch.optim.Adam([*encoder.parameters(), *head.parameters()], lr=3e-3)
    images = torch.rand(8, 3, 32, 32, generator=torch.Generator().manual_seed(5)) * 0.2
    sides = torch.arange(8) % 2
    images[sides == 0, :, :, :16] += 0.7
    images[sides == 1, :, :, 16:] += 0.7
    for _ in range(40):
        optimizer.zero_grad()
        logits = head(encoder.encode(images)[:, 0]).squeeze(1)
        loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, sides.float())
        loss.backward()
        optimizer.step()
    assert loss.item() < 0.3  # not knowing is 0.69


def test_positions_tell_all_cells_apart():
    positions = grid_positions(8, 16)
    assert positions.shape == (64, 16)
    distances = torch.cdist(positions, positions) + torch.eye(64) * 9
    assert distances.min() > 0.3
    torch.testing.assert_close(positions[8 * 3 + 5, :8], positions[8 * 3, :8])  # same row
    torch.testing.assert_close(positions[8 * 3 + 5, 8:], positions[5, 8:])  # same column


def test_state_round_trip_on_the_meta_device():
    source = _encoder(7)
    with torch.device("meta"):
        encoder = CompactImageEncoder(SMALL)
    encoder.to_empty(device="cpu").load_published(source.published_state())
    assert torch.equal(encoder.encode(_images()), source.encode(_images()))


def test_bfloat16_torso_stays_near_float32():
    encoder = _encoder()
    exact = encoder.encode(_images())
    encoder.set_torso_dtype(torch.bfloat16)
    rounded = encoder.encode(_images())
    assert rounded.dtype == torch.float32
    assert 0 < (rounded - exact).abs().max() < 0.1


def test_picture_of_another_size():
    with pytest.raises(ValueError, match=r"not \(B, 3, 32, 32\)"):
        _encoder().encode(_images(side=40))


@pytest.mark.parametrize(
    "arguments", [{"image_size": 100}, {"channels": 130}, {"num_heads": 3}, {"depth": 2}]
)
def test_arguments_that_make_no_network(arguments: dict[str, int]):
    with pytest.raises(ValidationError):
        CompactImageEncoderConfig(**arguments)
