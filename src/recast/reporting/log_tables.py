"""A log's summary as tables for the console."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table

from recast.logs.info import LogInfo


def log_info_tables(info: LogInfo) -> tuple[Table, Table]:
    """Sensors, and tracks with how far each moves and from which sides the cameras saw it."""
    title = f"{info.name}: {info.seconds:.1f} s, {info.ego_distance:.0f} m driven, map: "
    title += info.map_kind + (f" ({info.lanes} lanes)" if info.lanes else "")
    sensors = Table(title=title, title_justify="left")
    for heading in ("sensor", "kind", "frames", "per second", "size"):
        sensors.add_column(heading)
    for sensor in info.sensors:
        size = "" if sensor.width is None else f"{sensor.width} x {sensor.height}"
        sensors.add_row(sensor.name, sensor.kind, str(sensor.frames), f"{sensor.rate:.1f}", size)
    tracks = Table(
        box=SIMPLE_HEAD,
        padding=(0, 1),
        collapse_padding=True,
        pad_edge=False,
        title="tracks: LiDAR points, and camera frames that show the track and each of its sides",
        title_justify="left",
    )
    headings = ("track", "class", "l w h m", "s", "moves", "LiDAR", "seen")
    for heading in (*headings, "front", "left", "rear", "right"):
        tracks.add_column(heading, no_wrap=True)
    for track in info.tracks:
        seen = track.visibility
        counts = (seen.frames, seen.front, seen.left, seen.rear, seen.right)
        tracks.add_row(
            track.track_id,
            track.category,
            " ".join(f"{metres:.1f}" for metres in track.size),
            f"{track.seconds:.1f}",
            f"{track.displacement:.1f} m",
            f"{track.lidar_points:,}",
            *(str(count) if count else "-" for count in counts),
        )
    return sensors, tracks
