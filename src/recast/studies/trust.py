"""`recast bench trust`: calibrates the trust figure on finished grids; see docs/trust.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
from rich.console import Console
from rich.table import Table

from recast.core import files
from recast.core.errors import InputError, printable
from recast.core.table_files import read_parquet
from recast.metrics.trust import (
    JudgedRollout,
    Reliability,
    TrustCalibration,
    calibrate,
    packaged_calibration,
    read_calibration,
    reliability,
    write_calibration,
)
from recast.reporting.plots import write_reliability
from recast.runs.display import narrow_table
from recast.runs.report import open_run
from recast.studies.grid import BENCH_FORMAT, RECORD_FILE, ROLLOUTS_FILE, SCENES_FOLDER

_NAMES = ("scene", "motion", "setting", "planner", "arm")
_MEND = "give the folder of a finished `recast bench closed-loop`"
Key = tuple[str, ...]
"""Scene, motion, setting, planner and arm of a rollout."""


def run_trust(
    grids: Sequence[Path],
    validate: Sequence[Path],
    out: Path | None,
    console: Console,
    calibration: Path | None = None,
) -> dict[str, Reliability]:
    """Calibrate on grids, apply a calibration to others, print and write both.

    Args:
        grids: folders of grids with an oracle arm; none to validate alone.
        validate: folders of grids that a calibration is applied to: the one that is made now, or
            else `calibration`.
        out: file of the calibration; diagrams are written beside it. May be None without `grids`.
        calibration: file of a calibration; that of the package if None.

    Returns:
        Reliabilities "left out", by scenes left out in turn, and "validation", as far as asked for.

    Raises:
        InputError: nothing is asked for, a grid is not finished or has no truth, or too little data
            to calibrate.
    """
    if not grids and not validate:
        raise InputError("GRIDS", "grid", "none is given", "give a grid, or --validate GRID")
    if grids and (out is None or calibration is not None):
        problem, mend = "is missing", "give the file for the new calibration"
        if out is not None:
            problem, mend = "is made from GRIDS", "leave out --calibration, or GRIDS and --out"
        raise InputError("--out", "calibration", problem, mend)
    found: dict[str, Reliability] = {}
    if grids:
        assert out is not None
        made, found["left out"] = calibrate(_all_rollouts(grids, console), _named(grids))
        write_calibration(made, out)
        _print(found["left out"], "each scene judged by the others", console)
        console.print(coefficients_table(made))
    else:
        made = packaged_calibration() if calibration is None else read_calibration(calibration)
    if validate:
        rollouts, model = _all_rollouts(validate, console), made.model
        trust = [model.trust(one.features) for one in rollouts]
        found["validation"] = reliability(rollouts, trust)
        _print(found["validation"], "validation", console)
    if out is not None:
        for name, one in found.items():
            ending = ".svg" if name == "left out" else "-validation.svg"
            path = out.with_name(out.stem + ending)
            write_reliability(one, path)
            console.print(f"wrote {path}", markup=False, highlight=False)
    if grids:
        console.print(f"wrote {out}", markup=False, highlight=False)
    return found


def judged_rollouts(grid: Path) -> list[JudgedRollout]:
    """The rollouts of a finished grid that were compared with the truth, with their features.

    Rollouts of planners that look at no images are left out, their verdicts are right anyway, and
    so is the truth under noise.

    Raises:
        InputError: it is no finished grid, has no truth, or an artefact is gone.
    """
    verdicts = _verdicts(grid)
    found = []
    for scene in dict.fromkeys(key[0] for key in verdicts):
        run = open_run(grid / SCENES_FOLDER / scene)
        for one in run.rollouts():
            rollout = one.metrics.rollout
            key = (scene, rollout.motion, rollout.setting, rollout.planner, rollout.arm)
            if key not in verdicts or one.arm.is_truth:
                continue
            features = run.trust.features(one)
            if features is not None:
                scenario = f"{rollout.motion}-{rollout.setting}"
                name = (scene, scenario, rollout.planner, rollout.arm)
                found.append(JudgedRollout(*name, features.values, verdicts[key]))
    return found


def coefficients_table(calibration: TrustCalibration) -> Table:
    """A line for each feature: what one standard deviation of it adds to the log-odds."""
    figures = ["coefficient", "mean", "deviation", "known"]
    table = narrow_table("log-odds by feature", ["feature"], figures)
    for one in calibration.features:
        values = (f"{value:.3g}" for value in (one.mean, one.scale))
        table.add_row(one.name, f"{one.coefficient:+.3f}", *values, str(one.known))
    return table


def reliability_table(found: Reliability, title: str) -> Table:
    """A line for each bin of trust."""
    table = narrow_table(title, ["trust"], ["rollouts", "mean trust", "agree with the truth"])
    for one in found.bins:
        shares = ("-" if v is None else f"{v:.2f}" for v in (one.trust, one.agreeing))
        table.add_row(f"{one.low:.1f} to {one.high:.1f}", str(one.count), *shares)
    return table


def _print(found: Reliability, title: str, console: Console) -> None:
    console.print(reliability_table(found, title))
    areas = (found.auc, found.verdict_auc, found.collision_auc)
    auc, alone, of_collisions = ("none" if one is None else f"{one:.3f}" for one in areas)
    console.print(
        f"{found.agreeing} of {found.rollouts} agree, {found.scenes} scenes; area under the ROC "
        f"curve {auc} ({alone} for the verdict alone), {of_collisions} among collisions "
        f"({found.agreeing_collisions} of {found.collisions} agree); Brier score "
        f"{found.brier:.3f} ({found.base_brier:.3f} for the mean alone)",
        markup=False,
        highlight=False,
    )


def _all_rollouts(grids: Sequence[Path], console: Console) -> list[JudgedRollout]:
    """Those of several grids; one that two of them have counts once, with its flips if known."""
    found: dict[tuple[object, ...], JudgedRollout] = {}
    for grid in grids:
        rollouts = judged_rollouts(grid)
        if not rollouts:
            problem = "no planner of the grid uses images"
            raise InputError(grid, "rollouts", problem, "give a grid with another planner")
        words = f"{printable(str(grid))}: {len(rollouts)} rollouts"
        console.print(words, markup=False, highlight=False)
        for one in rollouts:
            if "noise_flips" in one.features:
                found[_identity(one)] = one
            else:
                found.setdefault(_identity(one), one)
    return list(found.values())


def _identity(one: JudgedRollout) -> tuple[object, ...]:
    """What tells the rollouts of all grids apart.

    Two grids may have a scene of the same name in another size, so the features belong to it; the
    key of a stored rollout does not serve, as films change it and not the drive.
    """
    features = {name: value for name, value in one.features.items() if name != "noise_flips"}
    named = one.scene, one.scenario, one.planner, one.arm
    return *named, one.agrees, *sorted(features.items())


def _named(grids: Sequence[Path]) -> list[str]:
    """Names of the grids' folders, without where they lie."""
    return [grid.resolve().name for grid in grids]


def _verdicts(grid: Path) -> dict[Key, bool]:
    """Whether each compared rollout agrees with the truth."""
    record = files.read_json(grid / RECORD_FILE)
    if not isinstance(record, dict) or record.get("format") != BENCH_FORMAT:
        raise InputError(grid / RECORD_FILE, "format", "is not that of a grid", _MEND)
    path = grid / ROLLOUTS_FILE
    if not path.is_file():
        raise InputError(path, "rollouts", "are missing: the grid is not finished", _MEND)
    table = read_parquet(path, (*_NAMES, "verdict_agrees"), _MEND)
    agrees = table.data["verdict_agrees"]
    if not pa.types.is_boolean(agrees.type):
        raise InputError(
            path, "column verdict_agrees", f"has type {agrees.type}, expected boolean", _MEND
        )
    keys = zip(*(table.words(name).tolist() for name in _NAMES), strict=True)
    found = {
        key: bool(value)
        for key, value in zip(keys, agrees.to_pylist(), strict=True)
        if value is not None
    }
    if not found:
        problem = "has no value: no rollout was compared with the truth"
        mend = "give a grid that was run with `--arm oracle`"
        raise InputError(path, "column verdict_agrees", problem, mend)
    return found
