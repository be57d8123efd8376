"""The nuScenes JSON tables: the rows of one scene, picked while the files stream past.

The tables hold all scenes of a split at once: sample_data.json and ego_pose.json of the full
dataset have 2.6 million rows in a gigabyte each, so a table is never in memory as a whole.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field, ValidationError

from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.core.records import validation_error
from recast.logs import checks
from recast.logs.importers.common import ForeignRecord

_CHUNK = 1 << 20
_LONGEST_ROW = 1 << 22
"""Characters; what does not end within them is no row."""
_BETWEEN_ROWS = re.compile(r"[\s,]*")
_MEND = "unpack the split's metadata archive again"

Metres = Annotated[float, Field(ge=-checks.WORLD_REACH, le=checks.WORLD_REACH)]
Vector = tuple[Metres, Metres, Metres]
Part = Annotated[float, Field(ge=-2.0, le=2.0)]
Quaternion = tuple[Part, Part, Part, Part]
Time = Annotated[int, Field(ge=0, lt=checks.LATEST_US)]
"""Microseconds since 1970."""
Pixels = Annotated[int, Field(ge=0, lt=1 << 16)]
"""0 for sweeps."""


class NuscenesRow(ForeignRecord):
    """A row of a table; columns that are not named here are not looked at."""

    token: str


class SceneRow(NuscenesRow):
    """scene.json: 20 s of a drive."""

    name: str
    log_token: str


class LogRow(NuscenesRow):
    """log.json: where and when scenes were recorded."""

    location: str = ""
    date_captured: str = ""
    vehicle: str = ""


class SampleRow(NuscenesRow):
    """sample.json: a key frame, two a second; the time of its boxes."""

    timestamp: Time
    scene_token: str


class SampleDataRow(NuscenesRow):
    """sample_data.json: one image or sweep, also between key frames."""

    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: str
    fileformat: str
    timestamp: Time
    is_key_frame: bool
    width: Pixels
    height: Pixels


class EgoPoseRow(NuscenesRow):
    """ego_pose.json: ego to global, one for each image or sweep."""

    timestamp: Time
    rotation: Quaternion
    translation: Vector


class CalibratedSensorRow(NuscenesRow):
    """calibrated_sensor.json: sensor to ego; cameras have intrinsics, others an empty list."""

    sensor_token: str
    rotation: Quaternion
    translation: Vector
    camera_intrinsic: list[list[float]]


class SensorRow(NuscenesRow):
    """sensor.json: name (channel) and kind (modality) of a sensor."""

    channel: str
    modality: str


class AnnotationRow(NuscenesRow):
    """sample_annotation.json: a box at a key frame; width, length, height; box to global."""

    sample_token: str
    instance_token: str
    translation: Vector
    size: Vector
    rotation: Quaternion


class InstanceRow(NuscenesRow):
    """instance.json: an object through its scene."""

    category_token: str


class CategoryRow(NuscenesRow):
    """category.json: a kind of object, such as vehicle.car."""

    name: str


Table = TypeVar("Table", bound=NuscenesRow)


def stream_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Rows of a table, one at a time. Raises InputError: the file is missing, cut off, or no JSON
    list of objects."""
    if not path.is_file():
        raise InputError(path, "table", "is missing", _MEND)
    decoder = json.JSONDecoder()
    with disk_errors(path), path.open(encoding="utf-8-sig", errors="replace") as file:
        text, at, row = file.read(_CHUNK).lstrip(), 1, 0
        if not text.startswith("["):
            raise InputError(path, "JSON", "does not begin with a list of rows", _MEND)
        while True:
            at = _BETWEEN_ROWS.match(text, at).end()  # type: ignore[union-attr]
            if text.startswith("]", at):
                return
            try:
                value, at = decoder.raw_decode(text, at)
            except json.JSONDecodeError as error:
                more = file.read(_CHUNK) if len(text) - at < _LONGEST_ROW else ""
                if not more:
                    problem = f"cannot be read ({error.msg}): broken or cut off"
                    raise InputError(path, f"row {row}", problem, _MEND) from None
                text, at = text[at:] + more, 0
                continue
            except (RecursionError, ValueError) as error:  # nested too deeply, or too many digits
                reason = str(error).split(";")[0]
                problem = f"cannot be read ({reason})"
                raise InputError(path, f"row {row}", problem, _MEND) from None
            if not isinstance(value, dict):
                raise InputError(path, f"row {row}", "is not an object", _MEND)
            yield value
            row += 1


def select(
    path: Path, model: type[Table], column: str = "token", values: Collection[str] | None = None
) -> list[Table]:
    """Rows whose `column` is one of `values` (any, where None), checked, in the file's order.
    Raises InputError: see `stream_rows`; a column is missing or wrong."""
    found = []
    for number, row in enumerate(stream_rows(path)):
        if not isinstance(row.get(column), str):
            problem = f"column {column} is missing or not text"
            raise InputError(path, f"row {number}", problem, _MEND)
        if values is not None and row[column] not in values:
            continue
        try:
            found.append(model.model_validate(row))
        except ValidationError as error:
            fault = validation_error(path, error, _MEND)
            field = f"row {number} (token {row.get('token')}): {fault.field}"
            raise InputError(path, field, fault.problem, _MEND) from None
    return found


def linked(
    folder: Path,
    table: str,
    model: type[Table],
    rows: Sequence[NuscenesRow],
    source: str,
    column: str,
) -> Mapping[str, Table]:
    """Rows by token of `table`.json that `column` of `rows` (of `source`.json) names. Raises
    InputError: see `select`; a token is not in the table."""
    if not rows:  # a dataset without boxes needs no table of their kinds
        return {}
    wanted = {getattr(row, column) for row in rows}
    found = {row.token: row for row in select(folder / f"{table}.json", model, values=wanted)}
    for row in rows:
        token = getattr(row, column)
        if token not in found:
            problem = f"{token!r} is not in {table}.json"
            field = f"token {row.token}: {column}"
            raise InputError(folder / f"{source}.json", field, problem, _MEND)
    return found
