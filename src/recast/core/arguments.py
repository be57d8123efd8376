"""Arguments of the public API: checked against the annotations, converted if one reading fits."""

from __future__ import annotations

import builtins
import inspect
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from recast.core.errors import InputError, nearest

Given = ParamSpec("Given")
Result = TypeVar("Result")
Readers = Mapping[type, Callable[[Any], Any]]
"""Function that reads an object from a path, by the object's class."""

_WORDS = {str: "a text", int: "an integer", float: "a number", bool: "True or False"}
_NUMBERS: dict[type, type] = {int: Integral, float: Real}


def checked(
    readers: Readers | None = None,
) -> Callable[[Callable[Given, Result]], Callable[Given, Result]]:
    """Decorator: refuse arguments that the annotations of a function do not allow.

    These are converted: a path if an object with a reader is expected; a number or a path if a text
    is; a single text if a list of texts is. Numbers of numpy become Python's. Protocols are not
    checked.

    Args:
        readers: see `Readers`.

    Returns:
        a decorator. Its function raises InputError that names function, argument and value.
    """

    def decorate(function: Callable[Given, Result]) -> Callable[Given, Result]:
        signature = inspect.signature(function)
        where = function.__qualname__.removesuffix(".__init__")
        known = readers or {}

        @wraps(function)
        def call(*args: Given.args, **options: Given.kwargs) -> Result:
            _require_names(where, signature, options)
            bound = signature.bind(*args, **options)
            for name, value in bound.arguments.items():
                hint = _hints(function).get(name, Any)
                if signature.parameters[name].kind is not inspect.Parameter.VAR_KEYWORD:
                    bound.arguments[name] = _converted(where, name, value, hint, known)
            return function(*bound.args, **bound.kwargs)

        return call

    return decorate


def check_fields(settings: object) -> None:
    """Refuse members of a dataclass that their annotations do not allow; see `checked`.

    Call it in `__post_init__`; members are converted in place.

    Raises:
        InputError: names class, member and value.
    """
    kind: Any = type(settings)
    for name in kind.__dataclass_fields__:
        value = _converted(kind.__name__, name, getattr(settings, name), _hints(kind)[name], {})
        object.__setattr__(settings, name, value)


class _Names(dict[str, Any]):
    """Names in annotations; classes that are imported for type checkers alone match by name."""

    def __missing__(self, name: str) -> type:
        return type(name, (), {"__module__": __name__})


@cache
def _hints(of: Any) -> dict[str, Any]:
    """The resolved annotations of a function or a class, when they are first asked for."""
    names = {**vars(builtins), **vars(sys.modules[of.__module__])}
    return get_type_hints(of, localns=_Names(names))


def _require_names(where: str, signature: inspect.Signature, options: Mapping[str, Any]) -> None:
    parameters = signature.parameters.values()
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters):
        return
    names = [name for name in signature.parameters if name != "self"]
    for name in options:
        if name not in names:
            near = nearest(name, names)
            hint = f"did you mean {near}?" if near else f"the arguments are {', '.join(names)}"
            raise InputError(where, name, "is not an argument", hint)


def _converted(where: str, name: str, value: Any, hint: Any, readers: Readers) -> Any:
    """The value, or what it stands for; see `checked`."""
    choices = _choices(hint)
    for choice in choices:
        if _fits(value, choice):
            number = _NUMBERS.get(choice)
            return choice(value) if number and type(value) is not choice else value
    is_path = isinstance(value, str | os.PathLike)
    for choice in choices:
        if is_path and choice in readers:
            return readers[choice](value)
        if choice is str and isinstance(value, os.PathLike):
            return os.fspath(value)
        if choice is str and Path not in choices and _fits(value, int):
            return str(int(value))
        origin, members = get_origin(choice), get_args(choice)
        if origin is Sequence and is_path:
            return _converted(where, name, (os.fspath(value),), choice, readers)
        if origin is Sequence and isinstance(value, Iterable) and not isinstance(value, Mapping):
            return tuple(
                _converted(where, f"{name}[{index}]", member, members[0], readers)
                for index, member in enumerate(value)
            )
        if origin is Mapping and isinstance(value, Mapping):
            return {
                _converted(where, f"key of {name}", key, members[0], readers): _converted(
                    where, f"{name}[{key!r}]", member, members[1], readers
                )
                for key, member in value.items()
            }
    raise InputError(where, name, f"is {_shown(value)}", _hint(value, choices, readers))


def _choices(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) in (Union, UnionType):
        return tuple(choice for member in get_args(hint) for choice in _choices(member))
    return (hint,)


def _is_bool(value: Any) -> bool:
    return type(value).__name__ in ("bool", "bool_")


def _fits(value: Any, choice: Any) -> bool:
    """Whether a value is of a type already; generic containers are left to `_converted`."""
    if choice is Any or isinstance(choice, TypeVar):
        return True
    if choice in (None, NoneType):
        return value is None
    if choice is bool:
        return _is_bool(value)
    origin = get_origin(choice)
    if origin is Literal:
        return value in get_args(choice)
    if origin in (Sequence, Mapping):
        return False
    kind = _NUMBERS.get(choice) or origin or choice
    if _is_bool(value) and choice in _NUMBERS:
        return False
    if getattr(kind, "__module__", None) == __name__:  # see `_Names`
        return kind.__name__ in (base.__name__ for base in type(value).__mro__)
    try:
        return isinstance(value, kind)
    except TypeError:  # a protocol
        return True


def _shown(value: Any) -> str:
    if value is None or isinstance(value, bool | int | float | str | os.PathLike):
        text = repr(os.fspath(value) if isinstance(value, os.PathLike) else value)
        return text if len(text) < 80 else f"{text[:79]}…"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    return f"an object of type {type(value).__name__}"


def _hint(value: Any, choices: Sequence[Any], readers: Readers) -> str:
    literals = (choice for choice in choices if get_origin(choice) is Literal)
    words = [word for choice in literals for word in get_args(choice)]
    if words and isinstance(value, str):
        near = nearest(value, words)
        return f"did you mean {near}?" if near else f"choose one of {', '.join(words)}"
    if isinstance(value, type):
        return f"call {value.__name__} and give what it returns"
    folders = not readers.keys().isdisjoint(choices)
    named = [choice for choice in choices if choice is not Path and not (folders and choice is str)]
    if Path in choices and not folders:
        named = [Path, *(choice for choice in named if choice is not str)]
    names = [_name(choice, readers) for choice in named]
    return f"give {' or '.join(dict.fromkeys(names))}"


def _name(choice: Any, readers: Readers) -> str:
    if choice in (None, NoneType):
        return "None"
    if choice in _WORDS:
        return _WORDS[choice]
    if choice is Path or getattr(choice, "__name__", "") == "PathLike":
        return "a path"
    origin = get_origin(choice)
    if origin is Literal:
        return f"one of {', '.join(get_args(choice))}"
    if origin is Sequence:
        return f"a list of {_name(get_args(choice)[0], readers).removeprefix('a ')}s"
    if origin is Mapping:
        return "a dict"
    name = getattr(origin or choice, "__name__", "")
    if name == "Callable":
        return "a function"
    noun = f"{'an' if name[:1] in 'AEIO' else 'a'} {name}"
    return f"{noun} or its folder" if choice in readers else noun
