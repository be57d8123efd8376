"""Compares the tensors of a file with those that a model of its class has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from recast.errors import InputError
from recast.trellis.checkpoints.layout import DTYPES, TensorSpec, file_bytes

_MEND = "fetch or write the file anew"


@dataclass(frozen=True)
class ModelCheck:
    """What was found of one model, and what its class expects.

    Attributes:
        role: in `pipeline.json`.
        file: the weights, or what names them.
        class_name: published name of the class; empty where it could not be told.
        found: type and shape of each tensor in the file.
        expected: type and shape of each tensor of the class.
        bytes_found: size of the file.
        parameters: trainable numbers of the class, saved buffers left out.
        not_finite: tensors with NaN or infinite values; only where values were read.
        error: the file cannot be read, or its class cannot be built; nothing else is known then.
        note: why nothing was checked, of a model that may be absent.
    """

    role: str
    file: Path
    class_name: str = ""
    found: Mapping[str, TensorSpec] | None = None
    expected: Mapping[str, TensorSpec] | None = None
    bytes_found: int = 0
    parameters: int = 0
    not_finite: tuple[str, ...] = ()
    error: InputError | None = None
    note: str = ""

    @property
    def missing(self) -> tuple[str, ...]:
        """Tensors of the class that the file lacks."""
        return tuple(sorted({*(self.expected or ())} - {*(self.found or ())}))

    @property
    def unexpected(self) -> tuple[str, ...]:
        """Tensors of the file that the class does not have."""
        return tuple(sorted({*(self.found or ())} - {*(self.expected or ())}))

    @property
    def wrong_shape(self) -> tuple[str, ...]:
        """Tensors of another shape."""
        return tuple(name for name, found, wanted in self._both() if found.shape != wanted.shape)

    @property
    def wrong_dtype(self) -> tuple[str, ...]:
        """Tensors of another element type; loading converts between floating-point types."""
        return tuple(name for name, found, wanted in self._both() if found.dtype != wanted.dtype)

    @property
    def bytes_expected(self) -> int:
        """Size of the file of this class without metadata."""
        return file_bytes(self.expected) if self.expected else 0

    def fault(self, *, loading: bool = False) -> InputError | None:
        """The error that stands for all that is wrong, or None.

        It names the file and the first bad tensor, and counts the others.

        Args:
            loading: let another floating-point type pass, which loading converts.
        """
        if self.error is not None:
            return self.error
        dtypes = tuple(n for n in self.wrong_dtype if not (loading and self._converts(n)))
        for names, problem in (
            (self.wrong_shape, self._difference),
            (self.missing, lambda name: f"is missing of {self.class_name}"),
            (self.unexpected, lambda name: f"is not expected in {self.class_name}"),
            (dtypes, self._difference),
            (self.not_finite, lambda name: "holds NaN or infinite values"),
        ):
            if names:
                counts = (
                    f"{len(self.missing)} missing, {len(self.unexpected)} unexpected, "
                    f"{len(self.wrong_shape)} of another shape, {len(dtypes)} of another type"
                )
                if self.not_finite:
                    counts += f", {len(self.not_finite)} not finite"
                return InputError(self.file, names[0], f"{problem(names[0])} ({counts})", _MEND)
        return None

    def _both(self) -> list[tuple[str, TensorSpec, TensorSpec]]:
        found, expected = self.found or {}, self.expected or {}
        return [(name, found[name], expected[name]) for name in sorted({*found} & {*expected})]

    def _difference(self, name: str) -> str:
        assert self.found and self.expected
        return f"is {self.found[name]}, {self.class_name} has {self.expected[name]}"

    def _converts(self, name: str) -> bool:
        assert self.found
        return DTYPES[self.found[name].dtype].is_floating_point
