"""Rows of `recast doctor`, `recast store list` and `recast weights list`."""

from __future__ import annotations

from collections.abc import Sequence

from recast.cli.output import Rows
from recast.core import Store
from recast.pipeline.doctor import Finding
from recast.weights import PUBLISHED, weights_folder
from recast.weights.place import is_fetched
from recast.weights.record import read_weights_record


def finding_rows(findings: Sequence[Finding]) -> Rows:
    """One row for each part of the machine; `present` is null for plain information."""
    return {"parts": [vars(finding) for finding in findings]}


def store_rows(store: Store) -> Rows:
    """One row for each artefact of a local store."""
    users = store.users().values()
    return {
        "artefacts": [
            {
                "kind": one.record.kind,
                "key": one.record.key,
                "name": one.record.name,
                "size_bytes": one.size,
                "making_s": one.record.seconds,
                "runs": sum(one.reference in names for names in users),
            }
            for one in store.artefacts()
        ]
    }


def weights_rows() -> Rows:
    """One row for each entry of the table of published weights."""
    rows = []
    for name, weights in PUBLISHED.items():
        here = is_fetched(name)
        commits = read_weights_record(weights_folder(name)).revisions if here else {}
        rows.append(
            {
                "name": name,
                "use": weights.use,
                "options": weights.options,
                "licences": [licence.name for licence in weights.licences],
                "restricted": weights.restricted,
                "pinned": weights.pinned,
                "download_gb": weights.gigabytes,
                "fetched": here,
                "commits": [f"{where} {commit}" for where, commit in commits.items()],
            }
        )
    return {"weights": rows}
