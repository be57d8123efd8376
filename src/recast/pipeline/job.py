"""The steps of one run, each after those it needs."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from recast import storage
from recast.errors import InputError, printable
from recast.logs import DrivingLog, HdMap, map_of
from recast.pipeline.actor import ActorMakers, film_turntable, make_actor, refine_actor
from recast.pipeline.config import RunConfig
from recast.pipeline.display import FrameProgress, SamplingProgress, print_actor, results_table
from recast.pipeline.layout import (
    ACTOR_FOLDER,
    EVALUATION_FOLDER,
    METRICS_FILE,
    OBSERVATION_FOLDER,
    REFINED_FOLDER,
    REPORT_FOLDER,
    SCENE_FOLDER,
    TRUTH_FOLDER,
    TURNTABLE_FILE,
    Method,
    rollout_folder,
)
from recast.pipeline.methods import Renderers
from recast.pipeline.report import report_run
from recast.pipeline.results_files import read_metrics
from recast.pipeline.rollouts import make_rollout
from recast.pipeline.run_folder import RunFolder
from recast.pipeline.scene import train_with_display
from recast.pipeline.scene_tables import evaluation_table
from recast.pipeline.scores import write_metrics
from recast.pipeline.sources import RECIPES, Sources
from recast.pipeline.truth import compare_with_truth
from recast.planning import Planner
from recast.scene import evaluate_scene, load_scene
from recast.simulation import RolloutSetup, Timings, prepare
from recast.synthetic import World


class Job:
    """The steps of one run, each after those it needs.

    Args:
        sources: see `Sources.of`; taken before the planner was loaded.
        planner: of all rollouts, as loading one may take long.
        makers: of the actor, where they are loaded already; let go of when it is made.
    """

    def __init__(
        self,
        log: DrivingLog,
        world: World | None,
        folder: RunFolder,
        config: RunConfig,
        sources: Sources,
        planner: Planner,
        renderers: Renderers,
        console: Console,
        makers: ActorMakers | None = None,
    ) -> None:
        self._makers, self._sources, self.planner = makers, sources, planner
        self.log, self.world, self.folder = log, world, folder
        self.config, self.renderers, self.console = config, renderers, console
        self.path = folder.path
        self.map: HdMap = map_of(log)
        self.possible_steps: dict[str, int] = {}
        self.done = 0
        self.total = (
            5
            + config.refine
            + len(config.motions) * len(config.methods)
            + ("oracle" in config.methods)
        )

    def finish(self) -> Path:
        """Make what is not finished yet; return the report's page."""
        self._announce()
        actor = self.make_actor()
        scene = self.make_scene()
        actor = self.refine_actor(scene, actor)
        evaluation = self.evaluate(scene)
        truth = None
        if "oracle" in self.config.methods:
            truth = self._step(
                "truth", {"scene": scene, "actor": actor, "seed": self.config.seed},
                self._compare_with_truth, (TRUTH_FOLDER,),
            )  # fmt: skip
        rollouts = {
            f"{motion}/{method}": self.make_rollout(motion, method, scene, actor)
            for motion in self.config.motions
            for method in self.config.methods
        }
        metrics = self.score(rollouts, evaluation, actor, truth)
        self._step("report", {"metrics": metrics}, self._report, (REPORT_FOLDER,))
        return self._conclude()

    def make_actor(self) -> str:
        """The actor's folder; this and each of the next returns the hash of what it stands for."""
        return self._step(
            "actor", self._actor_inputs(), self._make_actor,
            (OBSERVATION_FOLDER, ACTOR_FOLDER, *(() if self.config.refine else (TURNTABLE_FILE,))),
        )  # fmt: skip

    def make_scene(self) -> str:
        """The trained scene."""
        return self._step(
            "scene", {"log": self._log_hash, "config": self.config.scene.resolved()},
            self._train, (SCENE_FOLDER,), keep_partial=True,
        )  # fmt: skip

    def refine_actor(self, scene: str, actor: str) -> str:
        """The actor that rollouts insert: refined against the scene, if that is wanted."""
        if not self.config.refine:
            return actor
        return self._step(
            "refine", {"scene": scene, "actor": actor, "seed": self.config.seed}, self._refine,
            (REFINED_FOLDER, TURNTABLE_FILE), keep_partial=True,
        )  # fmt: skip

    def evaluate(self, scene: str) -> str:
        """Held-out scores of the scene."""
        return self._step("evaluation", {"scene": scene}, self._evaluate, (EVALUATION_FOLDER,))

    def score(
        self,
        rollouts: Mapping[str, str],
        evaluation: str | None,
        actor: str | None,
        truth: str | None = None,
    ) -> str:
        """metrics.json, of the rollouts with these hashes and of the other steps that were made."""
        return self._step(
            "metrics",
            {"rollouts": rollouts, "evaluation": evaluation, "actor": actor, "truth": truth},
            self._score, (METRICS_FILE,),
        )  # fmt: skip

    @property
    def _log_hash(self) -> str:
        return self.folder.record.log.hash

    def _step(
        self,
        name: str,
        inputs: Mapping[str, Any],
        make: Callable[[], None],
        outputs: tuple[str, ...],
        keep_partial: bool = False,
        recipe: str | None = None,
    ) -> str:
        self.done += 1
        self.console.print(f"[bold]\\[{self.done}/{self.total}] {name}[/bold]")
        inputs = {**inputs, "recipe": RECIPES[recipe or name]}
        fingerprint, made = self.folder.step(name, inputs, make, outputs, keep_partial)
        if not made:
            self.console.print("  finished before")
        return fingerprint

    def _actor_inputs(self) -> dict[str, Any]:
        return {
            "log": self._log_hash,
            "track": self.config.track,
            "generator": self._sources.generator,
            "axes": self.config.axes,
            "segmenter": self._sources.segmenter,
            "seed": self.config.seed,
            "scale": self.config.scene.scale,
            "cameras": list(self.config.scene.cameras),
            "holdout": [self.config.scene.holdout_every, self.config.scene.holdout_offset],
            **({"views": self.config.views} if self.config.views != 1 else {}),
        }

    def _make_actor(self) -> None:
        config = self.config
        makers, self._makers = self._makers, None
        if makers is None:
            makers = ActorMakers.named(config.generator, config.segmenter, config.axes)
        with SamplingProgress(self.console) as progress:
            actor = make_actor(
                self.log, config.track, makers, config.seed, self.path, config.scene,
                config.views, progress,
            )  # fmt: skip
        if not self.config.refine:
            film_turntable(actor, self.path / TURNTABLE_FILE)
        print_actor(actor, self.console)

    def _refine(self) -> None:
        path = self.path / REFINED_FOLDER
        if path.exists():  # a kill between the folder and the marker of the step
            shutil.rmtree(path)
        with SamplingProgress(self.console) as progress:
            refined = refine_actor(
                self.path, load_scene(self.path / SCENE_FOLDER), self.config.seed, progress
            )
        film_turntable(refined, self.path / TURNTABLE_FILE)
        report = refined.provenance.refinement
        assert report is not None
        style = None if report.kept else "yellow"
        self.console.print(report.explain(), markup=False, highlight=False, style=style)

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
        assert self.world is not None  # the step is there for the oracle only
        compare_with_truth(self.path, self.log, self.world, self.config, self.console)

    @property
    def _cameras(self) -> tuple[str, ...]:
        return self.config.scene.cameras or tuple(self.log.cameras)

    def make_rollout(
        self,
        motion: str,
        method: Method,
        scene: str | None,
        actor: str | None,
        timings: Timings | None = None,
    ) -> str:
        """One rollout's folder.

        Args:
            scene, actor: hashes of these steps; None where nothing renders them.
            timings: is added to, if the rollout is made now.
        """
        config = self.config
        inputs: dict[str, Any] = {
            "log": self._log_hash,
            "track": config.track,
            "motion": motion,
            "method": method,
            "planner": self._sources.planner,
            "steps": config.steps,
            "plan_every": config.plan_every,
            "keep_other_actors": config.keep_other_actors,
        }
        if not config.films:
            inputs["films"] = False
        if config.planner_device != "auto":
            inputs["planner_device"] = config.planner_device
        if config.plan_limit_s is not None:
            inputs["plan_limit_s"] = config.plan_limit_s
        if motion in config.own_motions:
            inputs["scenario"] = config.own_motions[motion]
        if method == "oracle":
            inputs |= {"cameras": list(config.scene.cameras), "scale": config.scene.scale}
        else:
            inputs["scene"] = scene
        if method == "replaced":
            inputs["actor"] = actor
        target = rollout_folder(self.path, motion, method)
        return self._step(
            f"rollout-{motion}-{method}", inputs,
            lambda: self._make_rollout(motion, method, target, timings),
            (target.relative_to(self.path).as_posix(),), recipe="rollout",
        )  # fmt: skip

    def _setup(self, motion: str, method: str) -> RolloutSetup:
        config = self.config
        return RolloutSetup(
            log=self.log,
            track_id=config.track,
            motion=config.motion(motion),
            method=method,
            map=self.map,
            steps=config.steps,
            plan_every=config.plan_every,
            keep_other_actors=config.keep_other_actors,
            plan_limit_s=config.plan_limit_s,
            camera_names=self._cameras,
        )

    def _make_rollout(
        self, motion: str, method: Method, target: Path, timings: Timings | None
    ) -> None:
        setup = self._setup(motion, method)
        looked_at = self.config.films or self.planner.needs_images
        renderer = self.renderers.of(method) if looked_at else None
        meter = self.renderers.meter_of(method) if looked_at else None
        steps = self.possible_steps.get(motion, self.config.steps)
        with FrameProgress(self.console, steps) as progress:
            make_rollout(
                setup, self.planner, renderer, target, progress, self.config.films, timings, meter
            )  # fmt: skip

    def _score(self) -> None:
        write_metrics(self.path, self.config, self.map)

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
        metrics = read_metrics(self.path / METRICS_FILE)
        self.console.print(results_table(metrics["table"]))
        for failed in metrics["failures"]:
            reason = printable(f"{failed['name']}: {failed['reason']}")
            self.console.print(reason, markup=False, style="red")
        page = self.path / REPORT_FOLDER / "index.html"
        self.console.print(f"report: {page}", markup=False)
        return page
