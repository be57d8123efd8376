"""Logs and the scenes made of them: rows, and tables as wide as the console is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from recast.cli.shared import Rows, without_images
from recast.core.errors import printable
from recast.logs.load import LogInfo, TrackInfo
from recast.logs.plausibility import Figures
from recast.reconstruction import RegionScore, SceneEvaluation
from recast.scene.exchange import ImportRecord

Cell = Callable[[TrackInfo], str]

BEST = 3
"""Number of candidates that are shown with reasons."""
GAP = 2
"""Number of blanks between columns."""


def log_rows(info: LogInfo) -> Rows:
    """The log, its sensors, its metadata, and its tracks: the best for replacing first.

    Also what was measured of its plausibility, and warnings.
    """
    log = {
        "name": info.name,
        "duration_s": info.seconds,
        "driven_m": info.ego_distance,
        "map_kind": info.map_kind,
        "lanes": info.lanes,
    }
    sensors = [
        {
            "name": one.name,
            "kind": one.kind,
            "frames": one.frames,
            "rate_hz": one.rate,
            "width_px": one.width,
            "height_px": one.height,
        }
        for one in info.sensors
    ]
    metadata = [{"name": name, "value": value} for name, value in info.metadata.items()]
    return {
        "log": [log],
        "sensors": sensors,
        "tracks": [_track(track) for track in info.tracks],
        "metadata": metadata,
        "plausibility": [asdict(info.plausibility.figures)],
        "warnings": [{"warning": sentence} for sentence in info.plausibility.warnings],
    }


def _track(track: TrackInfo) -> dict[str, object]:
    length, width, height = track.size
    seen = track.visibility
    return {
        "track_id": track.track_id,
        "category": track.category,
        "usable": track.usable,
        "why": track.why,
        "length_m": length,
        "width_m": width,
        "height_m": height,
        "duration_s": track.seconds,
        "displacement_m": track.displacement,
        "lidar_points": track.lidar_points,
        "frames": seen.frames,
        "frames_front": seen.front,
        "frames_left": seen.left,
        "frames_rear": seen.rear,
        "frames_right": seen.right,
        "crop_width_px": seen.crop[0],
        "crop_height_px": seen.crop[1],
    }


COLUMNS: dict[str, Cell] = {
    "track": lambda t: printable(t.track_id),
    "class": lambda t: printable(t.category),
    "l w h m": lambda t: " ".join(f"{metres:.1f}" for metres in t.size),
    "s": lambda t: f"{t.seconds:.1f}",
    "moves": lambda t: f"{t.displacement:.1f} m",
    "LiDAR": lambda t: f"{t.lidar_points:,}",
    "seen": lambda t: _count(t.visibility.frames),
    "px": lambda t: f"{max(t.visibility.crop) or '-'}",
    "front": lambda t: _count(t.visibility.front),
    "left": lambda t: _count(t.visibility.left),
    "rear": lambda t: _count(t.visibility.rear),
    "right": lambda t: _count(t.visibility.right),
}
"""Columns of the table of tracks by heading, in the order in which they stand."""
FIRST = ("track", "seen", "px", "LiDAR", "moves", "class", "front", "left", "rear", "right", "s")
"""Columns that are given room first."""


def log_info_tables(info: LogInfo, width: int) -> list[RenderableType]:
    """Sensors, the best candidates for replacing, and all tracks, in lines of `width` characters.

    Names are whole, with control characters escaped; columns that have no room are left out, and
    named.
    """
    title = f"{printable(info.name)}: {info.seconds:.1f} s, {info.ego_distance:.0f} m driven, "
    title += f"map: {info.map_kind}" + (f" ({info.lanes} lanes)" if info.lanes else "")
    parts: list[RenderableType] = [Text(title, style="bold")]
    parts.append(_sensors(info) if info.sensors else Text("no sensors"))
    empty = [one.name for one in info.sensors if one.kind == "camera" and not one.frames]
    parts += [Text(line) for line in without_images(empty)]
    parts.append(Text(f"measured: {_measured(info.plausibility.figures)}"))
    parts += [
        Text(f"warning: {printable(sentence)}", style="bold yellow")
        for sentence in info.plausibility.warnings
    ]
    best = [track for track in info.tracks if track.usable][:BEST]
    parts.append(Text("best candidates for replacing:" if best else "no track can be replaced:"))
    parts.append(_reasons(best or info.tracks[:BEST], width))
    names, left_out = _fitting(info.tracks, width)
    note = "tracks: camera frames that show each and its sides, its largest crop (px), LiDAR points"
    if left_out:
        note += f"; no room for {', '.join(left_out)}: see --json"
    parts += [Text("\n" + note), _tracks(info.tracks, names)]
    return parts


def _measured(figures: Figures) -> str:
    """What the log's plausibility was judged by, as far as it has something to measure."""
    shown = [f"rig leans {figures.rig_lean:.1f}°"]
    if figures.heading_off is not None:
        shown.append(f"faces {figures.heading_off:.1f}° off its motion")
    if figures.reversing:
        shown.append(f"{figures.reversing:.0%} of the way in reverse")
    shown.append(f"up to {figures.speed:.1f} m/s")
    if figures.acceleration is not None:
        shown.append(f"{figures.acceleration:.1f} m/s²")
    if figures.box_lean is not None:
        shown.append(f"boxes lean up to {figures.box_lean:.1f}°")
        shown.append(f"{figures.wider_than_long} of {figures.vehicles} vehicles wider than long")
        shown.append(f"{figures.sideways} of {figures.moving} moving ones sideways")
        shown.append(f"{figures.backwards} backwards")
        shown.append(f"{figures.jumps} jumps, {figures.flips} flips of tracks")
    if figures.principal_point is not None:
        shown.append(f"principal points up to {figures.principal_point:.0%} off the centre")
    if figures.one_value is not None:
        shown.append(f"{figures.one_value:.0%} of sampled images of one colour")
    if figures.near_points is not None:
        shown.append(f"{figures.near_points:.1%} of LiDAR points within 0.5 m")
    return ", ".join(shown)


