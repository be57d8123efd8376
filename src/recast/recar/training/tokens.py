"""Image tokens of conditions, from a frozen encoder or one that trains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from recast.recar.picture import Image
from recast.recar.training.conditions import ConditionSource
from recast.trellis.conditioning import ImageEncoder, crop_to_object, images_from_crops

Perturb = Callable[[Image, np.random.Generator], Image]


@dataclass(frozen=True)
class View:
    """One picture of one identity."""

    identity: str
    index: int


class ConditionTokens:
    """Tokens of views; those of a frozen encoder are kept in memory up to a bound.

    Every picture is encoded alone: a batch of several would round differently, and a resumed
    training, whose memory is empty, would not come out the same.

    Args:
        encoder: turns crops into tokens.
        source: of the pictures.
        device: of the encoder.
        frozen: encode without gradients.
        kept_bytes: of tokens kept; nothing is dropped, what comes later is encoded each time.
    """

    def __init__(
        self, encoder: ImageEncoder, source: ConditionSource, device: torch.device,
        *, frozen: bool = True, kept_bytes: int = 0,
    ) -> None:  # fmt: skip
        self.encoder = encoder
        self.source = source
        self.device = device
        self.frozen = frozen
        self.kept_bytes = kept_bytes
        self.used_bytes = 0
        self._kept: dict[View, Tensor] = {}

    def crop(self, view: View, alter: Perturb | None, rng: np.random.Generator) -> Image:
        """The square crop (S, S, 3) on black that the encoder sees.

        Args:
            view: which picture.
            alter: what happens to it first.
            rng: for that.

        Raises:
            InputError: nothing to see in the picture, or it cannot be read.
        """
        rgba = self.source.picture(view.identity, view.index)
        if alter is not None:
            rgba = alter(rgba, rng)
        where = f"{view.identity} picture {view.index}"
        return crop_to_object(rgba, self.encoder.image_size, where=where)

    def of(
        self,
        views: Sequence[View],
        alters: Sequence[Perturb | None],
        rng: np.random.Generator,
    ) -> Tensor:
        """Tokens (B, L, C) of views, each altered by its own function or left clean."""
        if self.frozen:
            with torch.no_grad():
                tokens = [self._one(v, a, rng) for v, a in zip(views, alters, strict=True)]
            return torch.stack(tokens).to(self.device)
        crops = [self.crop(v, a, rng) for v, a in zip(views, alters, strict=True)]
        return self.encoder.encode(images_from_crops(crops).to(self.device))

    def _one(self, view: View, alter: Perturb | None, rng: np.random.Generator) -> Tensor:
        if alter is None and view in self._kept:
            return self._kept[view]
        images = images_from_crops([self.crop(view, alter, rng)]).to(self.device)
        tokens = self.encoder.encode(images)[0].detach()
        size = tokens.numel() * tokens.element_size()
        if alter is None and self.used_bytes + size <= self.kept_bytes:
            self._kept[view] = tokens = tokens.cpu()
            self.used_bytes += size
        return tokens.to(self.device)
