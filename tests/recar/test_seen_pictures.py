"""The search for pictures that are there already, next to comparing all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.recar.ingest import duplicates
from recast.recar.ingest.duplicates import BITS, Hashes, Pieces, SeenPictures


def spoilt(hashes: Hashes, bits: int, rng: np.random.Generator) -> Hashes:
    """Hashes (N, 4) that differ in exactly so many bits."""
    flips = np.zeros((len(hashes), BITS + 1), np.uint8)
    for row in flips:
        row[rng.choice(BITS, bits, replace=False)] = 1
    return hashes ^ np.packbits(flips, axis=1).view(np.uint64)


def random_hashes(count: int, rng: np.random.Generator) -> Hashes:
    flat = rng.integers(0, 2, (count, BITS + 1)).astype(np.uint8)
    flat[:, BITS] = 0
    return np.packbits(flat, axis=1).view(np.uint64)


@given(st.integers(0, 27), st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_alike_hashes_share_a_piece_but_for_one_bit(bits: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    hashes = random_hashes(8, rng)
    pieces = Pieces.of(bits)
    assert pieces is not None and pieces.columns.max() < BITS
    near, keys = pieces.near(hashes), pieces.keys(spoilt(hashes, bits, rng))
    assert all(np.intersect1d(a, b).size for a, b in zip(near, keys, strict=True))


def test_narrow_pieces_are_not_used() -> None:
    assert Pieces.of(28) is None
    assert Pieces.of(BITS) is None


@pytest.mark.parametrize("bits", [0, 20, 27, 40])
def test_the_index_finds_what_the_scan_finds(bits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many small runs; pictures that differ in numbers of bits about the bound."""
    monkeypatch.setattr(duplicates, "_NEW", 16)
    rng = np.random.default_rng(bits)
    base = random_hashes(5, rng)
    seen = SeenPictures(bits)
    found = 0
    for index in range(60):
        near = max(bits + index % 5 - 2, 0)
        hashes = spoilt(base, near, rng)[rng.integers(0, 5, 5)]
        hashes[1:3] = random_hashes(2, rng)
        asked = np.concatenate([base, hashes])
        matches = seen.matches(asked)
        assert matches == seen.matches_by_scan(asked)
        found += sum(matches.values())
        seen.add(str(index), hashes)
    assert found > 100


def test_a_thousand_equal_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(duplicates, "_NEW", 16)
    seen = SeenPictures()
    one = random_hashes(1, np.random.default_rng(0))
    for index in range(1000):
        seen.add(str(index), one)
    assert seen.matches(np.repeat(one, 3, axis=0)) == {str(index): 3 for index in range(1000)}
