"""Photographs to a vehicle set: table, folder, what is refused, and networks that cut out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recast.actors.cutout import GrabCutRemover, GroundedSamRemover, remover_of
from recast.actors.grounded_segmenter import DetectionRule
from recast.core.errors import InputError
from recast.recar import read_set
from recast.recar.ingest import IngestReport, ingest_photographs
from recast.recar.ingest_table import IngestSettings
from support.tiny_networks import write_tiny_networks
from support.vehicle_photographs import (
    HEIGHT,
    SETTINGS,
    VIEWS,
    WIDTH,
    car_before_a_wall,
    photograph,
    write_photos,
    write_rows,
)
from support.vehicle_sets import tree


def ingest(photos: Path, out: Path, **options: object) -> IngestReport:
    settings = options.pop("settings", SETTINGS)
    assert isinstance(settings, IngestSettings)
    return ingest_photographs(photos, out, settings, None, **options)  # type: ignore[arg-type]


def test_photographs_become_a_set(tmp_path: Path) -> None:
    photos = write_photos(
        tmp_path / "photos", length_m=4.2, width_m=1.8, height_m=1.5, licence="CC0-1.0"
    )
    (photos / "car-0" / "notes.txt").write_text("mine")
    (photos / ".hidden").mkdir()
    before = tree(photos)
    steps: list[tuple[int, int]] = []
    settings = replace(SETTINGS, elevation_deg=15.0, fov_deg=40.0)
    report = ingest(
        photos, tmp_path / "set", settings=settings, progress=lambda *s: steps.append(s)
    )
    assert tree(photos) == before
    made = read_set(tmp_path / "set")
    assert list(made.identities) == ["car-0", "car-1", "car-2"]
    assert report.skipped == {} and set(report.doubts.values()) == {()}
    assert made.record.licence == "CC-BY-4.0" and made.record.elevation_deg == 15.0
    assert steps[-1] == (12, 12)
    record = made.identities["car-1"].record
    assert (record.kind, record.colour, record.category) == ("sedan", "red", "car")
    assert record.size == (4.2, 1.8, 1.5) and record.licence == "CC0-1.0"
    for index in range(3):
        for view in range(VIEWS):
            found = made.identities[f"car-{index}"].view(view)
            assert np.array_equal(found, photograph(100 * index + view))
    assert json.loads((tmp_path / "set" / "ingest.json").read_text()) == {
        "skipped": [],
        "doubts": {},
    }


@pytest.mark.parametrize(
    ("columns", "settings", "order"),
    [
        ({"front": 3}, SETTINGS, [2, 3, 0, 1]),
        ({}, replace(SETTINGS, clockwise=True), [0, 3, 2, 1]),
        ({"front": 2}, replace(SETTINGS, clockwise=True), [1, 0, 3, 2]),
        ({"azimuths_deg": "181 271 358 92"}, SETTINGS, [2, 3, 0, 1]),
    ],
)
def test_the_front_comes_first_and_azimuths_rise(
    tmp_path: Path, columns: dict[str, object], settings: IngestSettings, order: list[int]
) -> None:
    photos = write_photos(tmp_path / "photos", 1, **columns)
    made = ingest(photos, tmp_path / "set", settings=settings).vehicle_set
    for view, photo in enumerate(order):
        assert np.array_equal(made.identities["car-0"].view(view), photograph(photo))


def test_a_table_in_json_and_folders_of_other_names(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    (photos / "vehicles.csv").unlink()
    (photos / "car-0").rename(photos / "Golf von Oma")
    row = {"id": "golf-7", "folder": "Golf von Oma", "kind": "hatchback", "split": "held-out"}
    (photos / "vehicles.json").write_text(json.dumps([row]))
    made = ingest(photos, tmp_path / "set").vehicle_set
    assert [one.record.id for one in made.of_split("held-out")] == ["golf-7"]


def test_pictures_are_brought_to_one_size_and_centred(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    for path in (photos / "car-0").iterdir():
        with Image.open(path) as picture:
            picture.resize((240, 240)).save(path)
    made = ingest(photos, tmp_path / "set").vehicle_set
    view = made.identities["car-0"].view(0)
    assert view.shape == (HEIGHT, WIDTH, 4)
    columns = np.flatnonzero((view[..., 3] > 0).any(axis=0))
    assert abs(columns[0] + columns[-1] + 1 - WIDTH) <= 1  # the square stands in the middle
    assert columns[-1] - columns[0] < HEIGHT


def cut_short(photos: Path) -> None:
    path = photos / "car-1" / "9.png"
    path.write_bytes(path.read_bytes()[:-200])


def transparent(photos: Path) -> None:
    Image.fromarray(np.zeros((HEIGHT, WIDTH, 4), np.uint8)).save(photos / "car-1" / "9.png")


def opaque(photos: Path) -> None:
    Image.fromarray(photograph(5)[..., :3]).save(photos / "car-1" / "9.png")


def other_size(photos: Path) -> None:
    Image.fromarray(photograph(5, 72, 48)).save(photos / "car-1" / "9.png")


def one_missing(photos: Path) -> None:
    (photos / "car-1" / "9.png").unlink()


def same_twice(photos: Path) -> None:
    with Image.open(photos / "car-1" / "8.png") as picture:
        brighter = np.array(picture)
    brighter[..., :3] = np.minimum(brighter[..., :3], 250) + 3
    Image.fromarray(brighter).save(photos / "car-1" / "9.png")


def under_two_names(photos: Path) -> None:
    for path in (photos / "car-0").iterdir():
        shutil.copy(path, photos / "car-1" / path.name)


def no_row(photos: Path) -> None:
    write_rows(photos, [{"id": name, "kind": "sedan"} for name in ("car-0", "car-2")])


def no_folder(photos: Path) -> None:
    shutil.rmtree(photos / "car-1")


def floats(photos: Path) -> None:
    (photos / "car-1" / "9.png").unlink()
    Image.fromarray(np.zeros((HEIGHT, WIDTH), np.float32)).save(photos / "car-1" / "9.tif")


def changed_rows(**columns: object) -> Callable[[Path], None]:
    def change(photos: Path) -> None:
        rows = [dict.fromkeys(columns, "") | {"id": f"car-{i}", "kind": "sedan"} for i in range(3)]
        rows[1] |= columns
        write_rows(photos, rows)  # type: ignore[arg-type]

    return change


EARLY = [
    (one_missing, r"car-1: photographs: are 3, but the set has 4 views"),
    (other_size, r"car-1/9\.png: size: is 72x48, but 7\.png has 60x40"),
    (floats, r"car-1/9\.tif: photograph: cannot be decoded \(its pixels are floats"),
    (cut_short, r"car-1/9\.png: photograph: cannot be decoded"),
    (no_row, r"vehicles\.csv: id: has no row for car-1"),
    (no_folder, r"car-1: folder: is missing"),
    (changed_rows(front=9), "car-1: front: is 9, but there are 4 photographs"),
    (changed_rows(front=0), "front: Input should be greater than or equal to 1"),
    (changed_rows(kind=""), "kind: Field required"),
    (changed_rows(length_m=4), "give all of length_m, width_m, height_m or none"),
    (changed_rows(azimuths_deg="0 90 180 200"), r"azimuth: 200 is not regular"),
    (changed_rows(azimuths_deg="0 90 180"), "azimuths_deg: are 3 for 4 photographs"),
    (changed_rows(split="both"), "split: Input should be 'train' or 'held-out'"),
]
LATE = [
    (transparent, r"car-1/9\.png: alpha: is zero everywhere"),
    (opaque, r"car-1/9\.png: alpha: is absent"),
    (same_twice, r"car-1/9\.png: duplicate: is the same image as 8\.png"),
    (under_two_names, "car-1: duplicate: 4 of 4 photographs are the same as those of car-0"),
]


@pytest.mark.parametrize(("damage", "message"), EARLY + LATE)
def test_a_bad_vehicle_is_listed_and_skipped_only_where_allowed(
    tmp_path: Path, damage: Callable[[Path], None], message: str
) -> None:
    photos = write_photos(tmp_path / "photos")
    damage(photos)
    before = tree(photos)
    bad: list[str] = []
    out = tmp_path / "set"
    with pytest.raises(InputError, match="1 of 3 cannot be used, such as car-1") as error:
        ingest(photos, out, on_bad=lambda name, fault: bad.append(f"{name}: {fault}"))
    assert "\n" not in str(error.value)
    assert len(bad) == 1 and bad[0].startswith("car-1: ")
    late = damage in [one for one, _ in LATE]
    assert out.exists() == late
    if late:
        assert sorted(p.name for p in out.iterdir() if p.is_dir()) == [".ingest", "car-0", "car-2"]
        with pytest.raises(InputError, match="is not complete"):
            read_set(out)
    report = ingest(photos, out, skip_bad=True)
    assert list(report.vehicle_set.identities) == ["car-0", "car-2"]
    assert list(report.skipped) == ["car-1"]
    with pytest.raises(InputError, match=message):
        raise report.skipped["car-1"]
    listed = json.loads((out / "ingest.json").read_text())["skipped"]
    assert [one["vehicle"] for one in listed] == ["car-1"]
    assert tree(photos) == before


def test_a_mended_vehicle_is_added(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos")
    good = (photos / "car-1" / "9.png").read_bytes()
    cut_short(photos)
    ingest(photos, tmp_path / "set", skip_bad=True)
    (photos / "car-1" / "9.png").write_bytes(good)
    report = ingest(photos, tmp_path / "set")
    assert len(report.vehicle_set.identities) == 3
    ingest(photos, tmp_path / "whole")
    assert without_name(tmp_path / "set") == without_name(tmp_path / "whole")


def without_name(folder: Path) -> dict[str, bytes]:
    files = tree(folder)
    files["set.json"] = files["set.json"].replace(f'"{folder.name}"'.encode(), b"")
    return files


def test_a_killed_run_goes_on_to_the_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = write_photos(tmp_path / "photos")
    ingest(photos, tmp_path / "whole")

    def kill(done: int, total: int) -> None:
        if done == 2 * VIEWS:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ingest(photos, tmp_path / "set", progress=kill)
    (tmp_path / "set" / ".car-2.partial").mkdir()
    (tmp_path / "set" / ".ingest" / "car-0.json").write_text("{cut")
    shutil.rmtree(photos / "car-1")  # finished already, so no longer needed where it is allowed
    ingest(photos, tmp_path / "set", skip_bad=True)
    made = read_set(tmp_path / "set")
    assert list(made.identities) == ["car-0", "car-1", "car-2"]
    for name in made.identities:
        assert tree(tmp_path / "set" / name) == tree(tmp_path / "whole" / name)


def test_several_processes_write_the_same_files(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 4)
    under_two_names(photos)
    for name, workers in (("one", 1), ("two", 2)):
        report = ingest(photos, tmp_path / name, skip_bad=True, workers=workers)
        assert list(report.skipped) == ["car-1"]
    assert without_name(tmp_path / "one") == without_name(tmp_path / "two")


def test_duplicates_in_both_splits_are_said_to_be(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 2)
    under_two_names(photos)
    splits = ("train", "held-out")
    write_rows(photos, [{"id": f"car-{i}", "kind": "van", "split": splits[i]} for i in range(2)])
    report = ingest(photos, tmp_path / "set", skip_bad=True)
    assert "which is in the other split" in report.skipped["car-1"].problem


def test_one_photograph_in_two_vehicles_is_a_doubt(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 2)
    shutil.copy(photos / "car-0" / "8.png", photos / "car-1" / "10.png")
    report = ingest(photos, tmp_path / "set")
    assert report.doubts["car-1"] == ("1 of 4 photographs look like those of car-0",)
    again = ingest(photos, tmp_path / "set")
    assert again.doubts == report.doubts


def test_a_changed_row_of_a_finished_vehicle_is_refused(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 2)
    ingest(photos, tmp_path / "set")
    write_rows(photos, [{"id": f"car-{i}", "kind": "van"} for i in range(2)])
    with pytest.raises(InputError, match=r"identity\.json: record: differs from its row"):
        ingest(photos, tmp_path / "set")


def test_none_is_good(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    (photos / "car-0" / "7.png").write_bytes(b"")
    with pytest.raises(InputError, match="1 of 1 cannot be used"):
        ingest(photos, tmp_path / "set", skip_bad=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"vehicles\.csv or vehicles\.json: is missing"),
        ("id,kind\n", "vehicles: are missing"),
        ("id,kind,paint\ncar-0,van,red\n", "heading: 'paint' is not a column"),
        ("id\ncar-0\n", "heading: id and kind are needed"),
        ("id,kind\ncar-0,van\ncar-0,van\n", "car-0 .*has 2 rows"),
        ("id,kind\n../car,van\n", "id: Value error, expected at most 100"),
        ("id,kind\ncar-0,van,red\n", "more cells than columns"),
        ("id,kind,kind\ncar-0,van,van\n", "heading: names a column twice"),
        (f"id,kind\ncar-0,{'v' * 140_000}\n", "line 2: field larger than field limit"),
        (f"id,{'k' * 140_000}\n", "line 1: field larger than field limit"),
        ("id,kind,folder\ncar-0,van,../car-0\n", r"folder: names '\.\./car-0'"),
        ("id,kind,folder\ncar-0,van,/etc\n", "folder: names '/etc'"),
        (f"id,kind,folder\ncar-0,van,{'f' * 300}\n", "has too long a name"),
    ],
)
def test_a_bad_table(tmp_path: Path, text: str | None, message: str) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    (photos / "vehicles.csv").unlink()
    if text is not None:
        (photos / "vehicles.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        ingest(photos, tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_a_table_as_office_programs_save_it(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    (photos / "vehicles.csv").write_text("\ufeffid;kind;colour\r\ncar-0; van ;\r\n")
    record = ingest(photos, tmp_path / "set").vehicle_set.identities["car-0"].record
    assert (record.kind, record.colour) == ("van", None)


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="exists and is not a vehicle set"):
        ingest(photos, tmp_path / "notes")
    ingest(photos, tmp_path / "set")
    with pytest.raises(InputError, match="width: differs"):
        ingest(photos, tmp_path / "set", settings=replace(SETTINGS, width=120))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 0}, "`views`: value: is 0"),
        ({"fov_deg": 180.0}, "`fov`: value: is 180"),
        ({"licence": " "}, "`licence`: value: is empty"),
        ({"duplicate_bits": 256}, "`duplicate_bits`: value: is 256"),
    ],
)
def test_impossible_settings(tmp_path: Path, change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ingest(tmp_path, tmp_path / "set", settings=replace(SETTINGS, **change))  # type: ignore[arg-type]


def test_a_fov_needs_the_shape_of_the_set(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "photos", 1)
    settings = replace(SETTINGS, fov_deg=40.0, width=40)
    ingest(photos, tmp_path / "wide", settings=settings)  # as wide as before, with free rows
    with pytest.raises(InputError, match="not of the aspect ratio of 90x40"):
        ingest(photos, tmp_path / "set", settings=replace(settings, width=90))


def test_networks_cut_out_a_photograph(tmp_path: Path) -> None:
    folder = write_tiny_networks(tmp_path)
    image, _ = car_before_a_wall()
    doubtful = GroundedSamRemover(folder, DetectionRule(score=1.0), "cpu").remove(image, "van")
    assert "no van was detected in the middle" in doubtful.doubts[0]
    assert doubtful.alpha.shape == image.shape[:2] and doubtful.alpha.any()
    sure = GroundedSamRemover(folder, DetectionRule(score=0.0), "cpu").remove(image, "car")
    assert sure.alpha.dtype == np.uint8
    assert isinstance(remover_of(str(folder)), GroundedSamRemover)
    assert isinstance(remover_of("grabcut"), GrabCutRemover)
    with pytest.raises(InputError, match="folder: is missing"):
        remover_of(str(tmp_path / "none"))
