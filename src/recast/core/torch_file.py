"""Foreign files of tensors, of which nothing but tensors and plain values is ever unpickled."""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from pickle import UnpicklingError
from tempfile import TemporaryDirectory
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import disk_errors

DTYPES: Mapping[str, torch.dtype] = {
    "BOOL": torch.bool,
    "U8": torch.uint8,
    "I8": torch.int8,
    "I16": torch.int16,
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "I32": torch.int32,
    "F32": torch.float32,
    "F64": torch.float64,
    "I64": torch.int64,
}
"""Element types by the codes of safetensors, in its own order: files hold the last ones first."""
_PICKLES = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def read_torch_file(
    path: Path, mend: str, field: str = "file", safe: Sequence[tuple[Any, str]] = ()
) -> Any:
    """What a file of `torch.save` holds, its tensors on the CPU, mapped from disk if they can be.

    Args:
        mend: what the user can do about a damaged file.
        field: what the file is, for messages.
        safe: what else it may call, with the names by which it does.

    Raises:
        InputError: the file is missing or damaged, or holds other objects than tensors, plain
            values, lists and dictionaries; no code in it is run. Or it would take more memory than
            the file has bytes: compressed members, or tensors larger than what is stored of them.
    """
    try:
        with disk_errors(path), torch.serialization.safe_globals([*safe]):
            mapped = zipfile.is_zipfile(path)  # not the format before PyTorch 1.6
            if mapped:
                _require_stored(path, field)
            found = torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)
        for tensor in _tensors(found):
            _require_whole(tensor, path, field)
        return found
    except InputError:
        raise
    except Exception as error:  # the unpickler lets through whatever broken bytes lead to
        # PyTorch's own text is a page long and tells the reader to trust the file.
        refused = re.search(r"nsupported (?:global: )?GLOBAL ([\w.]+)", str(error))
        if refused is not None:
            problem = f"holds {refused[1]}, which is not a tensor and is never unpickled"
            mend = "where it was made, save its state dict alone"
            raise InputError(path, field, problem, mend) from None
        reason = "" if isinstance(error, UnpicklingError) else _reason(error)
        problem = f"is damaged or is not a PyTorch checkpoint{reason}"
        raise InputError(path, field, problem, mend) from None


def read_tensors(path: Path, field: str, mend: str) -> dict[str, Tensor]:
    """Tensors by name, on the CPU, of a file that holds nothing else.

    Args:
        path: .safetensors, or anything else as `torch.save` writes it.
        field: what the tensors are, for messages.
        mend: what the user can do about any fault.

    Raises:
        InputError: no file; see `read_torch_file`; or it holds something else than a table of
            tensors.
    """
    if not path.is_file():
        raise InputError(path, field, "is not a file", mend)
    if path.suffix == ".safetensors":
        return read_safetensors(path, field, mend)[0]
    state = read_torch_file(path, mend, field)
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise InputError(path, field, "is not a table of tensors", mend)
    return dict(state)


