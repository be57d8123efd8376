"""Making a vehicle set, one identity after the other, so that a killed run resumes."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from recast import storage
from recast.errors import InputError
from recast.recar.picture import Image, encode_picture
from recast.recar.record import IDENTITY_FILE, SET_FILE, IdentityRecord, SetRecord, view_file
from recast.recar.vehicle_set import read_identities, read_set_record

_MEND = "name another folder, or repeat the options of the set that lies there"


def begin_set(folder: str | Path, record: SetRecord, identities: Collection[str]) -> frozenset[str]:
    """Start a set, or go on with the one that lies there, which may have fewer identities.

    It is marked as in the making until `finish_set`.

    Args:
        folder: of the set.
        record: of the set.
        identities: ids of all that will be in it.

    Returns:
        Ids that are finished already.

    Raises:
        InputError: as `check_begin`.
    """
    folder = Path(folder)
    finished = check_begin(folder, record, identities)
    with storage.disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if len(finished) < len(identities):
        _write_record(folder, record.model_copy(update={"complete": False}))
    return finished


def check_begin(folder: Path, record: SetRecord, identities: Collection[str]) -> frozenset[str]:
    """What `begin_set` would return, with nothing written.

    Raises:
        InputError: the folder holds something else, a set of another configuration, a broken
            identity or one that is not among `identities`.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return frozenset()
    if not (folder / SET_FILE).is_file():
        raise InputError(
            folder, "output folder", "exists and is no vehicle set", "name a new or empty folder"
        )
    found = read_set_record(folder)
    if name := _first_difference(found, record):
        raise InputError(
            folder / SET_FILE, name, "differs: a set of another configuration lies there", _MEND
        )
    finished = read_identities(folder, found)
    if unwanted := sorted(finished.keys() - set(identities)):
        raise InputError(
            folder, unwanted[0], f"lies there but is not among the {len(identities)} asked for",
            _MEND,
        )  # fmt: skip
    return frozenset(finished)


def write_identity(
    folder: str | Path, record: SetRecord, identity: IdentityRecord, pictures: Iterable[Image]
) -> None:
    """Add one identity to a set; its folder appears whole or not at all.

    Args:
        folder: of the set.
        record: of the set.
        identity: what is known about the vehicle.
        pictures: one for each azimuth, (height, width, 4) uint8 RGBA with straight alpha; taken
            one by one.

    Raises:
        ValueError: not one picture a view, of another shape, or with alpha zero everywhere.
        InputError: the identity is there already, or the disk is full.
    """
    with storage.atomic_folder(Path(folder) / identity.id) as partial:
        count = 0
        for index, picture in enumerate(pictures):
            if picture.shape != (record.height, record.width, 4) or not picture[..., 3].any():
                raise ValueError(
                    f"{identity.id}: view {index}: shape {picture.shape}, or transparent everywhere"
                )
            (partial / view_file(index)).write_bytes(encode_picture(picture))
            count += 1
        if count != record.views:
            raise ValueError(f"{identity.id}: {count} pictures where the set has {record.views}")
        storage.write_json(partial / IDENTITY_FILE, identity.model_dump(mode="json"))


def finish_set(folder: str | Path, record: SetRecord) -> None:
    """Mark a set as complete."""
    _write_record(Path(folder), record.model_copy(update={"complete": True}))


def _first_difference(found: SetRecord, wanted: SetRecord) -> str | None:
    theirs, ours = ({**r.model_dump(mode="json"), **(r.generator or {})} for r in (found, wanted))
    same_anyway = ("complete", "identities", "generator")
    for name in sorted((theirs.keys() | ours.keys()) - set(same_anyway)):
        if theirs.get(name) != ours.get(name):
            return name
    return None


def _write_record(folder: Path, record: SetRecord) -> None:
    storage.write_json(folder / SET_FILE, record.model_dump(mode="json"))
