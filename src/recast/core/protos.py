"""Classes of protocol-buffer messages, made at run time from a table in the language of .proto
files: no generated code, no clash with another package's messages of the same names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Literal, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory

_BLOCK = re.compile(r"(message|enum) (\w+) {(.*?)}", re.DOTALL)
_FIELD = re.compile(r"(?:(optional|repeated) )?([\w.]+) (\w+) = (\d+);")
_VALUE = re.compile(r"(\w+) = (\d+);")
_PROTO = descriptor_pb2.FieldDescriptorProto
_SCALARS = frozenset(
    name.removeprefix("TYPE_").lower()
    for name in _PROTO.Type.keys()  # noqa: SIM118 - an enumeration of protobuf, not a dict
    if name not in ("TYPE_MESSAGE", "TYPE_ENUM", "TYPE_GROUP")
)


class ProtoField(NamedTuple):
    """A field of a message; `kind` is a scalar type or the name of a message or enumeration."""

    repeated: bool
    kind: str
    number: int


def message_fields(table: str) -> dict[str, dict[str, ProtoField]]:
    """Fields of each message of a table, by message and name."""
    return {
        name: {f[2]: ProtoField(f[0] == "repeated", f[1], int(f[3])) for f in _FIELD.findall(body)}
        for what, name, body in _BLOCK.findall(table)
        if what == "message"
    }


def message_classes(
    tables: Mapping[str, str],
    syntax: Literal["proto2", "proto3"],
    aliases: Mapping[str, str] | None = None,
) -> dict[str, type[message.Message]]:
    """Classes of all messages by full name, such as "common.Pose", in a pool of their own.

    Args:
        tables: messages and enumerations by package: the language of .proto files without nesting,
            oneof, services and imports. A package may name types of those before it in full.
        syntax: whether a scalar of the value 0 is left out ("proto3") or has presence ("proto2").
        aliases: scalar types that stand for names of the tables.

    Raises:
        TypeError: a field has an unknown type, or a number is given twice.
    """
    aliases = aliases or {}
    blocks = [
        (package, *block) for package, text in tables.items() for block in _BLOCK.findall(text)
    ]
    enums = {f"{package}.{name}" for package, what, name, _ in blocks if what == "enum"}
    messages = [f"{package}.{name}" for package, what, name, _ in blocks if what == "message"]
    fields = {package: message_fields(text) for package, text in tables.items()}
    pool = descriptor_pool.DescriptorPool()
    before: list[str] = []
    for package, text in tables.items():
        file = descriptor_pb2.FileDescriptorProto(
            name=f"{package}.proto", package=package, syntax=syntax, dependency=before
        )
        for what, name, body in _BLOCK.findall(text):
            if what == "enum":
                values = file.enum_type.add(name=name).value
                for key, number in _VALUE.findall(body):
                    # Values are siblings of their enumeration, so that UNKNOWN can be there once.
                    values.add(name=f"{name}_{key}", number=int(number))
                continue
            proto = file.message_type.add(name=name)
            for key, (repeated, kind, number) in fields[package][name].items():
                label = _PROTO.LABEL_REPEATED if repeated else _PROTO.LABEL_OPTIONAL
                field = proto.field.add(name=key, number=number, label=label)
                kind = aliases.get(kind, kind)
                if kind in _SCALARS:
                    field.type = _PROTO.Type.Value(f"TYPE_{kind.upper()}")
                    continue
                full = kind if "." in kind else f"{package}.{kind}"
                field.type = _PROTO.TYPE_ENUM if full in enums else _PROTO.TYPE_MESSAGE
                field.type_name = f".{full}"
        pool.Add(file)
        before.append(file.name)
    found = {name: pool.FindMessageTypeByName(name) for name in messages}
    return {name: message_factory.GetMessageClass(kind) for name, kind in found.items()}
