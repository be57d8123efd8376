"""Vehicle sets as tar shards: few large files, read in a stream or at any identity.

    SHARDS/index.json
    SHARDS/shard-000000.tar           ID.identity.json, ID.view_00.png, ID.view_01.png, ...
    SHARDS/shard-000000.members.json  where each of them lies, and its hash

The tars are WebDataset shards. See docs/data.md.
"""

from recast.recar.shards.pack import SHARD_BYTES, pack_set, parse_byte_size
from recast.recar.shards.sharded_set import (
    LoadedIdentity,
    ShardedIdentity,
    ShardedSet,
    open_set,
    read_shards,
    stream_identities,
)

__all__ = [
    "SHARD_BYTES",
    "LoadedIdentity",
    "ShardedIdentity",
    "ShardedSet",
    "open_set",
    "pack_set",
    "parse_byte_size",
    "read_shards",
    "stream_identities",
]
