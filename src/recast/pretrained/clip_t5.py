"""CLIP-FlanT5 (Lin et al. 2024): a T5 that reads the patches of a picture between two texts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.pretrained.folder import (
    CONFIG_FILE,
    Picture,
    first_line,
    has_weights,
    input_size,
    model_type,
    network_input,
    network_of,
    quiet,
    read_weights,
    weight_files,
)

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
VISION_FOLDER = "vision_tower"

_TOKENIZER_FILE, _PROCESSOR_FILE = "tokenizer.json", "preprocessor_config.json"
_MEND = (
    "put the files of zhiqiulin/clip-flant5-xxl (or -xl) into this folder, config.json and "
    "preprocessor_config.json of openai/clip-vit-large-patch14-336 into vision_tower/ in it"
)
_LANGUAGE_SETTINGS = (
    "vocab_size",
    "d_model",
    "d_kv",
    "d_ff",
    "num_layers",
    "num_decoder_layers",
    "num_heads",
    "relative_attention_num_buckets",
    "relative_attention_max_distance",
    "layer_norm_epsilon",
    "feed_forward_proj",
    "pad_token_id",
    "eos_token_id",
    "decoder_start_token_id",
    "tie_word_embeddings",
    "scale_decoder_outputs",
)
_UNDERSTOOD: Mapping[str, tuple[Any, ...]] = {
    "mm_projector_type": ("mlp2x_gelu",),
    "mm_vision_select_feature": ("patch", None),
    "mm_use_im_start_end": (False, None),
    "mm_use_im_patch_token": (False, None),
    "image_aspect_ratio": ("pad", None),
}
"""Values of settings that change what is computed; None is a setting that is not there."""
_OTHER = ("mm_vision_tower", "mm_vision_select_layer", "mm_hidden_size", "mm_projector_lr")
"""Settings that are looked at elsewhere, or that change nothing after training."""
_PROJECTOR = "mm_projector."
_PROJECTOR_ROOTS = ("", "model.", "encoder.")
_VISION = "vision_tower."
_SAME_EMBEDDING = (
    "embed_tokens.weight",
    "encoder.embed_tokens.weight",
    "decoder.embed_tokens.weight",
)


class ClipT5:
    """The network; the score is the geometric mean of the probabilities of "Yes" and of the end.

    Every picture is scored by itself, all texts of a call together, so that its scores do not
    depend on the pictures beside it.

    Args:
        name: name of the network, for results.
        language, vision: T5ForConditionalGeneration and CLIPVisionModel.
        projector: weight and bias of two linear layers, from patches to the width of T5.
        tokenizer: tokenizer of transformers, which ends every text with T5's end token.
        processor: image processor of transformers.
        layer: layer of the vision model's hidden states whose patches are read.
    """

    def __init__(
        self,
        name: str,
        language: Any,
        vision: Any,
        projector: Sequence[Tensor],
        tokenizer: Any,
        processor: Any,
        layer: int,
    ) -> None:
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
            attention_mask=known.long(),
            labels=labels,
        ).logits
        # Published embeddings have more rows than there are tokens. The authors cut them off.
        logits = logits[..., : len(self._tokenizer)].float()
        loss = functional.cross_entropy(logits.transpose(1, 2), labels, reduction="none")
        return torch.exp(-loss.mean(dim=1)).double().cpu().numpy()

    def _patches(self, image: Picture) -> Tensor:
        """(P, D) the patches of a picture in the language of T5."""
        pixels = network_input(self._processor, [image], "padded").to(self._language.device)
        hidden = self._vision(pixels.to(self._language.dtype), output_hidden_states=True)
        patches = hidden.hidden_states[self._layer][0, 1:]  # the first is the class token
        first, first_bias, second, second_bias = self._projector
        inner = functional.gelu(functional.linear(patches, first, first_bias))
        return functional.linear(inner, second, second_bias)

    def _embedded(self, text: str) -> Tensor:
        return self._language.get_input_embeddings()(self._ids(text))

    def _ids(self, text: str) -> Tensor:
        return torch.tensor(self._tokenizer(text)["input_ids"], device=self._language.device)


def clip_t5_files(folder: Path) -> tuple[Path, ...]:
    """The files of a folder that `load_clip_t5` reads.

    Raises:
        InputError: one is missing.
    """
    tower = folder / VISION_FOLDER
    single = (
        folder / CONFIG_FILE,
        folder / _TOKENIZER_FILE,
        tower / CONFIG_FILE,
        tower / _PROCESSOR_FILE,
    )
    for path in single:
        if not path.is_file():
            raise InputError(folder, str(path.relative_to(folder)), "is missing", _MEND)
    more = weight_files(tower, _MEND) if has_weights(tower) else ()
    return (*single, *weight_files(folder, _MEND), *more)


def load_clip_t5(folder: Path, device: str = "cpu", dtype: str | None = None) -> ClipT5:
    """Read the network from a folder.

    The folder has config.json, tokenizer.json and weights (safetensors or PyTorch's, in one file or
    several) of zhiqiulin/clip-flant5-xxl or -xl. Its folder `vision_tower` has config.json and
    preprocessor_config.json of openai/clip-vit-large-patch14-336. Its weights are needed only if
    the first ones have no vision tower; that of xl should have one, by the size of its file.

    What has been run: tiny networks with random weights, in float32 and bfloat16 on the CPU. The
    published weights and CUDA have not been run; names of tensors and settings are those of the
    authors' code.

    Args:
        dtype: float32 or bfloat16; None is bfloat16, as of the authors, but float32 on the CPU.

    Raises:
        InputError: a file is missing or damaged; or the network is another one than this code
            understands.
    """
    clip_t5_files(folder)
    settings = _settings(folder)
    tower = folder / VISION_FOLDER
    if model_type(tower) not in ("clip", "clip_vision_model"):
        found = f"is of model_type {model_type(tower)!r}, not 'clip'"
        raise InputError(tower / CONFIG_FILE, "model_type", found, _MEND)
    import transformers

    with quiet():
        try:
            language_config = transformers.T5Config.from_dict(
                {name: settings[name] for name in _LANGUAGE_SETTINGS if name in settings}
            )
            vision_config = transformers.CLIPVisionConfig.from_pretrained(
                tower, local_files_only=True
            )
            processor = transformers.CLIPImageProcessor.from_pretrained(
                tower, local_files_only=True
            )
            # The file as it is: T5Tokenizer makes another one of its vocabulary.
            tokenizer = transformers.PreTrainedTokenizerFast(
                tokenizer_file=str(folder / _TOKENIZER_FILE)
            )
        except Exception as error:  # of the parsers
            raise InputError(
                folder, "files", f"cannot be read ({first_line(error)})", _MEND
            ) from error
    _check(folder, settings, language_config, vision_config, processor, tokenizer)
    kind = dtype or ("float32" if device.startswith("cpu") else "bfloat16")
    number = {"float32": torch.float32, "bfloat16": torch.bfloat16}.get(kind)
    if number is None:
        raise InputError("VQA scorer", "dtype", f"is {kind}", "choose float32 or bfloat16")
    language, vision, projector = _parts(folder, settings, read_weights(folder, _MEND))
    d, width = language_config.d_model, vision_config.hidden_size
    for tensor, shape in zip(projector, ((d, width), (d,), (d, d), (d,)), strict=True):
        if tuple(tensor.shape) != shape or not bool(torch.isfinite(tensor).all()):
            problem = f"has shape {tuple(tensor.shape)}, not {shape}, or values that are not finite"
            raise InputError(folder, f"{_PROJECTOR}*", problem, _MEND)

    def refusal(problem: str) -> InputError:
        return InputError(folder, "weights", problem, "download the files of this network again")

    t5, clip = transformers.T5ForConditionalGeneration, transformers.CLIPVisionModel
    return ClipT5(
        folder.name,
        network_of(t5, language_config, language, refusal, number).to(device),
        network_of(clip, vision_config, vision, refusal, number).to(device),
        [tensor.to(device, number) for tensor in projector],
        tokenizer,
        processor,
        settings.get("mm_vision_select_layer", -2),
    )


def _settings(folder: Path) -> dict[str, Any]:
    """config.json, in which every setting that matters has a value that is understood."""
    path = folder / CONFIG_FILE
    settings = read_json(path)
    found = settings.get("model_type") if isinstance(settings, dict) else None
    if found not in ("t5", "clip_t5"):  # the published files say t5, the authors' code clip_t5
        raise InputError(path, "model_type", f"is {found!r}, not 't5' or 'clip_t5'", _MEND)
    for name, values in _UNDERSTOOD.items():
        if settings.get(name) not in values:
            known = " or ".join(repr(one) for one in values if one is not None)
            raise InputError(path, name, f"is {settings.get(name)!r}, not {known}", _MEND)
    for name, value in settings.items():
        understood = name in _OTHER or name in _UNDERSTOOD or value in (None, False)
        if name.startswith("mm_") and not understood:
            raise InputError(path, name, f"is {value!r}, which is not supported", _MEND)
    layer = settings.get("mm_vision_select_layer", -2)
    if type(layer) is not int:
        raise InputError(path, "mm_vision_select_layer", f"is {layer!r}, not a whole number", _MEND)
    return settings


def _check(
    folder: Path,
    settings: Mapping[str, Any],
    language: Any,
    vision: Any,
    processor: Any,
    tokenizer: Any,
) -> None:
    """Refuse parts that do not fit together."""
    layer, layers = settings.get("mm_vision_select_layer", -2), vision.num_hidden_layers
    ids = tokenizer(ANSWER)["input_ids"]
    size, width = input_size(processor), settings.get("mm_hidden_size", vision.hidden_size)
    tower = Path(VISION_FOLDER)
    for where, fits, problem in (
        (
            CONFIG_FILE,
            -layers - 1 <= layer <= layers,
            f"selects layer {layer} of a vision tower with {layers}",
        ),
        (
            tower / CONFIG_FILE,
            vision.hidden_size == width,
            f"has hidden_size {vision.hidden_size}, the projector reads {width}",
        ),
        (
            tower / _PROCESSOR_FILE,
            set(size.values()) == {vision.image_size},
            f"makes images of {size['width']} x {size['height']}, not {vision.image_size}",
        ),
        (
            CONFIG_FILE,
            getattr(language, "decoder_start_token_id", None) is not None,
            "has no decoder_start_token_id",
        ),
        (
            _TOKENIZER_FILE,
            len(tokenizer) <= language.vocab_size,
            f"has {len(tokenizer)} tokens, the network {language.vocab_size}",
        ),
        (
            _TOKENIZER_FILE,
            len(ids) > 1 and ids[-1] == language.eos_token_id,
            f"makes {ids} of {ANSWER!r}, which does not end with {language.eos_token_id}",
        ),
    ):
        if not fits:
            raise InputError(folder, str(where), problem, _MEND)


def _parts(
    folder: Path, settings: Mapping[str, Any], state: dict[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Tensor], list[Tensor]]:
    """Weights of T5, of the vision tower, and of the projector."""

    def refusal(name: str, problem: str) -> InputError:
        return InputError(folder, name, problem, _MEND)

    roots = [root for root in _PROJECTOR_ROOTS if f"{root}{_PROJECTOR}0.weight" in state]
    if len(roots) != 1:
        raise refusal(f"{_PROJECTOR}0.weight", f"is in the weights {len(roots)} times, not once")
    names = [f"{_PROJECTOR}{layer}.{part}" for layer in (0, 2) for part in ("weight", "bias")]
    projector, vision, language = [], {}, {}
    for name in names:
        if roots[0] + name not in state:
            raise refusal(name, "is missing")
        projector.append(state.pop(roots[0] + name))
    for name, tensor in state.items():
        if _VISION in name:
            vision[name.rpartition(_VISION)[2]] = tensor
        else:
            language[name] = tensor
    if not vision:
        found = read_weights(folder / VISION_FOLDER, _MEND)
        vision = {name: one for name, one in found.items() if name.startswith("vision_model.")}
    # A count that older versions of transformers stored.
    vision = {name: one for name, one in vision.items() if not name.endswith("position_ids")}
    copies = [language.pop(name) for name in _SAME_EMBEDDING if name in language]
    if copies:
        language.setdefault("shared.weight", copies[0])
    # transformers would take the embedding for it.
    if settings.get("tie_word_embeddings") is False and "lm_head.weight" not in language:
        raise refusal("lm_head.weight", "is missing")
    return language, vision, projector