def read_safetensors(path: Path, field: str, mend: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors by name, mapped from disk until they are copied, and the texts of the header.

    The format has no gaps and no overlaps, so a tensor never has more values than the file holds.

    Raises:
        InputError: the file is missing or damaged, or has a type of numbers that torch lacks.
    """
    with disk_errors(path):
        if not path.is_file():
            raise InputError(path, field, "does not exist or is not a file", "check the path")
    try:
        with opened_safetensors(path) as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, dict(file.metadata() or {})
    except Exception as error:  # of the parser, of torch, of the file system
        raise InputError(path, field, f"cannot be read{_reason(error)}", mend) from None


@contextmanager
def opened_safetensors(path: Path) -> Iterator[Any]:
    """A safetensors file, open for reading, whatever its name.

    Raises:
        SafetensorError, OSError: see `safetensors.safe_open`.
    """
    with ExitStack() as stack:
        if os.fsencode(path) != str(path).encode(errors="replace"):
            # The library takes names as UTF-8 alone.
            folder = Path(stack.enter_context(TemporaryDirectory()))
            (folder / "tensors").symlink_to(path.absolute())
            path = folder / "tensors"
        yield stack.enter_context(safe_open(path, framework="pt"))


def read_header(path: Path, mend: str) -> dict[str, Tensor]:
    """The tensors of a safetensors file on the meta device; nothing but its header is read.

    Raises:
        InputError: the file is missing, truncated, has bytes to spare, or is of another kind,
            such as a pickled PyTorch file.
    """
    with disk_errors(path), path.open("rb") as file:
        pickled = file.read(4).startswith(_PICKLES)
    if pickled:
        problem = "is a pickled PyTorch file, not safetensors"
        hint = "convert it where it came from; pickles are never loaded"
        raise InputError(path, "file", problem, hint)
    tensors = {}
    try:
        with opened_safetensors(path) as file:
            for name in file.keys():  # noqa: SIM118
                found = file.get_slice(name)
                if found.get_dtype() not in DTYPES:
                    problem = f"has an unknown element type ({found.get_dtype()!r})"
                    raise InputError(path, name, problem, mend)
                dtype = DTYPES[found.get_dtype()]
                tensors[name] = torch.empty(found.get_shape(), dtype=dtype, device="meta")
    except (SafetensorError, RuntimeError) as error:
        size = path.stat().st_size
        reason = str(error).partition("\n")[0].removeprefix("Error while deserializing header: ")
        problem = f"has {size} bytes: truncated or not a safetensors file ({reason})"
        raise InputError(path, "file", problem, mend) from None
    return tensors


def _require_stored(path: Path, field: str) -> None:
    """`torch.save` never compresses: compressed bytes would be taken for numbers."""
    with zipfile.ZipFile(path) as archive:
        if any(one.compress_type != zipfile.ZIP_STORED for one in archive.infolist()):
            problem = "is compressed, which no PyTorch checkpoint is"
            raise InputError(path, field, problem, "save it with torch.save")


def _tensors(value: Any) -> Iterator[Tensor]:
    waiting, seen = [value], set()
    while waiting:
        one = waiting.pop()
        if isinstance(one, Tensor):
            yield one
        elif isinstance(one, dict | list | tuple | set) and id(one) not in seen:
            seen.add(id(one))  # lists may hold themselves
            waiting.extend(one.values() if isinstance(one, dict) else one)


def _require_whole(tensor: Tensor, path: Path, field: str) -> None:
    # A few bytes can be expanded to any shape; the first copy of it takes the memory.
    if tensor.layout != torch.strided or tensor.device.type != "cpu" or tensor.is_quantized:
        kind = "quantized" if tensor.is_quantized else str(tensor.layout)
        problem = f"holds a {kind} tensor on {tensor.device}"
        raise InputError(path, field, problem, "save dense tensors")
    stored = tensor.untyped_storage().nbytes()
    if tensor.numel() * tensor.element_size() > stored:
        shape = "x".join(str(size) for size in tensor.shape)
        problem = f"has a tensor of {shape} values, of which {stored} bytes are stored"
        raise InputError(path, field, problem, "save contiguous tensors")


def _reason(error: Exception) -> str:
    """The first sentence of a library's message in brackets; nothing where it has none."""
    lines = str(error).strip().splitlines()
    return f" ({re.split(r'[.] ', lines[0])[0].rstrip('.')})" if lines else ""


def state_faults(
    found: Mapping[str, Tensor], wanted: Mapping[str, Tensor], exact: bool = False
) -> dict[str, dict[str, str]]:
    """What keeps tensors from being loaded: the problem of each tensor at fault, by kind of fault.

    Args:
        found, wanted: tensors by name; those on the meta device count as finite.
        exact: whether another floating-point type is a fault; loading converts between them.
    """
    both = sorted(found.keys() & wanted.keys())
    differs = {name: f"is {_kind(found[name])}, not {_kind(wanted[name])}" for name in both}
    shapes = [name for name in both if found[name].shape != wanted[name].shape]
    types = [
        name
        for name in both
        if found[name].dtype != wanted[name].dtype
        and (exact or found[name].is_floating_point() != wanted[name].is_floating_point())
    ]
    broken = [n for n in both if not found[n].is_meta and not bool(found[n].isfinite().all())]
    return {
        "of another shape": {name: differs[name] for name in shapes},
        "missing": dict.fromkeys(sorted(wanted.keys() - found.keys()), "is missing"),
        "unexpected": dict.fromkeys(sorted(found.keys() - wanted.keys()), "is not expected"),
        "of another type": {name: differs[name] for name in types},
        "not finite": dict.fromkeys(broken, "holds NaN or infinite values"),
    }


def state_error(
    where: str | Path, faults: Mapping[str, Mapping[str, str]], mend: str, owner: str = ""
) -> InputError | None:
    """The error that stands for all of `state_faults`: it names the first and counts the others.

    Args:
        owner: network that the tensors are for, where the file does not tell it.
    """
    first = next((item for fault in faults.values() for item in fault.items()), None)
    if first is None:
        return None
    counts = ", ".join(f"{len(fault)} {kind}" for kind, fault in faults.items() if fault)
    of = f" of {owner}" if owner else ""
    return InputError(where, first[0], f"{first[1]} ({counts}{of})", mend)


def require_state(
    where: str | Path, found: Mapping[str, Tensor], wanted: Mapping[str, Tensor], mend: str
) -> None:
    """Refuse tensors that do not make a network.

    Raises:
        InputError: see `state_error`.
    """
    fault = state_error(where, state_faults(found, wanted), mend)
    if fault is not None:
        raise fault


def _kind(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def checked_weight(
    state: Mapping[str, Tensor], name: str, shape: tuple[int, ...], path: Path, mend: str
) -> Tensor:
    """A tensor of the table in float32.

    Raises:
        InputError: it is missing, of another shape, or has a value that is not finite.
    """
    tensor = state.get(name)
    if tensor is None:
        raise InputError(path, name, "is missing", mend)
    if tuple(tensor.shape) != shape:
        raise InputError(path, name, f"has shape {tuple(tensor.shape)}, not {shape}", mend)
    tensor = tensor.float()
    if not bool(tensor.isfinite().all()):
        raise InputError(path, name, "has values that are not finite", mend)
    return tensor