def _sensors(info: LogInfo) -> Table:
    table = Table()
    for heading in ("sensor", "kind", "frames", "per second", "size"):
        table.add_column(heading, overflow="fold")
    for sensor in info.sensors:
        size = "" if sensor.width is None else f"{sensor.width} x {sensor.height}"
        cells = (
            printable(sensor.name),
            sensor.kind,
            str(sensor.frames),
            f"{sensor.rate:.1f}",
            size,
        )
        table.add_row(*map(Text, cells))
    return table


def _reasons(tracks: Sequence[TrackInfo], width: int) -> Table:
    table = Table.grid(padding=(0, GAP))
    widest = min(_widest(tracks, COLUMNS["track"]) + 1, width)
    table.add_column(overflow="fold", min_width=widest, max_width=widest)
    table.add_column(overflow="fold")
    for track in tracks:
        table.add_row(Text(" " + COLUMNS["track"](track)), Text(track.why))
    return table


def _fitting(tracks: Sequence[TrackInfo], width: int) -> tuple[list[str], list[str]]:
    """Headings of the columns that fit into `width`, and of those that do not."""
    order = (*FIRST, *(name for name in COLUMNS if name not in FIRST))
    chosen: list[str] = []
    room = width
    for name in order:
        room -= max(cell_len(name), _widest(tracks, COLUMNS[name])) + GAP
        if room < 0 and chosen:
            break
        chosen.append(name)
    return (
        [name for name in COLUMNS if name in chosen],
        [name for name in COLUMNS if name not in chosen],
    )


def _tracks(tracks: Sequence[TrackInfo], names: Sequence[str]) -> Table:
    # The box puts another blank between columns.
    table = Table(box=SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
    for name in names:
        words = name in ("track", "class")
        table.add_column(
            name, justify="left" if words else "right", overflow="fold", no_wrap=name != "track"
        )
    for track in tracks:
        table.add_row(*(Text(COLUMNS[name](track)) for name in names))
    return table


def _widest(tracks: Sequence[TrackInfo], cell: Cell) -> int:
    return max((cell_len(cell(track)) for track in tracks), default=0)


def _count(frames: int) -> str:
    return str(frames) if frames else "-"


def evaluation_rows(evaluation: SceneEvaluation) -> Rows:
    """Scores of held-out images by region, of the depth, and of novel views by shift.

    A shift without ground truth has no scores.
    """
    frames = evaluation.frames
    regions = [_region("whole image", len(frames), evaluation.whole)]
    if evaluation.moving is not None:
        seen = sum(frame.moving is not None for frame in frames)
        regions.append(_region("moving objects", seen, evaluation.moving))
    for track, psnr in evaluation.box_psnr_by_track().items():
        seen = sum(track in frame.boxes for frame in frames)
        regions.append({"region": "box", "track_id": track, "images": seen, "psnr_db": psnr})
    if evaluation.box_psnr is not None:
        seen = sum(bool(frame.boxes) for frame in frames)
        regions.append({"region": "all boxes", "images": seen, "psnr_db": evaluation.box_psnr})
    depth = evaluation.depth
    shifts = [
        {
            **_region("whole image", len(one.frames), one.whole),
            "shift": one.shift.name,
            "pictures": one.pictures,
        }
        for one in evaluation.shifts
    ]
    return {
        "held_out_images": regions,
        "depth": [] if depth is None else [_depth(depth)],
        "novel_views": shifts,
    }


def _region(name: str, images: int, score: RegionScore | None) -> dict[str, Any]:
    psnr, ssim, lpips = (None,) * 3 if score is None else (score.psnr, score.ssim, score.lpips)
    return {"region": name, "images": images, "psnr_db": psnr, "ssim": ssim, "lpips": lpips}


def _depth(depth: Any) -> dict[str, Any]:
    return {
        "lidar_points": depth.points,
        "missing_percent": 100 * depth.missing,
        "median_error_m": depth.median_abs_m,
        "mean_error_m": depth.mean_abs_m,
        "mean_relative_error_percent": 100 * depth.mean_relative,
        "lag_ms": depth.lag_ms,
    }


def import_lines(record: ImportRecord) -> list[tuple[str, str]]:
    """Lines and their styles: place, actors, what was changed, left out, and what looks wrong."""
    names = ", ".join(f"{name} is track {track}" for name, track in record.tracks.items())
    lines = [(f"placed by: {record.placed_by}", ""), (f"actors: {names or 'none'}", "")]
    lines += [(f"changed: {sentence}", "") for sentence in record.changed]
    lines += [(f"left out: {sentence}", "yellow") for sentence in record.left_out]
    lines += [(f"warning: {sentence}", "bold yellow") for sentence in record.warnings]
    return lines
