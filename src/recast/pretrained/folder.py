"""Folders with published networks, read strictly, never fetched; pictures as networks take them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import member, read_json
from recast.core.torch_file import read_header, read_tensors

CONFIG_FILE = "config.json"
WEIGHTS_FILE = "model.safetensors"
_PROCESSOR_FILES = ("preprocessor_config.json", "processor_config.json")

MOST_PIXELS = 8192
"""Edge of an image that a processor may make."""
SPARE = 1 << 20
"""Numbers that a network may hold beyond the stored ones: buffers that are computed."""
_PYTORCH_FILE = "pytorch_model.bin"
_INDEX = ".index.json"


@dataclass(frozen=True)
class PretrainedFolder:
    """A network as it lies in a Hugging Face repository.

    Attributes:
        path: the folder.
        model_type: model type that its config.json must name.
        model_class, processor_class: names in transformers.
        repositories: repositories where the user finds the weights, for messages.
        text: whether the network reads text, so that it needs the files of a tokenizer.
    """

    path: Path
    model_type: str
    model_class: str
    processor_class: str
    repositories: str
    text: bool = False

    def files(self) -> tuple[Path, ...]:
        """The files that are read; every one is there.

        Raises:
            InputError: one is missing.
        """
        wanted = [(CONFIG_FILE,), (WEIGHTS_FILE,), _PROCESSOR_FILES]
        if self.text:
            wanted += [("tokenizer.json", "vocab.txt")]
        found: list[Path] = []
        for names in wanted:
            present = [self.path / name for name in names if (self.path / name).is_file()]
            if not present:
                raise self._refusal(" or ".join(names), "is missing")
            found += present
        return tuple(found)

    def check(self) -> None:
        """Refuse what cannot work, without reading the weights or importing transformers.

        Raises:
            InputError: a file is missing, is of another network, or is no whole safetensors file; a
                configuration has more layers than the weights have tensors, or makes images too
                large.
        """
        self.files()
        config = read_json(self.path / CONFIG_FILE)
        found = config.get("model_type") if isinstance(config, dict) else None
        if found != self.model_type:
            raise self._refusal(CONFIG_FILE, f"is of model_type {found!r}, not {self.model_type!r}")
        # Layers are made one by one before their weights are looked for.
        most = len(read_header(self.path / WEIGHTS_FILE, f"download it from {self.repositories}"))
        self._bound(CONFIG_FILE, config, ("layer", "depth", "block"), most, "(stored tensors)")
        for name in _PROCESSOR_FILES:
            if (self.path / name).is_file():
                told = read_json(self.path / name)
                self._bound(name, told, ("size", "edge", "height", "width"), MOST_PIXELS, "pixels")

    def _bound(self, file: str, config: Any, names: tuple[str, ...], most: int, unit: str) -> None:
        """Refuse numbers above `most` of members with one of `names` in their path."""
        waiting = [("", config)]
        while waiting:
            path, value = waiting.pop()
            if isinstance(value, dict):
                waiting += [(f"{path}.{name}".lstrip("."), one) for name, one in value.items()]
            elif isinstance(value, list):
                waiting += [(path, one) for one in value]
            elif not isinstance(value, int | float) or value <= most:
                continue
            elif any(name in path for name in names):
                raise self._refusal(file, f"{path} is {value}, {most} {unit} at most")

    def read(self, device: str) -> tuple[Any, Any]:
        """Processor and network, in float32, ready to infer.

        Raises:
            InputError: see `check`; or tensors are missing, of another shape or not finite, or the
                configuration asks for more numbers than are stored.
        """
        self.check()
        import transformers

        names = self.model_class, self.processor_class
        network, processors = (getattr(transformers, name) for name in names)
        with quiet():
            try:
                config = network.config_class.from_pretrained(self.path, local_files_only=True)
                processor = processors.from_pretrained(self.path, local_files_only=True)
            except Exception as error:  # transformers raises whatever its parts raise
                raise self._refusal("files", f"cannot be read ({first_line(error)})") from error
        state = read_tensors(self.path / WEIGHTS_FILE, "weights", self._mend)
        model = network_of(
            network,
            config,
            state,
            lambda problem: self._refusal(WEIGHTS_FILE, problem),
            spare=True,
        )
        return processor, model.to(device)

    @property
    def _mend(self) -> str:
        tokenizer = ", with its tokenizer" if self.text else ""
        return f"download {self.repositories}{tokenizer}, into this folder"

    def _refusal(self, field: str, problem: str) -> InputError:
        return InputError(self.path, field, problem, self._mend)


def model_type(folder: Path) -> str | None:
    """What config.json says; None where there is no such file, which `PretrainedFolder` refuses."""
    path = folder / CONFIG_FILE
    config = read_json(path) if path.is_file() else None
    return config.get("model_type") if isinstance(config, dict) else None


@contextmanager
def quiet() -> Iterator[None]:
    """Keep transformers' progress bars and notices away from the user's screen."""
    from transformers.utils import logging

    verbosity, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)
        if bars:
            logging.enable_progress_bar()


def first_line(error: Exception) -> str:
    """The first line of an error's message, or its class where it has none."""
    lines = str(error).strip().splitlines()
    return lines[0][:160] if lines else type(error).__name__


