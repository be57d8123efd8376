"""Sizes of a GTRS model: the released one, and small ones of the same family."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from recast.core.records import Record

Count = Annotated[int, Field(gt=0, le=65536, strict=True)]
"""A positive whole number; the upper bound keeps a typing error from asking for all memory."""


Depth = Annotated[int, Field(gt=0, le=64, strict=True)]
"""Layers in a row, seven times those of the released model: each is made in Python."""


class StageConfig(Record):
    """One stage of the backbone.

    Attributes:
        blocks: one-shot-aggregation blocks; each but the first is residual.
        conv_channels: of the 3x3 convolutions inside a block.
        out_channels: of each block's output.
    """

    blocks: Depth
    conv_channels: Count
    out_channels: Count


def _v2_99() -> tuple[StageConfig, ...]:
    sizes = ((1, 128, 256), (3, 160, 512), (9, 192, 768), (3, 224, 1024))
    return tuple(StageConfig(blocks=b, conv_channels=c, out_channels=o) for b, c, o in sizes)


class BackboneConfig(Record):
    """A VoVNetV2 (Lee and Park 2020) with eSE in every block; the defaults are V2-99.

    Attributes:
        stem: channels of the three 3x3 convolutions; the first and the last have stride 2.
        stages: the first works at stride 4, each further one halves the resolution.
        layers: 3x3 convolutions in a block.
        frozen_norm: batch norms use their running statistics also in training, as in the released
            training, which starts from a pretrained backbone. False for training from scratch.
    """

    stem: tuple[Count, Count, Count] = (64, 64, 128)
    stages: tuple[StageConfig, ...] = Field(default_factory=_v2_99, min_length=1, max_length=6)
    layers: Depth = 5
    frozen_norm: bool = True

    @property
    def out_channels(self) -> int:
        """Channels of the last stage."""
        return self.stages[-1].out_channels

    @property
    def stride(self) -> int:
        """Input pixels per pixel of the last stage."""
        return 4 * 2 ** (len(self.stages) - 1)


class GtrsConfig(Record):
    """A GTRS-Dense model (Li et al. 2025); the defaults are the released one.

    Attributes:
        backbone: of the stitched image.
        channels: d, of all tokens.
        feedforward: hidden channels of the decoder, of the vocabulary embedding and of the heads.
        heads: attention heads; must divide `channels`.
        decoder_layers: cross-attending layers.
        token_rows, token_columns: to which the backbone's features are pooled.
    """

    backbone: BackboneConfig = BackboneConfig()
    channels: Count = 256
    feedforward: Count = 1024
    heads: Count = 8
    decoder_layers: Depth = 3
    token_rows: Count = 16
    token_columns: Count = 64

    @model_validator(mode="after")
    def _heads_divide_channels(self) -> Self:
        if self.channels % self.heads:
            raise ValueError(f"{self.channels} channels do not divide into {self.heads} heads")
        return self

    @property
    def image_tokens(self) -> int:
        """Number of image tokens."""
        return self.token_rows * self.token_columns
