"""Faulty Waymo segments: one line that names file, record and field, and nothing written."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs.importers.waymo_proto import decode
from support import tiny_waymo as tiny
from support.importing import import_drive
from support.proto_writer import (
    blob,
    double,
    doubles,
    integer,
    single,
    write_records,
)

Parts = tiny.Parts
CONTEXT = "record 0, context.camera_calibrations"


def _frame(k: int, change: Callable[[bytes], bytes]) -> Parts:
    return Parts(frame=lambda number, data: change(data) if number == k else data)


def _camera(change: Callable[[bytes], bytes]) -> Parts:
    return Parts(calibration=lambda name, data: change(data) if name == "FRONT" else data)


def _pose(values: Iterable[float]) -> Parts:
    pose = tiny.global_from_vehicle(tiny.image_seconds("FRONT", 1))
    stored = blob(3, tiny.transform(pose))
    return _frame(1, lambda data: data.replace(stored, blob(3, doubles(1, values)), 1))


def _top(k: int, change: Callable[[bytes], bytes]) -> Parts:
    return Parts(
        range_image=lambda number, name, data: (
            change(data) if (number, name) == (k, "TOP") else data
        )
    )


def _box(**changes: object) -> Parts:
    return Parts(label=lambda k, name: tiny.label(k, name, **(changes if k == 1 else {})))  # type: ignore[arg-type]


def _jpeg(change: Callable[[bytes], bytes]) -> Parts:
    return Parts(jpeg=lambda k, name, data: change(data) if (k, name) == (1, "FRONT") else data)


def _matrix(values: np.ndarray) -> Callable[[bytes], bytes]:
    return lambda data: tiny.matrix(values)


def _without_rear(number: int, data: bytes) -> bytes:
    if number != 1:
        return data
    rear = tiny.laser_bytes(1, "REAR", Parts())
    return data.replace(blob(5, rear), b"")


def _lanes(*features: bytes) -> Parts:
    return Parts(features=list(features))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (_frame(1, lambda d: d[:-3]), "record 1, Frame: is not a protocol buffer, or is cut off"),
        (_frame(1, lambda d: integer(2, 5) + blob(3, b"")), "record 1, context: is missing"),
        (
            _frame(2, lambda d: d + integer(2, 1 << 62)),
            "record 2, timestamp_micros: 4611686018427387904 is not a time in microseconds",
        ),
        (
            _camera(lambda d: d + blob(3, tiny.transform(np.diag([1.0, 1.0, -1.0, 1.0])))),
            f"{CONTEXT}[4].extrinsic.transform: has 32 numbers, not 16",  # parts are joined
        ),
        (_top(1, _matrix(np.full((6, 40, 4), 1e9))), "holds a range of 1e+09 m"),
        (
            _frame(2, lambda d: tiny.frame_bytes(1, Parts())),
            "record 2, timestamp_micros: is not later than",
        ),
        (_frame(1, lambda d: d + blob(1, blob(1, "other"))), "record 1, context.name: is 'other'"),
        (
            _pose(range(16)),
            "record 1, pose.transform: is not a rotation and translation",
        ),
        (
            _pose([1.0, 2.0]),
            "record 1, pose.transform: has 2 numbers, not 16",
        ),
        (
            _frame(1, lambda d: d + blob(4, integer(1, 9))),
            "record 1, images[5].name: is 9, not a CameraName (1 FRONT, 2 FRONT_LEFT,",
        ),
        (
            _frame(1, lambda d: d + blob(4, tiny.image_bytes(1, "FRONT", Parts()))),
            "record 1, images[5].name: FRONT appears twice",
        ),
        (
            Parts(missing={"FRONT"}),
            "record 0, images[0].image: there is no calibration of camera FRONT",
        ),
        (
            Parts(missing={"TOP"}),
            "record 0, lasers[0].return1.range_image_compressed: there is no calibration of LiDAR",
        ),
        (_camera(lambda d: d + double(2, 1.0)), f"{CONTEXT}[4].intrinsic: has 10 numbers, not 9"),
        (_camera(lambda d: d + integer(4, 0)), f"{CONTEXT}[4]: PinholeCamera.width, height: 0 x"),
        (
            _camera(lambda d: d + integer(6, 8)),
            f"{CONTEXT}[4].rolling_shutter_direction: is 8, not a RollingShutter",
        ),
        (_jpeg(lambda d: b""), "record 1, images[0].image: cannot be decoded"),
        (_jpeg(lambda d: b"no picture"), "record 1, images[0].image: cannot be decoded"),
        (
            _camera(lambda d: d + integer(5, 33)),
            "record 0, images[0].image: is 48x32, but the camera's calibration says 48x33",
        ),
        (
            _frame(1, lambda d: d + integer(2, tiny.START_US + 400_000)),
            "record 1, images[0].pose_timestamp: is -0.248 s after the time of the frame",
        ),
        (_box(kind=9), "record 1, laser_labels[0].type: is 9, not a Label.Type (0 unknown, 1"),
        (_box(width=0.0), "record 1, laser_labels[0].box.width: is 0"),
        (_box(heading=float("nan")), "record 1, laser_labels[0].box.heading: is nan"),
        (
            Parts(label=lambda k, name: tiny.label(k, "car")),
            "record 0, laser_labels[1].id: car appears twice",
        ),
        (_top(1, lambda d: b""), "record 1, lasers[0].return1.range_image_compressed: is empty"),
        (
            _top(1, lambda d: d[: len(d) // 2]),
            "record 1, lasers[0].return1.range_image_compressed: is cut off",
        ),
        (_top(1, lambda d: b"raw"), "range_image_compressed: is not a zlib stream"),
        (
            _top(1, lambda d: zlib.compress(b"")),
            "range_image_compressed: does not contain a matrix: shape: is missing",
        ),
        (
            _top(1, _matrix(np.zeros((0, 40, 4)))),
            "range_image_compressed: has dimensions [0, 40, 4] for 0 values",
        ),
        (
            _top(1, _matrix(np.zeros((6, 40, 3)))),
            "range_image_compressed: has dimensions [6, 40, 3] for 720 values",
        ),
        (_top(1, _matrix(np.full((6, 40, 4), np.inf))), "holds values that are not finite"),
        (_top(1, _matrix(np.ones((5, 40, 4)))), "lasers[0].return1.pose_compressed: is (6, 40)"),
        (
            Parts(frame=_without_rear),
            "record 1, LiDAR REAR: its range image is missing",
        ),
        (_lanes(blob(99, "")), "record 0, map_features: contain no lane for cars"),
        (
            _lanes(tiny.lane(1, tiny.line((0, 0), (9, 0)), kind=3)),
            "record 0, map_features: contain no lane for cars",
        ),
        (
            _lanes(tiny.lane(1, tiny.line((0, 0), (9, 0)), kind=7)),
            "record 0, map_features[0].lane.type: is 7, not a LaneType",
        ),
        (
            _lanes(tiny.lane(1, tiny.line((5000, 0), (5009, 0)))),
            "record 0, map_features: the ego drives 4998 m away from all lanes",
        ),
        (
            _lanes(
                *tiny.map_features()[5:],
                tiny.lane(1, tiny.line((0, 0), (9, 0)), tiny.boundary(13, 11, 0, 40)),
            ),
            "map_features[5].lane.left_boundaries[0]: runs from point 0 to 40, but the lane has 11",
        ),
    ],
)
def test_a_faulty_segment_is_one_clear_line(tmp_path: Path, parts: Parts, message: str) -> None:
    path = tiny.write_segment(tmp_path / "root", parts)
    _refused(tmp_path, tiny.NAME, f"{path}: {message}" if message.startswith("record") else message)


def _refused(tmp_path: Path, drive: str, message: str) -> None:
    with pytest.raises(InputError) as raised:
        import_drive("waymo", tmp_path / "root", drive, tmp_path / "out" / "log")
    error = raised.value
    assert message in f"{error.where}: {error.field}: {error.problem}; {error.mend}"
    assert "\n" not in str(error)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def test_a_range_image_that_grows_is_refused(tmp_path: Path) -> None:
    # Numbers one by one, four times as large as any of the dataset: 100 kB, and gigabytes if each
    # becomes an object of its own.
    grown = zlib.compress(single(1, 1.0) * (1 << 22))
    assert len(grown) < 200_000
    tiny.write_segment(tmp_path / "root", _top(1, lambda d: grown))
    _refused(tmp_path, tiny.NAME, "range_image_compressed: is cut off or too large")


def test_repeated_numbers_are_the_same_packed_and_one_by_one() -> None:
    values = np.linspace(0.0, 1.0, 5, dtype=np.float32)
    packed = blob(1, values[:3].tobytes()) + b"".join(single(1, float(v)) for v in values[3:])
    for data in (packed, b"".join(single(1, float(v)) for v in values)):
        np.testing.assert_array_equal(decode("MatrixFloat", data)["data"], values)


def test_a_damaged_file_names_its_record(tmp_path: Path) -> None:
    path = tiny.write_segment(tmp_path / "root")
    whole = path.read_bytes()
    path.write_bytes(whole[:-100] + bytes([whole[-100] ^ 1]) + whole[-99:])
    _refused(tmp_path, tiny.NAME, f"{path}: record 2, data: do not match their checksum")
    path.write_bytes(whole[:-20])
    _refused(tmp_path, tiny.NAME, f"{path}: record 2, data: are cut off, 20 bytes are missing")
    path.write_bytes(b"\x1f\x8b" + whole)
    _refused(
        tmp_path, tiny.NAME, f"{path}: record 0, length: the file is not an uncompressed TFRecord"
    )


def test_a_gap_in_the_drive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "root" / tiny.FILE
    write_records(path, [tiny.frame_bytes(k, Parts()) for k in (0, 1, 13)])
    _refused(tmp_path, tiny.NAME, f"{path}: record 2, pose: comes 1.1 s after the pose before")


def test_what_is_not_there_is_answered_with_what_is(tmp_path: Path) -> None:
    root = tmp_path / "root"
    _refused(tmp_path, "1234", f"{root}: Waymo folder: does not exist")
    tiny.write_segment(root)
    _refused(tmp_path, "999", f"{root}: drive 999: does not exist; choose one of {tiny.FILE}")
    with pytest.raises(InputError, match="labels: are already in the Waymo segment"):
        import_drive("waymo", root, tiny.NAME, tmp_path / "log", labels=root / tiny.FILE)
    tiny.write_segment(root / "validation")
    _refused(tmp_path, tiny.NAME, f"is ambiguous: {tiny.FILE}, validation/{tiny.FILE}")


def _scenario(name: str, *more: bytes) -> bytes:
    def track(key: int, x: float) -> bytes:
        states = b"".join(
            blob(
                3,
                double(2, x + k)
                + double(3, 0.0)
                + double(4, 1.0)
                + b"".join(single(n, v) for n, v in ((5, 5), (6, 2), (7, 2), (8, 0)))
                + integer(11, 1),
            )
            for k in range(3)
        )
        return blob(2, integer(1, key) + integer(2, 1) + states)

    return b"".join(
        [
            doubles(1, [0.0, 0.1, 0.2]),
            track(3, 0.0),
            track(8, 20.0),
            blob(5, name),
            integer(6, 0),
            *more,
        ]
    )


def test_a_scenario_is_named_where_a_file_holds_several(tmp_path: Path) -> None:
    path = tmp_path / "root" / "shard.tfrecord"
    write_records(path, [_scenario("aa"), _scenario("bb")])
    _refused(tmp_path, "shard", f"{path}: scenario_id: the file has 2 scenarios; name a scen")
    _refused(tmp_path, "shard:cc", f"{path}: scenario_id: cc is not in the file")
    import_drive("waymo", tmp_path / "root", "shard.tfrecord:bb", tmp_path / "log")
    write_records(path, [_scenario("aa", integer(6, 2))])
    _refused(tmp_path, "shard", f"{path}: record 0, sdc_track_index: is 2, but there are 2")
