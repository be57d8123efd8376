"""Packing a set into shards and reading it back."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import tarfile
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.recar import VehicleSet, begin_set, finish_set, read_set, set_statistics, write_identity
from recast.recar.figure import representatives, view_sheet
from recast.recar.shards import (
    ShardedSet,
    open_set,
    pack_set,
    parse_byte_size,
    read_shards,
    stream_identities,
)

from .sets import VIEWS, identity_record, pictures, set_record, tree, write_set

IDENTITIES = 7
SMALL = 6_000  # some two identities of the tests a shard


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> VehicleSet:
    return write_set(tmp_path_factory.mktemp("set") / "cars", IDENTITIES)


@pytest.fixture(scope="module")
def packed(folders: VehicleSet, tmp_path_factory: pytest.TempPathFactory) -> ShardedSet:
    out = tmp_path_factory.mktemp("shards") / "cars"
    pack_set(folders, out, SMALL)
    return read_shards(out)


@pytest.fixture
def shards(packed: ShardedSet, tmp_path: Path) -> Path:
    """A copy to break."""
    shutil.copytree(packed.folder, tmp_path / "shards")
    return tmp_path / "shards"


def unpacked(folder: Path) -> dict[str, bytes]:
    """What a reader that knows nothing but tar finds, by path in the set."""
    found: dict[str, bytes] = {}
    for path in sorted(folder.glob("shard-*.tar")):
        with tarfile.open(path) as tar:
            for member in tar:
                identity, file = member.name.split(".", 1)
                file_object = tar.extractfile(member)
                assert file_object is not None
                found[f"{identity.replace('%2E', '.')}/{file}"] = file_object.read()
    return found


@given(shard_bytes=st.integers(1, 40_000))
@settings(max_examples=25, deadline=None)
def test_any_size_of_shards_gives_the_files_of_the_set(
    folders: VehicleSet, shard_bytes: int
) -> None:
    files = tree(folders.folder)
    del files["set.json"]
    with tempfile.TemporaryDirectory() as out:
        index = pack_set(folders, out, shard_bytes)
        assert unpacked(Path(out)) == files
        for shard in index.shards:
            assert shard.bytes == (Path(out) / shard.file).stat().st_size
            assert shard.bytes <= shard_bytes or len(shard.identities) == 1
        read = read_shards(out)
        assert list(read.identities) == list(folders.identities)
        for name, identity in read.identities.items():
            assert identity.record == folders.identities[name].record
            for view in range(VIEWS):
                assert identity.encoded(view) == files[f"{name}/view_{view:02d}.png"]


def test_it_is_used_as_a_set_in_folders(folders: VehicleSet, packed: ShardedSet) -> None:
    assert packed.record == folders.record
    assert set_statistics(packed) == set_statistics(folders)
    for split in ("train", "held-out"):
        ours = [one.record.id for one in packed.of_split(split)]
        assert ours == [one.record.id for one in folders.of_split(split)] != []
    one, theirs = packed.identities["car-3"], folders.identities["car-3"]
    assert np.array_equal(one.view(2), theirs.view(2))
    assert one.camera(1)[0] == theirs.camera(1)[0]
    assert np.array_equal(one.camera(1)[1], theirs.camera(1)[1])
    assert one.picture_bytes() == theirs.picture_bytes()
    chosen = [[one.record.id for one in representatives(s, 3)] for s in (packed, folders)]
    assert chosen[0] == chosen[1]
    assert view_sheet(representatives(packed, 2), [0, 1]).shape[2] == 3
    with pytest.raises(IndexError, match="view 4: car-3 has views 0 to 3"):
        one.view(4)
    with pytest.raises(IndexError, match="view -1"):
        one.encoded(-1)


def test_open_set_takes_both(folders: VehicleSet, packed: ShardedSet, tmp_path: Path) -> None:
    assert isinstance(open_set(folders.folder), VehicleSet)
    assert isinstance(open_set(packed.folder), ShardedSet)
    with pytest.raises(InputError, match="vehicle set: is missing"):
        open_set(tmp_path / "none")
    with pytest.raises(InputError, match="shards: are missing"):
        read_shards(tmp_path / "none")


def test_no_shard_holds_both_splits_and_the_count_is_right(packed: ShardedSet) -> None:
    index = packed.index
    assert {shard.split for shard in index.shards} == {"train", "held-out"}
    for shard in index.shards:
        for name in shard.identities:
            assert packed.identities[name].record.split == shard.split
    assert index.identities == IDENTITIES
    assert index.pictures == IDENTITIES * VIEWS
    assert index.bytes == sum(p.stat().st_size for p in packed.folder.glob("*.tar"))
    assert len(index.shards) > 2


def test_the_bytes_depend_on_the_set_alone(
    folders: VehicleSet, packed: ShardedSet, tmp_path: Path
) -> None:
    shutil.copytree(folders.folder, tmp_path / "elsewhere" / "copy", copy_function=shutil.copy)
    pack_set(read_set(tmp_path / "elsewhere" / "copy"), tmp_path / "again", SMALL)
    assert tree(tmp_path / "again") == tree(packed.folder)


def test_a_killed_run_goes_on(folders: VehicleSet, packed: ShardedSet, shards: Path) -> None:
    whole = tree(packed.folder)
    index = json.loads((shards / "index.json").read_text())
    index |= {"complete": False, "shards": [], "bytes": 0}
    (shards / "index.json").write_text(json.dumps(index))
    (shards / "shard-000001.tar").unlink()
    (shards / "shard-000002.members.json").unlink()
    (shards / ".shard-000001.tar.partial").write_bytes(b"cut")
    kept = (shards / "shard-000000.tar").stat().st_mtime_ns
    with pytest.raises(InputError, match="are not complete"):
        read_shards(shards)
    steps: list[tuple[int, int]] = []
    pack_set(folders, shards, SMALL, lambda *step: steps.append(step))
    assert tree(shards) == whole
    assert (shards / "shard-000000.tar").stat().st_mtime_ns == kept
    assert steps[-1] == (IDENTITIES * VIEWS, IDENTITIES * VIEWS)


def test_packing_again_mends_a_damaged_shard(
    folders: VehicleSet, packed: ShardedSet, shards: Path
) -> None:
    damage(shards / "shard-000000.tar", 3000)
    (shards / "shard-000001.tar").write_bytes((shards / "shard-000001.tar").read_bytes() + b"x")
    (shards / "shard-000099.tar").write_bytes(b"of an earlier state of the set")
    pack_set(folders, shards, SMALL)
    assert tree(shards) == tree(packed.folder)


def test_other_shards_are_never_written_over(
    folders: VehicleSet, shards: Path, tmp_path: Path
) -> None:
    before = tree(shards)
    with pytest.raises(InputError, match="shard_bytes: is 6000, not 7000"):
        pack_set(folders, shards, 7000)
    with pytest.raises(
        InputError, match=r"set\.identities: differs: the folder holds shards of another"
    ):
        pack_set(write_set(tmp_path / "other", 3), shards, SMALL)
    assert tree(shards) == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists and holds no shards"):
        pack_set(folders, tmp_path / "mine")


def test_a_broken_picture_is_named_and_not_packed(tmp_path: Path) -> None:
    made = write_set(tmp_path / "set")
    (tmp_path / "set" / "car-2" / "view_03.png").write_bytes(b"text")
    with pytest.raises(InputError, match=r"car-2/view_03\.png: view: is not a PNG file"):
        pack_set(made, tmp_path / "out")
    assert not list((tmp_path / "out").glob("*.tar"))


def test_names_with_dots_and_of_any_length(tmp_path: Path) -> None:
    name = "a.b" + 97 * "x"
    record = set_record(1)
    begin_set(tmp_path / "set", record, [name])
    write_identity(
        tmp_path / "set", record, identity_record(0).model_copy(update={"id": name}), pictures(0)
    )
    finish_set(tmp_path / "set", record)
    pack_set(read_set(tmp_path / "set"), tmp_path / "out", 1)
    files = tree(tmp_path / "set")
    del files["set.json"]
    assert unpacked(tmp_path / "out") == files
    assert read_shards(tmp_path / "out").identities[name].encoded(3) == files[f"{name}/view_03.png"]


def damage(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


def first_member(shards: Path, view: int) -> tuple[Path, str, int]:
    """Shard, name and place of a view of the first identity of the first shard."""
    record = json.loads((shards / "shard-000000.members.json").read_text())
    member = next(iter(record["members"].values()))[1 + view]
    return shards / "shard-000000.tar", member["name"], member["offset"]


def test_a_shard_cut_short_names_shard_and_member(shards: Path) -> None:
    path, name, offset = first_member(shards, 2)
    path.write_bytes(path.read_bytes()[: offset + 10])
    with pytest.raises(InputError) as error:
        read_shards(shards)
    assert str(error.value).startswith(f"{path}: {name}: is cut off")
    assert "\n" not in str(error.value)
    bad: list[InputError] = []
    left = read_shards(shards, bad.append)
    assert [one.field for one in bad] == [name]
    assert len(left.identities) < IDENTITIES
    assert len(list(stream_identities(left))) == len(left.identities)


def test_a_shard_cut_while_in_use_is_named(shards: Path) -> None:
    opened = read_shards(shards)
    path, name, offset = first_member(shards, 2)
    path.write_bytes(path.read_bytes()[: offset + 10])
    identity = opened.identities[name.split(".")[0]]
    identity.view(1)
    with pytest.raises(InputError, match=f"{name}: is cut off"):
        identity.view(2)


def test_only_the_end_of_the_archive_is_gone(shards: Path) -> None:
    path = shards / "shard-000000.tar"
    path.write_bytes(path.read_bytes()[:-600])
    with pytest.raises(InputError, match=r"shard-000000\.tar: shard: ends after"):
        read_shards(shards)
    assert len(read_shards(shards, lambda _: None).identities) == IDENTITIES


def test_a_missing_shard_names_what_it_held(shards: Path) -> None:
    (shards / "shard-000001.tar").unlink()
    with pytest.raises(InputError, match=r"shard-000001\.tar: shard: is missing: it holds car-"):
        read_shards(shards)
    bad: list[InputError] = []
    assert 0 < len(read_shards(shards, bad.append).identities) < IDENTITIES
    assert len(bad) == 1


def test_a_shard_that_is_too_long(shards: Path) -> None:
    path = shards / "shard-000001.tar"
    path.write_bytes(path.read_bytes() + b"more")
    with pytest.raises(InputError, match="bytes, not"):
        read_shards(shards)


def test_a_damaged_member_is_named_and_the_others_are_read(shards: Path) -> None:
    path, name, offset = first_member(shards, 1)
    damage(path, offset + 20)
    opened = read_shards(shards)
    identity = opened.identities[name.split(".")[0]]
    identity.view(0)
    with pytest.raises(InputError) as error:
        identity.view(1)
    assert str(error.value).startswith(f"{path}: {name}: is damaged: its sha256 differs")
    with pytest.raises(InputError, match="is damaged"):
        opened.check_pictures()
    with pytest.raises(InputError, match="is damaged"):
        list(stream_identities(opened))
    bad: list[InputError] = []
    left = list(stream_identities(opened, on_bad=bad.append))
    assert len(left) == IDENTITIES - 1
    assert [one.field for one in bad] == [name]


def test_a_list_of_members_missing_or_changed(shards: Path) -> None:
    path = shards / "shard-000000.members.json"
    text = path.read_text()
    path.write_text(text.replace("car", "bus"))
    name = json.loads((shards / "index.json").read_text())["shards"][0]["identities"][0]
    with pytest.raises(InputError, match="sha256: differs from the one"):
        read_shards(shards).identities[name].view(0)
    path.unlink()
    with pytest.raises(InputError, match=r"members\.json: file: is missing"):
        read_shards(shards).identities[name].view(0)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("offset", -512, "offset: Input should be greater than or equal to 0"),
        ("offset", 512, "begins at 512, not"),
        ("offset", 10**18, "begins at 1000000000000000000, not"),
        ("offset", 10**400, "offset: "),
        ("size", 10**12, "has 1000000000000 bytes"),
        ("size", 7, "is damaged"),
        ("name", "../../etc/passwd", "does not have a record and"),
    ],
)
def test_places_of_members_that_the_layout_does_not_give(
    shards: Path, field: str, value: object, message: str
) -> None:
    """Whoever writes the list writes its hash into the index, too."""
    index = json.loads((shards / "index.json").read_text())
    first = index["shards"][0]
    path, name = shards / "shard-000000.members.json", first["identities"][0]
    members = json.loads(path.read_text())
    members["members"][name][1][field] = value
    path.write_text(json.dumps(members))
    first["members_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    (shards / "index.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match=message):
        read_shards(shards).identities[name].view(0)


def edit_index(shards: Path, change: str) -> None:
    index = json.loads((shards / "index.json").read_text())
    first, last = index["shards"][0], index["shards"][-1]
    if change == "both splits":
        last["identities"].append(first["identities"][0])
    elif change == "twice":
        index["shards"][1]["identities"].append(first["identities"][0])
    elif change == "count":
        index["identities"] = 99
    elif change == "no format":
        del index["format"]
    elif change == "outside":
        first["file"] = "../shard-000000.tar"
    (shards / "index.json").write_text(json.dumps(index))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("both splits", r"car-\d: is in both splits: in shard-000000\.tar \(train\) and shard-0"),
        ("twice", r"car-\d: is packed twice: in shard-000000\.tar"),
        ("count", "identities: 7 in the shards, 99 in index.json"),
        ("no format", "format: is None"),
        ("outside", r"shards\.0\.file"),
    ],
)
def test_an_index_that_contradicts_itself(shards: Path, change: str, message: str) -> None:
    edit_index(shards, change)
    with pytest.raises(InputError, match=message):
        read_shards(shards)


def test_an_identity_of_the_other_split_is_never_given_out(shards: Path) -> None:
    index = json.loads((shards / "index.json").read_text())
    index["shards"][0]["split"] = "held-out"
    (shards / "index.json").write_text(json.dumps(index))
    opened = read_shards(shards)
    with pytest.raises(InputError, match=r"identity\.json: split: is 'train' in a shard of 'held"):
        list(stream_identities(opened, "held-out"))


def test_check_pictures_looks_at_all(packed: ShardedSet) -> None:
    steps: list[tuple[int, int]] = []
    packed.check_pictures(True, lambda *step: steps.append(step))
    total = IDENTITIES * VIEWS
    assert steps == [(i + 1, total) for i in range(total)]


@pytest.mark.parametrize(
    ("text", "size"),
    [("256MB", 256_000_000), ("1GiB", 2**30), ("1.5 kb", 1500), ("77", 77), ("3TB", 3 * 10**12)],
)
def test_sizes_as_people_write_them(text: str, size: int) -> None:
    assert parse_byte_size(text, "`shard_bytes`") == size


@pytest.mark.parametrize("text", ["", "MB", "0", "-1MB", "12XB", "0.1", "1e9", "9" * 400])
def test_no_size(text: str) -> None:
    with pytest.raises(InputError, match="`shard_bytes`: value: is"):
        parse_byte_size(text, "`shard_bytes`")


def test_the_tar_is_what_tarfile_writes(folders: VehicleSet, packed: ShardedSet) -> None:
    path = packed.folder / "shard-000000.tar"
    buffer = io.BytesIO()
    with tarfile.open(path) as ours, tarfile.open(fileobj=buffer, mode="w") as theirs:
        for member in ours:
            theirs.addfile(member, ours.extractfile(member))
    assert buffer.getvalue().rstrip(b"\0") == path.read_bytes().rstrip(b"\0")


def test_webdataset_reads_them(folders: VehicleSet, packed: ShardedSet) -> None:
    webdataset = pytest.importorskip("webdataset")
    urls = [str(packed.folder / shard.file) for shard in packed.index.shards]
    samples = list(webdataset.WebDataset(urls, shardshuffle=False, empty_check=False))
    assert sorted(sample["__key__"] for sample in samples) == sorted(folders.identities)
    for sample in samples:
        identity = folders.identities[sample["__key__"]]
        assert json.loads(sample["identity.json"])["id"] == identity.record.id
        assert all(sample[f"view_{i:02d}.png"] == identity.encoded(i) for i in range(VIEWS))
