"""Which identities are held out of training."""

from __future__ import annotations

import hashlib

from recast.recar.record import Split

HELD_OUT_SHARE = 0.05
"""648 of 12,896 identities in the paper (section 2)."""


def split_of(
    identity: str, seed: int, share: float = HELD_OUT_SHARE, index: int | None = None
) -> Split:
    """The split of an identity: a hash of its name and the seed, never of its neighbours.

    So a set that grows keeps the split of every identity it had, and two sets that share a vehicle
    under the same name and seed agree about it.

    Args:
        identity: its name.
        seed: of the split.
        share: of identities that are held out, in [0, 1].
        index: its place in a sequence that only ever grows at its end. The first two are set by
            hand, one for training and one held out, so that neither part of a small set is empty.
    """
    if share > 0 and index == 0:
        return "train"
    if share > 0 and index == 1:
        return "held-out"
    digest = hashlib.sha256(f"{seed}/{identity}".encode()).digest()
    return "held-out" if int.from_bytes(digest[:8], "big") < share * 2.0**64 else "train"
