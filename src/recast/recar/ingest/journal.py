"""What is kept beside a set about how it was made: hashes of its pictures, doubts, bad items."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from recast import storage
from recast.errors import InputError
from recast.recar.ingest.perceptual_hash import WORDS, Hashes, perceptual_hash
from recast.recar.vehicle_set import Identity
from recast.records import Record

REPORT_FILE = "ingest.json"
_FOLDER = ".ingest"  # a reader of the set takes no folder whose name begins with a dot


class _Entry(Record):
    hashes: tuple[str, ...]
    doubts: tuple[str, ...]


def write_entry(out: Path, identity: str, hashes: Hashes, doubts: tuple[str, ...]) -> None:
    """Remember hashes (V, 4) and doubts of an identity."""
    value = {"hashes": [one.tobytes().hex() for one in hashes], "doubts": list(doubts)}
    storage.write_json(out / _FOLDER / f"{identity}.json", value)


def read_entry(out: Path, identity: Identity) -> tuple[Hashes, tuple[str, ...]]:
    """Hashes (V, 4) and doubts of a finished identity, the hashes anew where they are lost."""
    path, views = out / _FOLDER / f"{identity.record.id}.json", identity.set_record.views
    try:
        entry = _Entry.model_validate(storage.read_json(path))
        data = bytes.fromhex("".join(entry.hashes))
        return np.frombuffer(data, np.uint64).reshape(views, WORDS), entry.doubts
    except ValueError:  # as are those of pydantic, and an InputError
        return np.stack([perceptual_hash(identity.view(index)) for index in range(views)]), ()


def write_report(
    out: Path, skipped: Mapping[str, InputError], doubts: Mapping[str, tuple[str, ...]]
) -> None:
    """Write ingest.json: every vehicle that is not in the set and why, and every doubt."""
    value = {
        "skipped": [
            {
                "vehicle": name,
                "where": error.where,
                "field": error.field,
                "problem": error.problem,
                "mend": error.mend,
            }
            for name, error in sorted(skipped.items())
        ],
        "doubts": {name: list(lines) for name, lines in sorted(doubts.items()) if lines},
    }
    storage.write_json(out / REPORT_FILE, value)
