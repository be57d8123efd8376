"""CLIP-FlanT5 from a folder: files, settings and names of tensors that are understood."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from recast.errors import InputError
from recast.pretrained.checkpoint import has_weights, network_of, read_weights, weight_files
from recast.pretrained.clip_t5 import ANSWER, ClipT5
from recast.pretrained.folder import CONFIG_FILE, first_line, model_type, quiet
from recast.pretrained.pictures import input_size
from recast.storage import read_json

VISION_FOLDER = "vision_tower"

_TOKENIZER_FILE, _PROCESSOR_FILE = "tokenizer.json", "preprocessor_config.json"
_MEND = (
    "put the files of zhiqiulin/clip-flant5-xxl (or -xl) into this folder, config.json and "
    "preprocessor_config.json of openai/clip-vit-large-patch14-336 into vision_tower/ in it"
)
_LANGUAGE_SETTINGS = (
    "vocab_size", "d_model", "d_kv", "d_ff", "num_layers", "num_decoder_layers", "num_heads",
    "relative_attention_num_buckets", "relative_attention_max_distance", "layer_norm_epsilon",
    "feed_forward_proj", "pad_token_id", "eos_token_id", "decoder_start_token_id",
    "tie_word_embeddings", "scale_decoder_outputs",
)  # fmt: skip
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
_SAME_EMBEDDING = ("embed_tokens.weight", "encoder.embed_tokens.weight",
                   "decoder.embed_tokens.weight")  # fmt: skip


def clip_t5_files(folder: Path) -> tuple[Path, ...]:
    """The files of a folder that `load_clip_t5` reads.

    Raises:
        InputError: one is missing.
    """
    tower = folder / VISION_FOLDER
    single = (
        folder / CONFIG_FILE, folder / _TOKENIZER_FILE, tower / CONFIG_FILE, tower / _PROCESSOR_FILE
    )  # fmt: skip
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
    return ClipT5(
        folder.name,
        network_of("T5ForConditionalGeneration", language_config, language, folder, number)
        .to(device),
        network_of("CLIPVisionModel", vision_config, vision, folder, number).to(device),
        [tensor.to(device, number) for tensor in projector],
        tokenizer, processor, settings.get("mm_vision_select_layer", -2),
    )  # fmt: skip


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
            raise InputError(path, name, f"is {value!r}, which is not understood", _MEND)
    layer = settings.get("mm_vision_select_layer", -2)
    if type(layer) is not int:
        raise InputError(path, "mm_vision_select_layer", f"is {layer!r}, no whole number", _MEND)
    return settings


def _check(
    folder: Path, settings: Mapping[str, Any], language: Any, vision: Any, processor: Any,
    tokenizer: Any,
) -> None:  # fmt: skip
    """Refuse parts that do not fit together."""
    layer, layers = settings.get("mm_vision_select_layer", -2), vision.num_hidden_layers
    ids = tokenizer(ANSWER)["input_ids"]
    size, width = input_size(processor), settings.get("mm_hidden_size", vision.hidden_size)
    tower = Path(VISION_FOLDER)
    for where, fits, problem in (
        (CONFIG_FILE, -layers - 1 <= layer <= layers,
         f"selects layer {layer} of a vision tower with {layers}"),
        (tower / CONFIG_FILE, vision.hidden_size == width,
         f"has hidden_size {vision.hidden_size}, the projector reads {width}"),
        (tower / _PROCESSOR_FILE, set(size.values()) == {vision.image_size},
         f"makes images of {size['width']} x {size['height']}, not {vision.image_size}"),
        (CONFIG_FILE, getattr(language, "decoder_start_token_id", None) is not None,
         "has no decoder_start_token_id"),
        (_TOKENIZER_FILE, len(tokenizer) <= language.vocab_size,
         f"has {len(tokenizer)} tokens, the network {language.vocab_size}"),
        (_TOKENIZER_FILE, len(ids) > 1 and ids[-1] == language.eos_token_id,
         f"makes {ids} of {ANSWER!r}, which does not end with {language.eos_token_id}"),
    ):  # fmt: skip
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