def has_weights(folder: Path) -> bool:
    """Whether a folder has a file that `weight_files` would find."""
    names = [name + end for name in (WEIGHTS_FILE, _PYTORCH_FILE) for end in ("", _INDEX)]
    return any((folder / name).is_file() for name in names)


def weight_files(folder: Path, mend: str) -> tuple[Path, ...]:
    """The files that hold the weights of a folder: safetensors if there are any, else PyTorch's.

    Args:
        mend: advice on where the user finds the weights, for messages.

    Raises:
        InputError: there are none, or their index is no table of files in the folder.
    """
    for name in (WEIGHTS_FILE, _PYTORCH_FILE):
        if (folder / name).is_file():
            return (folder / name,)
        index = folder / (name + _INDEX)
        if index.is_file():
            found = read_json(index)
            table = found.get("weight_map") if isinstance(found, dict) else None
            if not isinstance(table, dict) or not all(isinstance(v, str) for v in table.values()):
                raise InputError(index, "weight_map", "is not a table of file names", mend)
            names = sorted({*table.values()})
            return tuple(member(folder, one, index, "weight_map") for one in names)
    raise InputError(folder, f"{WEIGHTS_FILE} or {_PYTORCH_FILE}", "is missing", mend)


def read_weights(folder: Path, mend: str) -> dict[str, Tensor]:
    """All tensors of a folder's weights by name, on the CPU; no code in the files is run.

    Raises:
        InputError: see `weight_files` and `read_tensors`; or two files hold the same tensor.
    """
    state: dict[str, Tensor] = {}
    for path in weight_files(folder, mend):
        more = read_tensors(path, "weights", mend)
        twice = sorted(state.keys() & more.keys())
        if twice:
            raise InputError(path, twice[0], "is in another file too", mend)
        state |= more
    return state


def network_of(
    network: Any,
    config: Any,
    state: Mapping[str, Tensor],
    refusal: Callable[[str], InputError],
    dtype: torch.dtype = torch.float32,
    spare: bool = False,
) -> Any:
    """A network of transformers with these weights, on the CPU, ready to infer.

    Args:
        network: class of transformers.
        config: configuration of that class.
        refusal: function that makes the error of a problem with the weights.
        spare: whether there may be more tensors than the network has.

    Raises:
        InputError: tensors are missing, of another shape or not finite, or the configuration asks
            for more layers or numbers than there are.
    """
    layers = max(getattr(config, name, 0) for name in ("num_hidden_layers", "num_decoder_layers"))
    if layers > len(state):
        raise refusal(f"has {len(state)} tensors for {layers} layers")
    with quiet():
        try:
            # Without memory first: what is asked for must be there before it is taken.
            with torch.device("meta"):
                empty = network(config)
            asked = sum(one.numel() for one in (*empty.parameters(), *empty.buffers()))
            stored = sum(one.numel() for one in state.values())
            if asked > 2 * stored + SPARE:  # smaller differences are told by name below
                raise ValueError(f"{CONFIG_FILE} asks for {asked} numbers, {stored} are stored")
            model, loaded = network.from_pretrained(
                None,
                config=config,
                state_dict=dict(state),
                output_loading_info=True,
                ignore_mismatched_sizes=True,
                dtype=dtype,
            )
        except Exception as error:  # transformers raises whatever its parts raise
            raise refusal(f"cannot be read ({first_line(error)})") from error
    absent = sorted(loaded["missing_keys"])
    more = [] if spare else sorted(loaded["unexpected_keys"])
    if absent or more:
        beside = "" if spare else f" and has {len(more)} more"
        raise refusal(f"lacks {len(absent)} tensors{beside}, first {(absent + more)[0]}")
    for name, theirs, ours in sorted(loaded["mismatched_keys"]):
        raise refusal(f"tensor {name} has shape {tuple(theirs)}, not {tuple(ours)}")
    for name, tensor in model.state_dict().items():
        if not torch.isfinite(tensor).all():
            raise refusal(f"tensor {name} holds values that are not finite")
    return model.eval().requires_grad_(False)


Picture = NDArray[np.uint8]
"""(H, W, 3), RGB."""
Fit = Literal["whole", "published", "padded"]
"""How a picture is brought to a network's size, see `network_input`."""
Item = TypeVar("Item")

BATCH = 32


def whole_picture(processor: Any, image: NDArray[np.float64]) -> Tensor:
    """(1, 3, h, w) what a network is given: all of an image (H, W, 3) in [0, 1], at its size.

    Published processors cut the middle out of the resized picture, and DINOv2's even out of a
    square one: a vehicle that fills the picture would lose its ends. Here nothing is cut, as in
    the FD by DINOv2 (dgm-eval), which resizes directly.

    Args:
        processor: image processor of transformers.
    """
    picture = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    return network_input(processor, [picture], "whole")


