"""Arguments of public functions: which are converted, which are refused, and how."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import pytest

from recast.core.arguments import check_fields, checked
from recast.core.errors import InputError

if TYPE_CHECKING:
    from fractions import Fraction


@dataclass
class Box:
    """An object that lies in a folder."""

    folder: str = ""


class Painter(Protocol):
    """A protocol, which is not checked."""


@dataclass(frozen=True)
class Base:
    """Settings whose members are checked."""

    steps: int = 3

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Derived(Base):
    """Settings with a further member."""

    names: Sequence[str] = ()


@checked({Box: lambda path: Box(str(path))})
def pack(
    box: Box,
    track: str = "0",
    *,
    out: str | Path | None = None,
    names: Sequence[str] = (),
    kind: Literal["red", "green"] = "red",
    views: int = 1,
    scale: float = 1.0,
    quick: bool = False,
    motions: Mapping[str, Sequence[str]] | None = None,
    call: Callable[[], None] | None = None,
    share: Fraction | None = None,
    painter: Painter | None = None,
) -> dict[str, Any]:
    """All arguments by name."""
    return locals()


@pytest.mark.parametrize(
    ("name", "value", "right"),
    [
        ("box", Path("a"), Box("a")),
        ("track", 0, "0"),
        ("track", np.int64(3), "3"),
        ("track", Path("a/b"), "a/b"),
        ("names", "one", ("one",)),
        ("names", [1, "b"], ("1", "b")),
        ("names", (word for word in "ab"), ("a", "b")),
        ("views", np.int32(2), 2),
        ("scale", 1, 1.0),
        ("motions", {0: "cut-in"}, {"0": ("cut-in",)}),
        ("painter", 3, 3),
    ],
)
def test_what_has_one_reading_is_converted(name: str, value: Any, right: Any) -> None:
    got = pack(**{"box": Box(), name: value})[name]  # type: ignore[arg-type]
    assert got == right and type(got) is type(right)


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("box", None, "box: is None; give a Box or its folder"),
        ("box", Box, "box: is the class Box; call Box and give what it returns"),
        ("box", [1], "box: is an object of type list; give a Box or its folder"),
        ("track", None, "track: is None; give a text"),
        ("track", True, "track: is True; give a text"),
        ("out", 7, "out: is 7; give a path or None"),
        ("names", 3, "names: is 3; give a list of texts"),
        ("names", ["a", None], "names[1]: is None; give a text"),
        ("kind", "gren", "kind: is 'gren'; did you mean green?"),
        ("kind", "xyz", "kind: is 'xyz'; choose one of red, green"),
        ("views", "3", "views: is '3'; give an integer"),
        ("views", True, "views: is True; give an integer"),
        ("views", 1.5, "views: is 1.5; give an integer"),
        ("scale", "big", "scale: is 'big'; give a number"),
        ("quick", "no", "quick: is 'no'; give True or False"),
        ("motions", ["0"], "motions: is an object of type list; give a dict or None"),
        ("call", 3, "call: is 3; give a function or None"),
        ("share", 3, "share: is 3; give a Fraction or None"),
        ("trakc", "0", "trakc: is not an argument; did you mean track?"),
    ],
)
def test_what_does_not_fit_is_one_line(name: str, value: Any, line: str) -> None:
    with pytest.raises(InputError) as refused:
        if name == "trakc":
            checked()(lambda track: track)(**{name: value})
        pack(**{"box": Box(), name: value})  # type: ignore[arg-type]
    assert str(refused.value).partition(": ")[2] == line


def test_members_of_settings_are_checked_as_arguments_are() -> None:
    made = Derived(np.int64(4), names="one")  # type: ignore[arg-type]
    assert made == Derived(4, ("one",)) and type(made.steps) is int
    with pytest.raises(InputError, match=r"^Derived: steps: is '4'; give an integer$"):
        Derived("4")  # type: ignore[arg-type]
