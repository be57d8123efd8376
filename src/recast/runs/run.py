"""`recast run`: the whole job, from a log to a report."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from pathlib import Path

from rich.console import Console

from recast.core import Artefact, files, open_store, value_hash
from recast.core.errors import InputError, printable
from recast.core.workers import use_threads
from recast.runs.artefacts import Artefacts
from recast.runs.config import RunConfig
from recast.runs.display import failure_lines, results_tables
from recast.runs.report import report_run
from recast.runs.rollouts import announce_planner, require_distinct_planners
from recast.runs.run_folder import METRICS_FILE, REPLAY_FILE, REPORT_FOLDER, STORE_FOLDER, RunFolder
from recast.runs.scores import RunTrust, read_metrics, write_metrics
from recast.runs.sources import RECIPES, SourceLog, Sources, require_track
from recast.runs.view import view_inputs
from recast.simulation import prepare
from recast.simulation.renderer import make_restorer
from recast.viewer import require_viser, write_replay

REPLAY_MB = 10.0
"""Size of a run's replay at most, in 1e6 bytes; the report takes a copy, and is passed on whole."""


def run(
    log_path: str | Path,
    out: str | Path,
    config: RunConfig,
    console: Console,
    store: str | Path | None = None,
) -> Path:
    """Do the whole job and return the report's `index.html`.

    Args:
        log_path: log folder, or its address in object storage.
        out: run folder; one that holds this run already is resumed.
        store: folder or address of the artefacts; beside `out` where none is named.

    Raises:
        InputError: bad log, track, planner, generator or segmenter, a camera that the planner wants
            and the log lacks, a folder that holds another run, or another process at work there.
    """
    out = Path(out)
    place = str(out.absolute().parent / STORE_FOLDER if store is None else store)
    source = SourceLog.open(log_path)
    # What cannot work is refused before anything is written and before minutes of training.
    require_track(source.log, source.path, config.track)
    if any(arm.needs_world for arm in config.arms):
        _ = source.world
    sources = Sources.of(config, source.log.name)
    artefacts = Artefacts(
        open_store(place), source, config, sources, console, source.log.name, config.threads
    )
    require_distinct_planners({word: artefacts.planner(word) for word in config.planners})
    for planner in config.planners:
        announce_planner(artefacts.planner(planner), artefacts.mounts(planner), console)
    if config.restorer is not None:
        make_restorer(config.restorer)
    for arm in artefacts.arms.values():
        if arm.generates:
            artefacts.makers(arm)
    use_threads(config.threads)
    folder = RunFolder.create_or_resume(
        out, config.resolved(), source.address or source.path, source.hash, place
    )
    with files.alone_in(folder.path):
        try:
            return _Run(artefacts, folder, console).finish()
        finally:
            artefacts.close()


class _Run:
    def __init__(self, artefacts: Artefacts, folder: RunFolder, console: Console) -> None:
        self._artefacts, self._folder, self._console = artefacts, folder, console
        self._config = artefacts.config

    def finish(self) -> Path:
        """Make what is not there yet; return the report's page."""
        artefacts = self._artefacts
        artefacts.on_use = lambda: self._folder.refer(artefacts.store, artefacts.used)
        self._announce()
        for arm in artefacts.arms.values():
            artefacts.prepare(arm)
        artefacts.forget_makers()
        motions, planners = self._config.motions, self._config.planners
        for motion, planner, arm in product(motions, planners, artefacts.arms.values()):
            artefacts.rollout(motion, planner, arm)
        self._folder.refer(artefacts.store, artefacts.used, whole=True)
        return self._report()

    def _report(self) -> Path:
        path, used, source = self._folder.path, self._artefacts.used, self._artefacts.source
        trust = RunTrust(source.log, self._config.track)
        made_from = _hash_of("metrics", used.values())
        self._folder.finish(
            METRICS_FILE,
            made_from,
            lambda: write_metrics(path / METRICS_FILE, self._config, used, source.map, trust),
        )
        made_from = _hash_of("report", used.values())
        made_from += "" if self._replay(made_from) else ", no replay"
        with self._console.status("writing the report"):
            self._folder.finish(REPORT_FOLDER, made_from, lambda: report_run(path))
        metrics = read_metrics(path / METRICS_FILE)
        for table in results_tables(metrics["table"]):
            self._console.print(table)
        for line in failure_lines(metrics["failures"]):
            self._console.print(printable(line), markup=False, highlight=False, style="red")
        page = path / REPORT_FOLDER / "index.html"
        self._console.print(f"report: {page}", markup=False)
        return page

    def _replay(self, made_from: str) -> bool:
        """Write the moving scene of the first scenario, which the report links."""
        path = self._folder.path

        def write() -> None:
            write_replay(view_inputs([path]), path / REPLAY_FILE, most_mb=REPLAY_MB)

        with self._console.status("writing the replay"):
            try:
                require_viser()
                self._folder.finish(REPLAY_FILE, made_from, write)
            except InputError as error:  # the report says that there is none
                self._console.print(f"no replay: {error}", markup=False, style="yellow")
        return (path / REPLAY_FILE).is_file()

    def _announce(self) -> None:
        """Say before the long steps how far each rollout can go.

        Raises:
            InputError: none of them can be run at all.
        """
        refusals = []
        first = next(iter(self._artefacts.arms.values()))
        for motion in self._config.motions:
            try:
                prepared = prepare(self._artefacts.setup(motion, first))
            except InputError as error:  # becomes a row of the report
                refusals.append(error)
                self._artefacts.possible_steps[motion] = 0
                self._console.print(f"{motion}: refused: {error}", markup=False, style="yellow")
                continue
            self._artefacts.possible_steps[motion] = prepared.steps
            reason = f" ({prepared.cut_reason})" if prepared.cut_reason else ""
            self._console.print(
                f"{motion}: up to {prepared.steps} of {self._config.steps} steps{reason}",
                markup=False,
            )
        if len(refusals) == len(self._config.motions):
            raise refusals[0]


def _hash_of(recipe: str, used: Iterable[Artefact]) -> str:
    references = sorted({artefact.reference for artefact in used})
    return value_hash({"artefacts": references, "recipe": RECIPES[recipe]})
