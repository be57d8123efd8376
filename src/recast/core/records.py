"""Versioned JSON records from disk, checked against a pydantic model."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from reprlib import Repr
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from recast.core import files
from recast.core.errors import InputError, nearest

Model = TypeVar("Model", bound=BaseModel)

_SHORT = Repr()
"""Shows any value in little time: `repr` would follow all levels and all digits of it."""
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxother, _SHORT.maxlong = 3, 60, 60, 60


class Record(BaseModel):
    """Base of configurations and records: immutable, every member known, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def read_record(
    path: str | Path, model: type[Model], version: int, mend: str, kind: str | None = None
) -> Model:
    """Read a JSON file; see `parse_record`, and `files.read_json` for what else it raises."""
    return parse_record(path, files.read_json(path), model, version, mend, kind)


def parse_record(
    where: str | Path,
    value: Any,
    model: type[Model],
    version: int,
    mend: str,
    kind: str | None = None,
) -> Model:
    """Check JSON data that was read from `where`.

    Args:
        version: the only value of its member "version" that can be read.
        mend: what the user can do about any fault.
        kind: the value its member "format" must have, if there is one.

    Raises:
        InputError: no object, another format or version, or the first member that is wrong.
    """
    if not isinstance(value, dict):
        raise InputError(where, "JSON", "is not an object", mend)
    if kind is not None and value.get("format") != kind:
        raise InputError(where, "format", f"is {value.get('format')!r}, not {kind!r}", mend)
    if value.get("version") != version:
        found = value.get("version")
        raise InputError(where, "version", f"is {found!r}, this recast reads {version}", mend)
    return validated(where, value, model, mend)


def validated(where: str | Path, value: Any, model: type[Model], mend: str) -> Model:
    """Plain data from JSON or YAML as a model, whatever its format and version.

    Raises:
        InputError: the first member that is wrong.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise validation_error(where, error, mend) from None
    except (RecursionError, OverflowError) as error:  # before the member at fault was known
        raise InputError(where, "JSON", f"cannot be read ({error})", mend) from None


def validation_error(
    where: str | Path, error: ValidationError, mend: str, fields: Iterable[str] = ()
) -> InputError:
    """The first fault of a pydantic check as the error that users see.

    Args:
        where: file, or name of the settings.
        error: what pydantic raised.
        mend: hint, unless a field is unknown and one of `fields` is spelled alike.
        fields: names that may stand in place of an unknown one.
    """
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"]) or "record"
    if first["type"] == "extra_forbidden" and (near := nearest(field, fields)):
        return InputError(where, field, "is not a known name", f"did you mean {near}?")
    shown = _SHORT.repr(first["input"])
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return InputError(where, field, f"{first['msg']} (found {shown})", mend)
