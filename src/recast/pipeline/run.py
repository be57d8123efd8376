"""`recast run`: from a log to a report, in steps that resume."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from recast import storage
from recast.actors import load_actor
from recast.errors import InputError
from recast.evaluation import evaluate_oracle_views, rollout_metrics, table
from recast.logs import DrivingLog, HdMap, map_of, read_log
from recast.pipeline.actor import generator_of, make_actor
from recast.pipeline.config import RunConfig
from recast.pipeline.display import FrameProgress, results_table, truth_table
from recast.pipeline.fingerprint import file_hash, folder_hash
from recast.pipeline.layout import (
    ACTOR_FOLDER,
    EVALUATION_FOLDER,
    METRICS_FILE,
    OBSERVATION_FOLDER,
    REPORT_FOLDER,
    ROLLOUTS_FOLDER,
    SCENE_FOLDER,
    TRUTH_FOLDER,
    TURNTABLE_FILE,
    Method,
)
from recast.pipeline.methods import method_renderer, method_scene
from recast.pipeline.report import report_run
from recast.pipeline.rollouts import make_rollout, read_rollout
from recast.pipeline.run_folder import RunFolder
from recast.pipeline.scene import evaluation_table, train_with_display
from recast.planning import make_planner
from recast.scene import evaluate_scene, load_scene
from recast.simulation import (
    MOTIONS,
    RolloutFailure,
    RolloutSetup,
    camera_mounts,
    prepare,
)
from recast.splats import set_threads
from recast.synthetic import Oracle, world_of
from recast.synthetic.rig import exposure


def run(log_path: str | Path, out: str | Path, config: RunConfig, console: Console) -> Path:
    """Do the whole job and return the report's `index.html`.

    Args:
        log_path: log folder.
        out: run folder; one that holds this run already is resumed.
        console: shows steps, progress and time left.

    Raises:
        InputError: bad log, track, planner, generator, or a folder that holds another run.
    """
    log_path, out = Path(log_path), Path(out)
    log = read_log(log_path)
    # What cannot work is refused before anything is written and before minutes of training.
    if config.track not in log.tracks:
        raise InputError(
            log_path, f"track {config.track}", "is not in the log",
            f"choose one of {', '.join(log.tracks)}",
        )  # fmt: skip
    if "oracle" in config.methods:
        world_of(log)
    make_planner(config.planner)
    generator_of(config.generator)
    threads = config.threads or os.cpu_count() or 1
    torch.set_num_threads(threads)
    set_threads(threads)
    folder = RunFolder.create_or_resume(
        out, config.resolved(), str(log_path), folder_hash(log_path)
    )
    return _Job(log, folder, config, console).finish()


class _Job:
    """The steps of one run, each after those it needs."""

    def __init__(
        self, log: DrivingLog, folder: RunFolder, config: RunConfig, console: Console
    ) -> None:
        self.log, self.folder, self.config, self.console = log, folder, config, console
        self.path = folder.path
        self.map: HdMap = map_of(log)
        self.possible_steps: dict[str, int] = {}
        self.done = 0
        self.total = 5 + len(config.motions) * len(config.methods) + ("oracle" in config.methods)

    def finish(self) -> Path:
        """Make what is not finished yet; return the report's page."""
        self._announce()
        actor = self._step(
            "actor", self._actor_inputs(), self._make_actor,
            (OBSERVATION_FOLDER, ACTOR_FOLDER, TURNTABLE_FILE),
        )  # fmt: skip
        scene = self._step(
            "scene", {"log": self._log_hash, "config": self.config.scene.model_dump(mode="json")},
            self._train, (SCENE_FOLDER,), keep_partial=True,
        )  # fmt: skip
        evaluation = self._step(
            "evaluation", {"scene": scene}, self._evaluate, (EVALUATION_FOLDER,)
        )
        truth = None
        if "oracle" in self.config.methods:
            truth = self._step(
                "truth", {"scene": scene, "actor": actor, "seed": self.config.seed},
                self._compare_with_truth, (TRUTH_FOLDER,),
            )  # fmt: skip
        rollouts = {
            f"{motion}/{method}": self._rollout(motion, method, scene, actor)
            for motion in self.config.motions
            for method in self.config.methods
        }
        metrics = self._step(
            "metrics",
            {"rollouts": rollouts, "evaluation": evaluation, "actor": actor, "truth": truth},
            self._score, (METRICS_FILE,),
        )  # fmt: skip
        self._step("report", {"metrics": metrics}, self._report, (REPORT_FOLDER,))
        return self._conclude()

    @property
    def _log_hash(self) -> str:
        return str(self.folder.record["log"]["hash"])

    def _step(
        self,
        name: str,
        inputs: Mapping[str, Any],
        make: Callable[[], None],
        outputs: tuple[str, ...],
        keep_partial: bool = False,
    ) -> str:
        self.done += 1
        self.console.print(f"[bold]\\[{self.done}/{self.total}] {name}[/bold]")
        fingerprint, made = self.folder.step(name, dict(inputs), make, outputs, keep_partial)
        if not made:
            self.console.print("  finished before")
        return fingerprint

    def _actor_inputs(self) -> dict[str, Any]:
        generator = self.config.generator
        source = file_hash(generator) if generator.lower().endswith(".ply") else generator
        return {
            "log": self._log_hash,
            "track": self.config.track,
            "generator": source,
            "seed": self.config.seed,
            "cameras": list(self.config.scene.cameras),
        }

    def _make_actor(self) -> None:
        config = self.config
        with self.console.status("observing, generating, registering"):
            actor = make_actor(
                self.log, config.track, config.generator, config.seed, self.path,
                config.scene.cameras,
            )  # fmt: skip
        self.console.print(actor.provenance.registration.explain(), markup=False, highlight=False)

    def _train(self) -> None:
        train_with_display(self.log, self.path / SCENE_FOLDER, self.config.scene, self.console)

    def _evaluate(self) -> None:
        if self.config.scene.holdout_every == 0:
            (self.path / EVALUATION_FOLDER).mkdir()
            return
        scene = load_scene(self.path / SCENE_FOLDER)
        with storage.atomic_folder(self.path / EVALUATION_FOLDER) as partial:
            evaluation = evaluate_scene(scene, self.log, self.config.scene, partial)
        self.console.print(evaluation_table(evaluation))

    def _compare_with_truth(self) -> None:
        config = self.config
        world = world_of(self.log)
        mounts = camera_mounts(self.log, self._cameras, config.scene.scale)
        with FrameProgress(self.console, 1, "views") as progress:
            views = evaluate_oracle_views(
                self.log,
                method_scene("native", self.path),
                method_scene("replaced", self.path),
                Oracle(world),
                config.track,
                mounts,
                self.path / TRUTH_FOLDER,
                rng=np.random.default_rng(config.seed),
                exposures={name: exposure(world.seed, name) for name in mounts},
                progress=progress.reach,
            )
        self.console.print(truth_table(views))

    @property
    def _cameras(self) -> tuple[str, ...]:
        return self.config.scene.cameras or tuple(self.log.cameras)

    def _rollout(self, motion: str, method: Method, scene: str, actor: str) -> str:
        config = self.config
        inputs: dict[str, Any] = {
            "log": self._log_hash,
            "track": config.track,
            "motion": motion,
            "method": method,
            "planner": config.planner,
            "steps": config.steps,
            "plan_every": config.plan_every,
            "keep_other_actors": config.keep_other_actors,
        }
        if method == "oracle":
            inputs |= {"cameras": list(config.scene.cameras), "scale": config.scene.scale}
        else:
            inputs["scene"] = scene
        if method == "replaced":
            inputs["actor"] = actor
        target = f"{ROLLOUTS_FOLDER}/{motion}/{method}"
        return self._step(
            f"rollout-{motion}-{method}", inputs,
            lambda: self._make_rollout(motion, method, self.path / target), (target,),
        )  # fmt: skip

    def _setup(self, motion: str, method: str) -> RolloutSetup:
        config = self.config
        return RolloutSetup(
            log=self.log,
            track_id=config.track,
            motion=MOTIONS[motion],
            method=method,
            map=self.map,
            steps=config.steps,
            plan_every=config.plan_every,
            keep_other_actors=config.keep_other_actors,
            camera_names=self._cameras,
        )

    def _make_rollout(self, motion: str, method: Method, target: Path) -> None:
        setup = self._setup(motion, method)
        mounts = camera_mounts(self.log, setup.camera_names, self.config.scene.scale)
        planner = make_planner(self.config.planner)
        with (
            method_renderer(method, self.path, self.log, mounts) as renderer,
            FrameProgress(self.console, self.possible_steps[motion]) as progress,
        ):
            make_rollout(setup, planner, renderer, target, progress)

    def _score(self) -> None:
        metrics, failures = [], []
        for motion in self.config.motions:
            for method in self.config.methods:
                result = read_rollout(self.path / ROLLOUTS_FOLDER / motion / method)
                if isinstance(result, RolloutFailure):
                    failures.append(result)
                else:
                    metrics.append(rollout_metrics(result, self.map))
        evaluation = self.path / EVALUATION_FOLDER / "eval.json"
        views = self.path / TRUTH_FOLDER / "oracle_views.json"
        storage.write_json(
            self.path / METRICS_FILE,
            {
                "version": 1,
                "table": [row.to_json() for row in table(metrics, failures)],
                "rollouts": [m.to_json() for m in metrics],
                "failures": [vars(f) for f in failures],
                "scene": storage.read_json(evaluation) if evaluation.exists() else None,
                "truth": storage.read_json(views) if views.exists() else None,
                "actor": load_actor(self.path / ACTOR_FOLDER).provenance.model_dump(mode="json"),
            },
        )

    def _report(self) -> None:
        with self.console.status("writing the report"):
            report_run(self.path)

    def _announce(self) -> None:
        """Say before the long steps how far each rollout can go.

        Raises:
            InputError: none of them can be run at all.
        """
        refusals = []
        for motion in self.config.motions:
            try:
                prepared = prepare(self._setup(motion, self.config.methods[0]))
            except InputError as error:  # becomes a row of the report
                refusals.append(error)
                self.possible_steps[motion] = 0
                self.console.print(f"{motion}: refused: {error}", markup=False, style="yellow")
                continue
            self.possible_steps[motion] = prepared.steps
            reason = f" ({prepared.cut_reason})" if prepared.cut_reason else ""
            self.console.print(
                f"{motion}: up to {prepared.steps} of {self.config.steps} steps{reason}",
                markup=False,
            )
        if len(refusals) == len(self.config.motions):
            raise refusals[0]

    def _conclude(self) -> Path:
        metrics = storage.read_json(self.path / METRICS_FILE)
        self.console.print(results_table(metrics["table"]))
        for failed in metrics["failures"]:
            self.console.print(f"{failed['name']}: {failed['reason']}", markup=False, style="red")
        page = self.path / REPORT_FOLDER / "index.html"
        self.console.print(f"report: {page}", markup=False)
        return page
