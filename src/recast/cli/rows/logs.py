"""Logs, their scenarios and the scenes made of them: rows, and tables as wide as the console is.

A list of scenarios needs no torch: what places them on a log is imported when it is used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from recast.cli.shared import Rows, with_unit, without_images
from recast.core import files
from recast.core.errors import InputError, printable
from recast.logs.load import LogInfo, TrackInfo
from recast.logs.plausibility import Figures
from recast.simulation import MOTIONS, ScriptedMotion, parse_motions, scenario_name
from recast.simulation.scenario import (
    MOTION_SCHEMAS,
    further_actors,
    kind_of,
    motion_numbers,
    scenario_numbers,
    target_motion,
)

if TYPE_CHECKING:
    from recast.logs import DrivingLog
    from recast.reconstruction import RegionScore, SceneEvaluation
    from recast.reporting.previews import ScenarioFacts
    from recast.scene.exchange import ImportRecord
    from recast.scene.street_scene import ViewGaps
    from recast.simulation import PreparedRollout, RolloutSetup


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
        "view_span_deg": seen.span,
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
            **_gaps(one.gaps),
            "pictures": one.pictures,
        }
        for one in evaluation.shifts
    ]
    return {
        "held_out_images": regions,
        "depth": [] if depth is None else [_depth(depth)],
        "gaps": [_gaps(evaluation.gaps)],
        "novel_views": shifts,
    }


def _gaps(gaps: ViewGaps | None) -> dict[str, float | None]:
    invented, empty = (None, None) if gaps is None else (100 * gaps.invented, 100 * gaps.empty)
    return {"invented_percent": invented, "empty_percent": empty}


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


def scenario_rows(names: Sequence[str]) -> Rows:
    """One row for each scenario, and one for each further actor of a scenario.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    found, actors = [], []
    for motion in _motions(names):
        name = scenario_name(motion)
        found.append(
            {"scenario": name, "description": motion.description, **_numbers(target_motion(motion))}
        )
        actors += [
            {"scenario": name, "track_id": actor.track_id, **_numbers(actor.motion)}
            for actor in further_actors(motion)
        ]
    return {"scenarios": found, "further_actors": actors}


def list_scenarios(names: Sequence[str], console: Console) -> None:
    """Print the scenarios that names and files stand for; where none is given, all built in.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    console.print(_table(_motions(names)))


def _motions(names: Sequence[str]) -> list[ScriptedMotion]:
    """What names and files stand for; all that are built in if none is given."""
    return [one for name in names for one in parse_motions(name)] or list(MOTIONS.values())


def _table(motions: Sequence[ScriptedMotion]) -> Table:
    """Scenarios with their numbers and units, one a row."""
    table = Table(box=SIMPLE_HEAD)
    for heading in ("scenario", "numbers", "what happens"):
        table.add_column(heading)
    for motion in motions:
        numbers = scenario_numbers(motion)
        # as text: a description is no markup
        table.add_row(
            scenario_name(motion), "\n".join(numbers), Text(printable(motion.description))
        )
    return table


def _numbers(motion: Any) -> dict[str, Any]:
    kind = kind_of(motion)
    quantities = {} if kind is None else MOTION_SCHEMAS[kind].quantities
    numbers = motion_numbers(motion)
    return {
        "motion": kind or motion.name,
        **{with_unit(name, quantities[name].unit): value for name, value in numbers.items()},
    }


@dataclass(frozen=True)
class PlacedScenario:
    """A scenario on a log; why it cannot be run there, or what it becomes.

    Attributes:
        shown: setup, prepared rollout and facts; None if it is refused.
    """

    name: str
    track: str
    refused: InputError | None
    shown: tuple[RolloutSetup, PreparedRollout, ScenarioFacts] | None = None


def place_scenarios(
    log_path: Path, names: Sequence[str], track: str | None, steps: int
) -> list[PlacedScenario]:
    """Prepare scenarios on a log.

    Args:
        track: track to control; None for the target of a synthetic log, or the first track.
    """
    from recast.logs import map_of, read_log
    from recast.reporting.previews import scenario_facts
    from recast.simulation import RolloutSetup, prepare

    motions = {scenario_name(m): m for name in names for m in parse_motions(name)}
    log = read_log(log_path)
    track = target_of(log) if track is None else track
    hdmap, found = map_of(log), []
    for name, motion in motions.items():
        setup = RolloutSetup(log, track, motion, map=hdmap, steps=steps)
        try:
            prepared = prepare(setup)
        except InputError as error:
            found.append(PlacedScenario(name, track, error))
            continue
        found.append(
            PlacedScenario(name, track, None, (setup, prepared, scenario_facts(setup, prepared)))
        )
    return found


def placed_rows(placed: Sequence[PlacedScenario]) -> Rows:
    """One row for each scenario on a log; `refused` says why it cannot be run there."""
    return {
        "scenarios": [
            {
                "scenario": one.name,
                "track_id": one.track,
                "refused": None if one.refused is None else str(one.refused),
                **({} if one.shown is None else _facts(one.shown[2])),
            }
            for one in placed
        ]
    }


def _facts(facts: ScenarioFacts) -> dict[str, Any]:
    return {
        "start_s": facts.start,
        "ego_speed_mps": facts.ego_speed,
        "gap_m": facts.gap,
        "actor_speed_start_mps": facts.actor_speeds[0],
        "actor_speed_end_mps": facts.actor_speeds[1],
        "lateral_start_m": facts.laterals[0],
        "lateral_end_m": facts.laterals[1],
        "contact_s": facts.meets_log,
        "off_road_s": facts.off_road,
        "rollout_s": facts.seconds,
        "asked_s": facts.asked,
        "cut_reason": facts.cut_reason,
    }


def show_scenarios(placed: Sequence[PlacedScenario], out: Path, console: Console) -> None:
    """Draw scenarios on a log's map into a PNG, and print what they become there.

    Raises:
        InputError: `out` is no PNG, every scenario is refused on this log, or the disk refuses.
    """
    from PIL import Image

    from recast.reporting.previews import draw_scenarios, facts_table, notes

    if out.suffix.lower() != ".png":
        raise InputError(out, "--out", "is not a PNG", "end its name in .png")
    for one in placed:
        if one.refused is not None:
            console.print(f"{one.name}: refused: {one.refused}", markup=False, style="yellow")
    shown = [one.shown for one in placed if one.shown is not None]
    if not shown and placed[0].refused is not None:
        raise placed[0].refused
    facts = [facts for _, _, facts in shown]
    console.print(
        f"track {printable(placed[0].track)}; start {facts[0].start:.1f} s after the log's first "
        f"pose, ego {facts[0].ego_speed:.1f} m/s",
        markup=False,
        highlight=False,
    )
    console.print(facts_table(facts))
    for note in notes(facts):
        console.print(note, markup=False, highlight=False)
    with files.atomic_file(out) as partial:
        Image.fromarray(draw_scenarios(shown)).save(partial, format="PNG")
    console.print(f"wrote {out}", markup=False)


def target_of(log: DrivingLog) -> str:
    """The track that is controlled if none is named.

    Raises:
        InputError: the log has no tracks.
    """
    if not log.tracks:
        raise InputError(log.name, "tracks", "are missing", "use a log with labelled vehicles")
    target = log.metadata.get("target", "")
    return target if target in log.tracks else next(iter(log.tracks))
