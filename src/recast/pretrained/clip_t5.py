"""CLIP-FlanT5 (Lin et al. 2024): a T5 that reads the patches of a picture between two texts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from recast.pretrained.pictures import Picture, network_input

Array = NDArray[np.float64]

QUESTION = 'Does this figure show "{}"? Please answer yes or no.'
ANSWER = "Yes"
BEFORE = (
    "A chat between a curious user and an artificial intelligence assistant. The assistant gives "
    "helpful, detailed, and polite answers to the user's questions. USER: "
)
AFTER = "\n{} ASSISTANT: "
"""Texts before and after the picture."""

TEXTS = 8
"""Texts that are scored together."""


class ClipT5:
    """The network; the score is the geometric mean of the probabilities of "Yes" and of the end.

    Every picture is scored by itself, all texts of a call together, so that its scores do not
    depend on the pictures beside it.

    Args:
        name: for results.
        language: T5ForConditionalGeneration.
        vision: CLIPVisionModel.
        projector: weight and bias of two linear layers, from patches to the width of T5.
        tokenizer: of transformers; it ends every text with T5's end token.
        processor: image processor of transformers.
        layer: of the vision model's hidden states, whose patches are read.
    """

    def __init__(
        self, name: str, language: Any, vision: Any, projector: Sequence[Tensor], tokenizer: Any,
        processor: Any, layer: int,
    ) -> None:  # fmt: skip
        self.name = name
        self._language = language
        self._vision = vision
        self._projector = tuple(projector)
        self._tokenizer = tokenizer
        self._processor = processor
        self._layer = layer
        self._labels = self._ids(ANSWER)[None]

    @torch.no_grad()
    def score(self, images: Sequence[Picture], texts: Sequence[str]) -> Array:
        """(N, M) exp of minus the mean cross entropy of "Yes" and the end token.

        Args:
            images: (H, W, 3) RGB of any sizes, padded to squares with CLIP's mean colour.
            texts: what they may show, put into `QUESTION`.
        """
        scores = np.empty((len(images), len(texts)))
        before = self._embedded(BEFORE)
        after = [self._embedded(AFTER.format(QUESTION.format(text))) for text in texts]
        for row, image in zip(scores, images, strict=True):
            patches = self._patches(image)
            read = [torch.cat([before, patches, one]) for one in after]
            for start in range(0, len(read), TEXTS):
                row[start : start + TEXTS] = self._probability(read[start : start + TEXTS])
        return scores

    def _probability(self, read: Sequence[Tensor]) -> Array:
        """(n,) of the answer after each of n inputs (L, D) of T5's encoder."""
        known = pad_sequence([torch.ones_like(one[:, 0]) for one in read], batch_first=True)
        labels = self._labels.repeat(len(read), 1)
        logits = self._language(
            inputs_embeds=pad_sequence(list(read), batch_first=True),
            attention_mask=known.long(), labels=labels,
        ).logits  # fmt: skip
        # Published embeddings have more rows than there are tokens. The authors cut them off.
        logits = logits[..., : len(self._tokenizer)].float()
        loss = functional.cross_entropy(logits.transpose(1, 2), labels, reduction="none")
        probability: Array = torch.exp(-loss.mean(dim=1)).double().cpu().numpy()
        return probability

    def _patches(self, image: Picture) -> Tensor:
        """(P, D) the patches of a picture in the language of T5."""
        pixels = network_input(self._processor, [image], "padded").to(self._language.device)
        hidden = self._vision(pixels.to(self._language.dtype), output_hidden_states=True)
        patches = hidden.hidden_states[self._layer][0, 1:]  # the first is the class token
        first, first_bias, second, second_bias = self._projector
        inner = functional.gelu(functional.linear(patches, first, first_bias))
        return functional.linear(inner, second, second_bias)

    def _embedded(self, text: str) -> Tensor:
        embedded: Tensor = self._language.get_input_embeddings()(self._ids(text))
        return embedded

    def _ids(self, text: str) -> Tensor:
        return torch.tensor(self._tokenizer(text)["input_ids"], device=self._language.device)