def network_input(processor: Any, pictures: Sequence[Picture], fit: Fit) -> Tensor:
    """(N, 3, h, w) float32: what a network is given of pictures of any sizes.

    Args:
        processor: image processor of transformers.
        fit: `whole`: resized to the network's size, nothing is cut, the ratio of sides is lost;
            `published`: as the processor does, CLIP's resizes the shorter side and cuts the middle
            out; `padded`: padded to a square with the processor's mean colour, then as `whole`.
    """
    if fit == "padded":
        pictures = [padded_square(picture, mean_colour(processor)) for picture in pictures]
    options: dict[str, Any] = {}
    if fit != "published":
        options = {"do_resize": True, "size": input_size(processor), "do_center_crop": False}
    images = [Image.fromarray(picture) for picture in pictures]
    pixels: Tensor = processor(images=images, return_tensors="pt", **options)["pixel_values"]
    return pixels.float()


def input_size(processor: Any) -> dict[str, int]:
    """Height and width of what a processor of transformers gives."""
    size = processor.crop_size if processor.do_center_crop else processor.size
    edge = size.get("shortest_edge")
    return {side: edge or size[side] for side in ("height", "width")}


def mean_colour(processor: Any) -> Picture:
    """(3,) the colour that an image processor takes for the mean, rounded down as VQAScore does."""
    return (np.asarray(processor.image_mean) * 255).astype(np.uint8)


def square_crop(
    image: Picture,
    rectangle: tuple[float, float, float, float],
    colour: Picture,
    grow: float = 0.1,
    mask: NDArray[np.bool_] | None = None,
) -> Picture:
    """(S, S, 3) the square about a rectangle, which is wholly in it.

    The rectangle is grown, made square about its centre and rounded outwards to whole pixels. What
    lies beyond the image gets the colour, so that crops at the edge keep their place and scale.

    Args:
        image: (H, W, 3).
        rectangle: left, top, right, bottom in pixels; it may reach beyond the image.
        colour: (3,), see `mean_colour`.
        grow: share of its width and height by which the rectangle grows on every side.
        mask: (H, W); pixels outside of it get the colour too.

    Raises:
        ValueError: the rectangle is empty or not finite, or its square is larger than 8192 pixels.
    """
    low, high = np.asarray(rectangle[:2], np.float64), np.asarray(rectangle[2:], np.float64)
    half = (0.5 + grow) * float(np.max(high - low))
    if not (np.isfinite(half) and np.all(high > low) and 2 * half < MOST_PIXELS):
        raise ValueError(f"square_crop: rectangle {rectangle} of an image {image.shape[:2]}")
    first = np.floor((low + high) / 2 - half).astype(int)
    side = int(np.max(np.ceil((low + high) / 2 + half).astype(int) - first))
    if mask is not None:
        image = np.where(mask[..., None], image, colour)
    return _on_square(image, int(first[0]), int(first[1]), side, colour)


def padded_square(image: Picture, colour: Picture) -> Picture:
    """(S, S, 3) an image (H, W, 3) in the middle of a square of its longer side."""
    height, width = image.shape[:2]
    side = max(height, width)
    return _on_square(image, -((side - width) // 2), -((side - height) // 2), side, colour)


def _on_square(image: Picture, left: int, top: int, side: int, colour: Picture) -> Picture:
    """What an image shows from a column and row on, the colour where it shows nothing."""
    square = np.empty((side, side, 3), np.uint8)
    square[:] = colour
    part = image[max(top, 0) : max(top + side, 0), max(left, 0) : max(left + side, 0)]
    down, right = max(-top, 0), max(-left, 0)
    square[down : down + part.shape[0], right : right + part.shape[1]] = part
    return square


def resized(
    pictures: Sequence[Picture | NDArray[np.float64]], side: int, antialias: bool = False
) -> Tensor:
    """(N, 3, side, side) float32 in [0, 1]: pictures of any sizes, resized bilinearly on the CPU.

    The ratio of their sides is lost.

    Args:
        pictures: (H, W, 3), uint8 or floats in [0, 1].
        antialias: whether the filter widens where a picture shrinks.
    """
    made = []
    for one in pictures:
        pixels = torch.from_numpy(np.ascontiguousarray(one, np.float32)).movedim(-1, 0)[None]
        pixels = pixels / 255 if one.dtype == np.uint8 else pixels
        made.append(functional.interpolate(pixels, side, mode="bilinear", antialias=antialias))
    return torch.cat(made)


@torch.no_grad()
def in_batches(
    compute: Callable[[Sequence[Item]], Tensor],
    items: Sequence[Item],
    width: int,
    size: int = BATCH,
) -> NDArray[np.float64]:
    """(N, width) what `compute` makes of N items, which it gets in order, `size` at a time.

    The last bits of a row depend on how many items were computed with it, on the number of torch's
    threads and on the machine. Work that several processes share therefore gives the same bytes for
    any number of them only if each call gets the items of a fixed unit (such as one rollout) in a
    fixed order with one `size`, and every process has the same number of threads.

    Args:
        compute: function from at most `size` items to (n, width), on any device.
    """
    rows = np.empty((len(items), width))
    for start in range(0, len(items), size):
        rows[start : start + size] = compute(items[start : start + size]).double().cpu().numpy()
    return rows
