"""A device that is not there: tensors with the numbers of the CPU that refuse to meet the CPU's.

As on a GPU, an operation on tensors of two devices fails, `.numpy()` fails, and only `.to` and
`copy_` lead from one to the other. So code for a GPU can be run, numbers and all, where none is.
PyTorch calls the device "meta", the one beside "cpu" whose backward pass any build has.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_flatten, tree_map_only

ELSEWHERE = torch.device("meta")
_CROSSING = {torch.ops.aten.copy_.default, torch.ops.aten._to_copy.default}
_INDEXED = {
    torch.ops.aten.index.Tensor,
    torch.ops.aten.index_put_.default,
    torch.ops.aten._index_put_impl_.default,
}


class _There(Tensor):
    @staticmethod
    def __new__(cls, inner: Tensor) -> _There:
        return Tensor._make_wrapper_subclass(
            cls,
            inner.shape,
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            device=ELSEWHERE,
        )

    def __init__(self, inner: Tensor) -> None:
        self.inner = inner

    def __repr__(self) -> str:
        return f"elsewhere({self.inner})"

    @classmethod
    def __torch_dispatch__(
        cls, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        return _run(func, args, kwargs or {})


class _Elsewhere(TorchDispatchMode):
    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        return _run(func, args, kwargs or {})


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    given = [t for t in tree_flatten((args, kwargs))[0] if isinstance(t, Tensor)]
    goes = any(isinstance(t, _There) for t in given)
    if not goes and kwargs.get("device") is None:
        return func(*args, **kwargs)
    if goes and func not in _CROSSING:
        # A GPU's tensors may be indexed by the CPU's, and go together with its single numbers.
        met = tree_flatten((args[0], *args[2:]))[0] if func in _INDEXED else given
        here = [t for t in met if not isinstance(t, _There) and t.ndim > 0]
        if here:
            raise RuntimeError(f"{func}: tensors of two devices, shapes {[t.shape for t in here]}")
    if func is torch.ops.aten.copy_.default:
        goes = isinstance(args[0], _There)
    if kwargs.get("device") is not None:
        goes = torch.device(kwargs["device"]) == ELSEWHERE
        kwargs = {**kwargs, "device": "cpu"}
    inner_args, inner_kwargs = tree_map_only(_There, lambda t: t.inner, (args, kwargs))
    out = func(*inner_args, **inner_kwargs)
    if not goes:
        return out
    wrapped = tree_map_only(Tensor, _There, out)
    return return_and_correct_aliasing(func, args, kwargs, wrapped) if _aliases(func) else wrapped


@cache
def _aliases(func: Any) -> bool:
    """Whether results share memory with arguments: views, and what works in place."""
    return any(result.alias_info is not None for result in func._schema.returns)


@contextmanager
def elsewhere() -> Iterator[torch.device]:
    """Inside, the device given can be used."""
    with _Elsewhere():
        yield ELSEWHERE
