"""Message classes from a table."""

from __future__ import annotations

import pytest

from recast.core.protos import ProtoField, message_classes, message_fields

TABLES = {
    "a": "enum Colour { RED = 0; BLUE = 2; } message Point { float x = 1; Colour colour = 3; }",
    "b.c": "message Line { repeated a.Point points = 1; Own own = 2; } message Own {bytes x = 9;}",
}


def test_classes_refer_to_each_other_over_packages() -> None:
    made = message_classes(TABLES, "proto3")
    assert list(made) == ["a.Point", "b.c.Line", "b.c.Own"]
    line = made["b.c.Line"](points=[made["a.Point"](x=1.0, colour=2)], own=made["b.c.Own"](x=b"z"))
    assert line.SerializeToString().hex() == "0a070d0000803f180212034a017a"
    assert made["a.Point"](x=0.0).SerializeToString() == b""


def test_presence_and_aliases() -> None:
    text = "message Point { optional float x = 1; optional Colour colour = 3; }"
    point = message_classes({"a": text}, "proto2", {"Colour": "int32"})["a.Point"]
    assert point(x=0.0).SerializeToString().hex() == "0d00000000"
    assert point(colour=-1).colour == -1


def test_fields() -> None:
    assert message_fields(TABLES["b.c"])["Line"] == {
        "points": ProtoField(True, "a.Point", 1),
        "own": ProtoField(False, "Own", 2),
    }


@pytest.mark.parametrize("body", ["Nothing x = 1;", "float x = 1; float y = 1;", "float x = 0;"])
def test_a_wrong_table_is_refused(body: str) -> None:
    with pytest.raises(TypeError):
        message_classes({"a": f"message Point {{ {body} }}"}, "proto3")
