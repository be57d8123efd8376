"""Scenarios looked at before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from rich.console import Console

from recast import storage
from recast.errors import InputError, printable
from recast.logs import DrivingLog, map_of, read_log
from recast.reporting.scenario_facts import (
    facts_table,
    motions_table,
    notes,
    scenario_facts,
)
from recast.reporting.scenario_figure import draw_scenarios
from recast.simulation import MOTIONS, RolloutSetup, parse_motions, prepare, scenario_name


def list_scenarios(names: Sequence[str], console: Console) -> None:
    """Print the scenarios that names and files stand for; where none is given, all built in.

    Raises:
        InputError: an unknown name or a faulty file.
    """
    found = [motion for name in names for motion in parse_motions(name)] or list(MOTIONS.values())
    console.print(motions_table(found))


def show_scenarios(
    log_path: Path, names: Sequence[str], track: str | None, out: Path, steps: int, console: Console
) -> None:
    """Draw scenarios on a log's map and print what they become there.

    Args:
        names: scenarios, motions or scenario files.
        track: the actor; None for the target of a synthetic log, or the first track.
        out: PNG to write.
        steps: of 0.1 s that a rollout would be asked for.

    Raises:
        InputError: bad names, log, track or output; or every scenario is refused on this log.
    """
    if out.suffix.lower() != ".png":
        raise InputError(out, "--out", "is no PNG", "end its name in .png")
    motions = {scenario_name(m): m for name in names for m in parse_motions(name)}
    log = read_log(log_path)
    track = _target(log) if track is None else track
    hdmap, shown, refusals = map_of(log), [], []
    for name, motion in motions.items():
        setup = RolloutSetup(log, track, motion, map=hdmap, steps=steps)
        try:
            prepared = prepare(setup)
        except InputError as error:
            refusals.append(error)
            console.print(f"{name}: refused: {error}", markup=False, style="yellow")
            continue
        shown.append((setup, prepared, scenario_facts(setup, prepared)))
    if not shown:
        raise refusals[0]
    facts = [facts for _, _, facts in shown]
    console.print(
        f"track {printable(track)}; start {facts[0].start:.1f} s after the log's first pose, "
        f"ego {facts[0].ego_speed:.1f} m/s",
        markup=False, highlight=False,
    )  # fmt: skip
    console.print(facts_table(facts))
    for note in notes(facts):
        console.print(note, markup=False, highlight=False)
    with storage.atomic_file(out) as partial:
        Image.fromarray(draw_scenarios(shown)).save(partial, format="PNG")
    console.print(f"wrote {out}", markup=False)


def _target(log: DrivingLog) -> str:
    if not log.tracks:
        raise InputError(log.name, "tracks", "there are none", "use a log with labelled vehicles")
    target = log.metadata.get("target", "")
    return target if target in log.tracks else next(iter(log.tracks))
