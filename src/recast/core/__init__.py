"""What every room may use: errors, files, records, parts; content hashes and the artefact store."""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast.core.artefact import Artefact, file_hash, files_hash, folder_hash, value_hash
    from recast.core.store import Store, open_store

__all__ = [
    "Artefact",
    "Store",
    "file_hash",
    "files_hash",
    "folder_hash",
    "open_store",
    "value_hash",
]


def __getattr__(name: str) -> object:
    """A name of `__all__`, imported when it is first used: `recast --help` needs only errors."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from recast.core import artefact, store

    found: object = getattr(store if name in ("Store", "open_store") else artefact, name)
    globals()[name] = found
    return found
