"""One function for each arrow of the way of the data: finds its artefact in the store, or makes it.

`recast run`, grids and the library's face all use them, and so share what any of them made.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from recast.actors import load_actor
from recast.core import Artefact, Store, file_hash, folder_hash
from recast.core.errors import printable
from recast.logs.types import PEOPLE
from recast.reconstruction import train_scene
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.evaluate import evaluate_scene
from recast.reconstruction.train import CONFIG_FILE, FREE_FIELDS, read_training_config
from recast.runs.actor import (
    ActorMakers,
    compare_with_truth,
    film_turntable,
    make_actor,
    refine_actor,
)
from recast.runs.display import SamplingProgress, TrainingDisplay, evaluation_table, print_actor
from recast.runs.run_folder import ACTOR_FOLDER, LOG_FOLDER, TURNTABLE_FILE
from recast.runs.sources import RECIPES, SourceLog, drive_log
from recast.scene import load_scene
from recast.synthetic import World, world_metadata


@dataclass(frozen=True)
class Maker:
    """A store, and a console that shows what is made there."""

    store: Store
    console: Console
    elsewhere: dict[str, str] = field(default_factory=dict)
    """What another process said while it made an artefact, by reference; told when it is used."""

    def make(
        self,
        title: str,
        kind: str,
        inputs: Mapping[str, Any],
        make: Callable[[Path], object],
        name: str,
        resumes: bool = False,
    ) -> Artefact:
        """See `Store.make`; the console calls it `title`, lists of the store `name`."""

        def announced(out: Path) -> None:
            self._say(f"[bold]{escape(title)}[/bold]")
            make(out)

        found = self.store.make(
            kind,
            inputs,
            announced,
            name=name,
            resumes=resumes,
            waits=lambda: self._say(f"{escape(title)}: another process is making it"),
        )
        told = self.elsewhere.pop(found.reference, "")
        if told:
            self.console.print(told, markup=False, highlight=False, end="")
        elif not found.fresh:
            self._say(f"{escape(title)}: found in the store")
        return found

    def _say(self, text: str) -> None:
        self.console.print(printable(text), highlight=False)


def drive_world(
    maker: Maker,
    world: World,
    image_size: tuple[int, int],
    cameras: tuple[str, ...],
    name: str,
    every: int = 1,
) -> Artefact:
    """The log of a synthetic world.

    Args:
        image_size: width and height of its images, pixels.
        cameras: names of the cameras that are recorded; none named: all of the rig.
        every: see `synthesize_log`.
    """
    metadata = world_metadata(world)
    inputs = {
        "world": metadata,
        "image_size": list(image_size),
        "cameras": list(cameras),
        "recipe": RECIPES["log"],
        **({} if every == 1 else {"every": every}),
    }
    quiet = Console(quiet=True)
    return maker.make(
        f"log {name}",
        "logs",
        inputs,
        lambda out: drive_log(
            lambda: world, metadata, out / LOG_FOLDER, image_size, cameras, 1, quiet, every
        ),
        name,
    )


def train_street(maker: Maker, source: SourceLog, config: SceneConfig, name: str) -> Artefact:
    """A street, trained on a log."""
    inputs = {
        "log": source.hash,
        "config": config.model_dump(mode="json", exclude=set(FREE_FIELDS)),
        "recipe": RECIPES["scene"],
    }
    inputs |= _body_files(config)  # a missing one ends the training

    def train(out: Path) -> None:
        with TrainingDisplay(maker.console) as display:
            result = train_scene(source.log, out, config, progress=display)
        maker.console.print(result.budget.explain(), markup=False)

    return maker.make(
        f"street {name}",
        "scenes",
        inputs,
        train,
        f"{name} street of {source.log.name}",
        resumes=True,
    )


def _body_files(config: SceneConfig) -> dict[str, Any]:
    """The files of bodies that a street names, as inputs; none if it names none."""
    paths = [Path(path) for path in (config.smpl_model, config.smpl_poses) if path]
    hashes = [file_hash(path) for path in paths if path.is_file()]
    return {"bodies": hashes} if paths else {}


def take_street(maker: Maker, folder: Path) -> Artefact:
    """A street that was trained or imported elsewhere."""
    return maker.make(
        f"street {folder.name}",
        "scenes",
        {"content": folder_hash(folder)},
        lambda out: copy_folder(folder, out),
        f"scene {folder.name}",
    )


def score_street(maker: Maker, source: SourceLog, scene: Artefact, config: SceneConfig) -> Artefact:
    """Held-out scores of a street.

    Raises:
        InputError: no image was held out.
    """
    inputs = {"scene": scene.reference, **_images(source, config), "recipe": RECIPES["evaluation"]}

    def evaluate(out: Path) -> None:
        found = evaluate_scene(load_scene(scene.path), source.log, config, out)
        maker.console.print(evaluation_table(found))

    return maker.make(
        f"held-out images of {scene.record.name}",
        "evaluations",
        inputs,
        evaluate,
        f"held-out images of {scene.record.name}",
    )


@dataclass(frozen=True)
class VehicleParts:
    """What makes a vehicle.

    Attributes:
        generator, segmenter: what stands for them, see `recast.runs.sources`.
        makers: function that gives the generator and the segmenter themselves.
    """

    name: str
    generator: str
    segmenter: str
    axes: str
    views: int
    makers: Callable[[], ActorMakers]


def register_vehicle(
    maker: Maker, source: SourceLog, track: str, parts: VehicleParts, seed: int, config: SceneConfig
) -> Artefact:
    """A generated vehicle, registered to the log's boxes and LiDAR, with its evidence.

    Args:
        config: settings of the street's scene: which images may be looked at.
    """
    inputs = {
        **_images(source, config),
        "track": track,
        "generator": parts.generator,
        "axes": parts.axes,
        "segmenter": parts.segmenter,
        "views": parts.views,
        "seed": seed,
        "recipe": RECIPES["actor"],
    }

    def make(out: Path) -> None:
        with SamplingProgress(maker.console) as progress:
            actor = make_actor(
                source.log, track, parts.makers(), seed, out, config, parts.views, progress
            )
        print_actor(actor, maker.console)

    kind = "person" if source.log.tracks[track].category in PEOPLE else "vehicle"
    title = f"{kind} of track {track} by {parts.name}"
    return maker.make(title, "actors", inputs, make, f"{title}, {source.log.name}")


def refine_vehicle(maker: Maker, registered: Artefact, scene: Artefact, seed: int) -> Artefact:
    """A registered vehicle, refined by all images of the log against a street."""
    trained = (scene.path / CONFIG_FILE).is_file()
    inputs = {
        "actor": registered.reference,
        "scene": scene.reference,
        "seed": seed,
        "recipe": RECIPES["refine"],
        **(_body_files(read_training_config(scene.path)) if trained else {}),
    }

    def make(out: Path) -> None:
        with SamplingProgress(maker.console) as progress:
            refined = refine_actor(registered.path, load_scene(scene.path), seed, out, progress)
        report = refined.provenance.refinement
        assert report is not None
        style = None if report.kept else "yellow"
        maker.console.print(report.explain(), markup=False, highlight=False, style=style)

    name = f"refined {registered.record.name}"
    return maker.make(name, "actors", inputs, make, name, resumes=True)


def film_vehicle(maker: Maker, actor: Artefact) -> Artefact:
    """A film of a vehicle turning once."""
    name = f"turntable of {actor.record.name}"
    return maker.make(
        name,
        "evaluations",
        {"actor": actor.reference, "recipe": RECIPES["turntable"]},
        lambda out: film_turntable(load_actor(actor.path / ACTOR_FOLDER), out / TURNTABLE_FILE),
        name,
    )


def compare_vehicle(
    maker: Maker,
    source: SourceLog,
    actor: Artefact,
    scene: Artefact,
    config: SceneConfig,
    seed: int,
) -> Artefact:
    """A vehicle, and its street's own, against the truth of a synthetic log."""
    inputs = {
        **_images(source, config),
        "scene": scene.reference,
        "actor": actor.reference,
        "seed": seed,
        "recipe": RECIPES["truth"],
    }
    name = f"{actor.record.name} against the truth"
    return maker.make(
        name,
        "evaluations",
        inputs,
        lambda out: compare_with_truth(
            load_scene(scene.path),
            load_actor(actor.path / ACTOR_FOLDER),
            source,
            config,
            seed,
            out,
            maker.console,
        ),
        name,
    )


def copy_folder(folder: Path, out: Path) -> None:
    """A folder's files, as hard links where the file system has them."""

    def link(source: str, target: str) -> None:
        try:
            os.link(source, target)
        except OSError:
            shutil.copy2(source, target)

    shutil.copytree(folder, out, copy_function=link, dirs_exist_ok=True)


def _images(source: SourceLog, config: SceneConfig) -> dict[str, Any]:
    """Which images of the log are looked at, for keys."""
    return {
        "log": source.hash,
        "cameras": list(config.cameras),
        "scale": config.scale,
        "holdout": [config.holdout_every, config.holdout_offset],
    }
