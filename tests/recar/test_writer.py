from __future__ import annotations

from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.recar import begin_set, finish_set, read_set, split_of, write_identity
from support.vehicle_sets import identity_record, pictures, set_record, tree, write_set

IDS = ["car-0", "car-1", "car-2"]


def test_a_set_in_the_making_is_marked_and_goes_on(tmp_path: Path) -> None:
    record = set_record()
    assert begin_set(tmp_path / "set", record, IDS) == frozenset()
    write_identity(tmp_path / "set", record, identity_record(0), pictures(0))
    (tmp_path / "set" / ".car-1.partial").mkdir()
    (tmp_path / "set" / ".car-1.partial" / "view_00.png").write_bytes(b"cut")
    with pytest.raises(InputError, match="is not complete"):
        read_set(tmp_path / "set")
    assert begin_set(tmp_path / "set", record, IDS) == {"car-0"}
    for index in (1, 2):
        write_identity(tmp_path / "set", record, identity_record(index), pictures(index))
    finish_set(tmp_path / "set", record)
    assert tree(tmp_path / "set") == tree(write_set(tmp_path / "whole").folder)


def test_a_finished_set_stays_finished(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    assert begin_set(tmp_path, made.record, IDS) == set(IDS)
    assert read_set(tmp_path).record.complete


def test_a_set_grows_and_keeps_its_split(tmp_path: Path) -> None:
    small = write_set(tmp_path, 2)
    record = set_record(3)
    assert begin_set(tmp_path, record, IDS) == {"car-0", "car-1"}
    write_identity(tmp_path, record, identity_record(2), pictures(2))
    finish_set(tmp_path, record)
    grown = read_set(tmp_path)
    for name, identity in small.identities.items():
        assert grown.identities[name].record == identity.record


@pytest.mark.parametrize(
    ("changes", "field"), [({"width": 64}, "width"), ({"split_seed": 1}, "split_seed")]
)
def test_another_configuration_is_refused(
    tmp_path: Path, changes: dict[str, int], field: str
) -> None:
    before = tree(write_set(tmp_path).folder)
    with pytest.raises(InputError, match=f"{field}: differs"):
        begin_set(tmp_path, set_record(**changes), IDS)
    assert tree(tmp_path) == before


def test_settings_of_the_generator_are_named(tmp_path: Path) -> None:
    begin_set(tmp_path, set_record(1, generator={"kinds": ["van"]}), ["car-0"])
    with pytest.raises(InputError, match="kinds: differs"):
        begin_set(tmp_path, set_record(1, generator={"kinds": []}), ["car-0"])


def test_fewer_identities_are_refused(tmp_path: Path) -> None:
    write_set(tmp_path)
    with pytest.raises(InputError, match="car-2: is in the folder but not among the 2 requested"):
        begin_set(tmp_path, set_record(2), IDS[:2])


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists and is not a vehicle set"):
        begin_set(tmp_path, set_record(), IDS)
    with pytest.raises(InputError, match="exists and is not a vehicle set"):
        begin_set(tmp_path / "notes.txt", set_record(), IDS)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_finished_identity_that_lost_a_view_is_found(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    (tmp_path / "car-1" / "view_03.png").unlink()
    with pytest.raises(InputError, match=r"view_03\.png: view: is missing"):
        begin_set(tmp_path, made.record, IDS)


def test_an_identity_is_never_written_over(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    with pytest.raises(InputError, match="exists already"):
        write_identity(tmp_path, made.record, identity_record(0), pictures(1))


def test_the_split_in_the_tests_is_the_one_of_the_library() -> None:
    assert identity_record(1).split == split_of("car-1", 0, index=1) == "held-out"
