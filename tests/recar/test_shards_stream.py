"""Reading shards in one pass."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from recast.recar.shards import ShardedSet, pack_set, read_shards, stream_identities

from .sets import write_set

IDENTITIES = 12


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> ShardedSet:
    folder = tmp_path_factory.mktemp("stream")
    pack_set(write_set(folder / "set", IDENTITIES), folder / "shards", 6_000)
    return read_shards(folder / "shards")


def names(packed: ShardedSet, *args: object, **options: object) -> list[str]:
    return [one.record.id for one in stream_identities(packed, *args, **options)]  # type: ignore[arg-type]


def test_without_a_generator_the_order_is_that_of_the_shards(packed: ShardedSet) -> None:
    order = [name for shard in packed.index.shards for name in shard.identities]
    assert names(packed) == order
    assert order != sorted(order)


@pytest.mark.parametrize("buffer", [1, 3, 100])
def test_a_shuffle_gives_all_once_and_the_same_for_the_same_seed(
    packed: ShardedSet, buffer: int
) -> None:
    runs = [names(packed, rng=np.random.default_rng(seed), buffer=buffer) for seed in (5, 5, 6)]
    assert sorted(runs[0]) == sorted(packed.identities)
    assert runs[0] == runs[1] != runs[2]
    assert runs[0] != names(packed)


def test_two_passes_of_one_generator_differ(packed: ShardedSet) -> None:
    rng = np.random.default_rng(0)
    assert names(packed, rng=rng) != names(packed, rng=rng)


def test_only_the_split_that_was_asked_for(packed: ShardedSet) -> None:
    for split in ("train", "held-out"):
        found = names(packed, split, rng=np.random.default_rng(0))
        assert sorted(found) == [one.id for one in packed.of_split(split)]


@pytest.mark.parametrize("ranks", [1, 2, 5, 20])
def test_readers_share_the_identities(packed: ShardedSet, ranks: int) -> None:
    parts = [
        names(packed, rng=np.random.default_rng(3), part=(rank, ranks)) for rank in range(ranks)
    ]
    assert sorted(name for part in parts for name in part) == sorted(packed.identities)
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_what_is_streamed_is_what_is_read_at_random(packed: ShardedSet) -> None:
    for one in stream_identities(packed, rng=np.random.default_rng(1)):
        other = packed.identities[one.record.id]
        assert one.record == other.record
        assert one.picture_bytes() == other.picture_bytes()
        assert np.array_equal(one.view(3), other.view(3))
        assert np.array_equal(one.camera(2)[1], other.camera(2)[1])
    with pytest.raises(IndexError):
        one.view(-1)


def test_opening_and_one_pass_read_little(
    packed: ShardedSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    original = Path.open

    def counted(self: Path, *args: object, **options: object) -> object:
        opened.append(self.name)
        return original(self, *args, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", counted)
    fresh = read_shards(packed.folder)
    assert [name for name in opened if name.endswith(".tar")] == []
    fresh.identities["car-4"].view(1)
    assert len([name for name in opened if name.endswith(".tar")]) == 1
    opened.clear()
    for _ in stream_identities(fresh, part=(0, 3)):
        pass
    assert len([name for name in opened if name.endswith(".tar")]) == IDENTITIES // 3


def test_a_set_goes_to_other_processes(packed: ShardedSet) -> None:
    again = pickle.loads(pickle.dumps(packed))
    assert np.array_equal(again.identities["car-1"].view(0), packed.identities["car-1"].view(0))


@pytest.mark.parametrize(("buffer", "part"), [(0, (0, 1)), (1, (1, 1)), (1, (-1, 2)), (1, (0, 0))])
def test_no_such_part(packed: ShardedSet, buffer: int, part: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="stream_identities"):
        stream_identities(packed, buffer=buffer, part=part)
