"""Designs as rows of numbers: what the parametric model reads and writes, told by annotations.

A tree of frozen dataclasses is flattened to numbers and choices. `Annotated[float, (low, high)]` is
a number that is clipped to its range, `float` one without a range, `Literal` and `bool` are
choices. So a new field of a design needs no code here.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from recast.actors.template.design import STYLES, VehicleDesign
from recast.arrays import Array, Int64Array
from recast.core.errors import InputError

_STYLES: Any = Literal[tuple(sorted(STYLES))]


@dataclasses.dataclass(frozen=True)
class VehicleLook:
    """Paint and light of a vehicle in its photograph.

    Attributes:
        red, green, blue: display values of the paint's reflectance.
        level: binary logarithm of the light's level, see `Daylight`.
        mirror: binary logarithm of the factor on mirrored light over the level.
        clouds: hue of the mirrored sky, 0 (clear) to 1 (overcast).
        panes, pane_mirror: factors on the diffuse and the mirrored light of windows.
        rims: brightness of the wheels' metal over the model's.
    """

    red: Annotated[float, (0.03, 0.95)]
    green: Annotated[float, (0.03, 0.95)]
    blue: Annotated[float, (0.03, 0.95)]
    level: Annotated[float, (-2.5, 1.0)]
    mirror: Annotated[float, (-1.5, 1.5)]
    clouds: Annotated[float, (0.0, 1.0)]
    panes: Annotated[float, (0.0, 2.5)]
    pane_mirror: Annotated[float, (0.0, 1.5)]
    rims: Annotated[float, (0.1, 1.3)]


@dataclasses.dataclass(frozen=True)
class ParametricVehicle:
    """All that the parametric model tells of a vehicle."""

    style: _STYLES  # name in `STYLES`
    design: VehicleDesign
    look: VehicleLook


@dataclasses.dataclass(frozen=True)
class CodecField:
    """A number in [low, high], or a choice among `choices`."""

    path: str  # names from the root, such as "design.front.lamp_z"
    low: float = -np.inf
    high: float = np.inf
    choices: tuple[Any, ...] = ()

    @property
    def record(self) -> list[Any]:
        """Path and choices, as JSON. Ranges are left out: they only clip."""
        return [self.path, list(self.choices)]


def fields_of(kind: Any, path: str = "") -> Iterator[CodecField]:
    """The fields of an annotated type, in order.

    Raises:
        TypeError: an annotation that is none of those above.
    """
    low, high = -np.inf, np.inf
    if get_origin(kind) is Annotated:
        kind, *notes = get_args(kind)
        ranges = [note for note in notes if isinstance(note, tuple) and len(note) == 2]
        low, high = ranges[0] if ranges else (low, high)
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind, include_extras=True)
        for field in dataclasses.fields(kind):
            yield from fields_of(hints[field.name], f"{path}.{field.name}".lstrip("."))
    elif kind is float:
        yield CodecField(path, low, high)
    elif kind is bool:
        yield CodecField(path, choices=(False, True))
    elif get_origin(kind) is Literal:
        yield CodecField(path, choices=get_args(kind))
    else:
        raise TypeError(f"{path}: {kind} cannot be coded")


class DesignCodec:
    """Numbers (N,) and choices (M,) of a vehicle, and back.

    Args:
        kind: annotated type of what is coded.
    """

    def __init__(self, kind: Any = ParametricVehicle) -> None:
        self.kind = kind
        fields = list(fields_of(kind))
        self.numbers = [one for one in fields if not one.choices]
        self.choices = [one for one in fields if one.choices]
        self._low, self._high = np.array([(one.low, one.high) for one in self.numbers]).T

    @property
    def record(self) -> str:
        """The fields as JSON, to be kept beside weights."""
        return json.dumps([one.record for one in (*self.numbers, *self.choices)])

    def check(self, record: str, where: str | Path) -> None:
        """Refuse the record of weights that were trained for other fields.

        Raises:
            InputError: the first field that differs.
        """
        own, other = json.loads(self.record), json.loads(record)
        if own == other:
            return
        for mine, theirs in zip(own, other, strict=False):
            if mine != theirs:
                break
        else:
            longer = max(own, other, key=len)
            mine = theirs = longer[min(len(own), len(other))]
        fix = "train it again (recast recar parametric), or install the matching release"
        problem = f"is {_said(theirs)} in the weights"
        if mine == theirs:
            problem = f"is only in {'this version' if len(own) > len(other) else 'the weights'}"
        raise InputError(where, f"field {mine[0]}", problem, fix)

    def encode(self, vehicle: Any) -> tuple[Array, Int64Array]:
        """Numbers (N,) and indices (M,) of choices.

        Raises:
            ValueError: a value is none of the choices.
        """
        values = dict(_flatten(vehicle))
        numbers = np.array([values[one.path] for one in self.numbers], np.float64)
        return numbers, np.array([one.choices.index(values[one.path]) for one in self.choices])

    def decode(self, numbers: Array, choices: Sequence[int] | Int64Array) -> Any:
        """The vehicle of numbers (N,) and indices of choices (M,); numbers are clipped."""
        clipped = np.clip(np.asarray(numbers, np.float64), self._low, self._high)
        pairs = zip(self.numbers, clipped, strict=True)
        values: dict[str, Any] = {one.path: float(value) for one, value in pairs}
        for one, index in zip(self.choices, choices, strict=True):
            values[one.path] = one.choices[int(index)]
        return _build(self.kind, values, "")


def _said(record: list[Any]) -> str:
    path, choices = record
    return f"{path} (one of {', '.join(map(str, choices))})" if choices else f"the number {path}"


def _flatten(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _flatten(getattr(value, field.name), f"{path}.{field.name}".lstrip("."))
    else:
        yield path, value


def _build(kind: Any, values: dict[str, Any], path: str) -> Any:
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind, include_extras=True)
        made: Any = kind
        return made(
            **{
                field.name: _build(hints[field.name], values, f"{path}.{field.name}".lstrip("."))
                for field in dataclasses.fields(kind)
            }
        )
    return values[path]
