"""What every room may use: errors, files, records, parts; content hashes and the artefact store."""

from __future__ import annotations

from recast.lazy import getattr_of, names_of

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast.core.artefact import Artefact as Artefact
    from recast.core.artefact import file_hash as file_hash
    from recast.core.artefact import files_hash as files_hash
    from recast.core.artefact import folder_hash as folder_hash
    from recast.core.artefact import value_hash as value_hash
    from recast.core.store import Store as Store
    from recast.core.store import open_store as open_store

_PLACES = {
    ".artefact": ("Artefact", "file_hash", "files_hash", "folder_hash", "value_hash"),
    ".store": ("Store", "open_store"),
}
__all__ = names_of(_PLACES)
__getattr__ = getattr_of(__name__, _PLACES)  # `recast --help` needs only errors
