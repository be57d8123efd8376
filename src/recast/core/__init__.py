"""What every room may use: content hashes and the store of artefacts."""

from recast.core.artefact import file_hash, files_hash, folder_hash, value_hash
from recast.core.store import Artefact, Store, open_store

__all__ = [
    "Artefact",
    "Store",
    "file_hash",
    "files_hash",
    "folder_hash",
    "open_store",
    "value_hash",
]
