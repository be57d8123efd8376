"""Protocol buffers on the wire, read by tables of field numbers.

Source: the protocol buffers encoding guide. A message is a row of fields, each a key (number and
wire type) and a value: 0 varint, 1 eight bytes, 2 length and bytes, 5 four bytes. Fields that the
table does not name are skipped.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5


class Kind(Enum):
    """Kinds of plain values."""

    INT = "int"  # int32, int64, bool: varint, negative as two's complement of 64 bits
    DOUBLE = "double"
    FLOAT = "float"
    STRING = "string"
    SPAN = "span"  # bytes or a message left alone: a slice of the data


@dataclass(frozen=True)
class Choice:
    """An enumeration: names by number."""

    name: str
    names: Mapping[int, str]

    def of(self, number: int, where: str) -> str:
        """The name of `number`; raises FieldError where it has none."""
        if number not in self.names:
            known = ", ".join(f"{key} {name}" for key, name in self.names.items())
            raise FieldError(where, f"is {number}, no {self.name} ({known})")
        return self.names[number]


@dataclass(frozen=True)
class Schema:
    """A message: its fields by number."""

    name: str
    fields: Mapping[int, Field]


@dataclass(frozen=True)
class Field:
    """One row of a schema.

    Attributes:
        name: as in the dataset's proto files.
        kind: of the value.
        repeated: whether it may come more than once.
        wire: wire type of one value.
        number: how to read a double or float, else None.
    """

    name: str
    kind: Kind | Choice | Schema
    repeated: bool
    wire: int
    number: struct.Struct | None


def one(name: str, kind: Kind | Choice | Schema) -> Field:
    """A field that is there once or not at all."""
    return _row(name, kind, repeated=False)


def many(name: str, kind: Kind | Choice | Schema) -> Field:
    """A repeated field, packed or not."""
    return _row(name, kind, repeated=True)


def _row(name: str, kind: Kind | Choice | Schema, repeated: bool) -> Field:
    wire = BYTES
    if kind is Kind.INT or isinstance(kind, Choice):
        wire = VARINT
    elif kind in (Kind.DOUBLE, Kind.FLOAT):
        wire = FIXED64 if kind is Kind.DOUBLE else FIXED32
    return Field(name, kind, repeated, wire, _NUMBERS.get(wire))


_NUMBERS = {FIXED64: struct.Struct("<d"), FIXED32: struct.Struct("<f")}


class FieldError(ValueError):
    """A field at fault, named from the record downwards, such as images[2].pose."""

    def __init__(self, field: str, problem: str) -> None:
        self.field = field
        self.problem = problem
        super().__init__(f"{field}: {problem}")


@dataclass(frozen=True)
class Message:
    """A decoded message.

    Attributes:
        where: its name from the record downwards.
        values: by field name. Repeated doubles and floats are arrays, other repeated fields lists;
            those that may come once are absent where they are not there.
    """

    where: str
    values: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        """The value of a field; raises FieldError where it is absent."""
        if name not in self.values:
            raise FieldError(self.path(name), "is missing")
        return self.values[name]

    def get(self, name: str, otherwise: Any = None) -> Any:
        """The value of a field, or `otherwise`."""
        return self.values.get(name, otherwise)

    def path(self, name: str) -> str:
        """The name of a field from the record downwards."""
        return f"{self.where}.{name}" if self.where else name


def decode(schema: Schema, data: bytes, span: slice | None = None, where: str = "") -> Message:
    """Decode a message in `data`, or in the part `span` of it.

    Raises:
        FieldError: the bytes are no such message, or an enumeration has an unknown value.
    """
    begin, end = (0, len(data)) if span is None else (span.start, span.stop)
    # Repeated doubles and floats are gathered as they are stored: as objects they would take far
    # more memory than the file.
    repeated = [row for row in schema.fields.values() if row.repeated]
    message = Message(where, {f.name: bytearray() if f.number else [] for f in repeated})
    values = message.values
    for number, wire, value in fields(data, begin, end, where or schema.name):
        row = schema.fields.get(number)
        if row is None:
            continue
        if row.repeated and wire == BYTES != row.wire:
            values[row.name] += _packed(row, value, data, message)
            continue
        if wire != row.wire:
            raise FieldError(message.path(row.name), f"has wire type {wire}, not {row.wire}")
        if row.repeated and row.number:
            values[row.name] += data[value]
            continue
        item = row.number.unpack_from(data, value.start)[0] if row.number else value
        if row.kind is not Kind.SPAN and not row.number:
            item = _value(row, value, data, message)
        if row.repeated:
            values[row.name].append(item)
        else:
            values[row.name] = item
    for gathered in repeated:
        if gathered.number:
            values[gathered.name] = np.frombuffer(values[gathered.name], gathered.number.format)
    return message


def fields(data: bytes, at: int, end: int, where: str) -> Iterator[tuple[int, int, Any]]:
    """Number, wire type and value of each field; an int for varints, else a slice of the data.

    Raises:
        FieldError: the bytes from `at` to `end` are no message.
    """
    while at < end:
        key, at = _varint(data, at, end, where)
        number, wire = key >> 3, key & 7
        if wire == VARINT:
            value, at = _varint(data, at, end, where)
            yield number, wire, value
            continue
        if wire == BYTES:
            length, at = _varint(data, at, end, where)
        elif wire in (FIXED64, FIXED32):
            length = 8 if wire == FIXED64 else 4
        else:
            raise FieldError(where, f"is no protocol buffer: field {number} has wire type {wire}")
        if at + length > end:
            raise FieldError(where, f"field {number} is cut off")
        yield number, wire, slice(at, at + length)
        at += length


def _varint(data: bytes, at: int, end: int, where: str) -> tuple[int, int]:
    value = shift = 0
    while at < end and shift < 70:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise FieldError(where, "is no protocol buffer: a number is cut off")


def _value(row: Field, value: Any, data: bytes, message: Message) -> Any:
    if row.kind is Kind.INT:
        return _signed(value)
    where = message.path(row.name)
    if row.repeated:
        where = f"{where}[{len(message.values[row.name])}]"
    if isinstance(row.kind, Schema):
        return decode(row.kind, data, value, where)
    if isinstance(row.kind, Choice):
        return row.kind.of(_signed(value), where)
    try:
        return data[value].decode()
    except UnicodeDecodeError:
        raise FieldError(where, "is no text") from None


def _signed(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value


def _packed(row: Field, span: slice, data: bytes, message: Message) -> bytes | list[Any]:
    where = message.path(row.name)
    if row.number:
        if (span.stop - span.start) % row.number.size:
            raise FieldError(where, "is cut off")
        return data[span]
    numbers, at = [], span.start
    while at < span.stop:
        value, at = _varint(data, at, span.stop, where)
        numbers.append(_signed(value))
    return numbers
