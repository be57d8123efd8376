"""What a person decided about targets: screening.json, beside cache.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from recast import storage
from recast.recar.record import IdentityName
from recast.records import validation_error

SCREENING_FILE = "screening.json"

Decision = Literal["accept", "reject", "flip"]
"""Keep, leave out, or keep turned by 180 degrees about z."""

_DECISIONS: TypeAdapter[dict[str, Decision]] = TypeAdapter(dict[IdentityName, Decision])


def read_decisions(folder: str | Path) -> dict[str, Decision]:
    """Decisions of a cache by vehicle; empty where nobody has screened it.

    Raises:
        InputError: screening.json is no JSON, or holds something else.
    """
    path = Path(folder) / SCREENING_FILE
    if not path.exists():
        return {}
    try:
        return _DECISIONS.validate_python(storage.read_json(path))
    except ValidationError as error:
        raise validation_error(path, error, "correct or remove the file") from None


def write_decisions(folder: str | Path, decisions: Mapping[str, Decision]) -> None:
    """Write all decisions of a cache, whole or not at all.

    Raises:
        InputError: the disk is full.
    """
    storage.write_json(Path(folder) / SCREENING_FILE, dict(sorted(decisions.items())))
