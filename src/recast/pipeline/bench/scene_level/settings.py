"""What a scene-level evaluation is asked to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

from recast.core.hashing import file_hash, folder_hash
from recast.errors import InputError
from recast.evaluation.scene_level.frames import FrameRule
from recast.pipeline.bench.settings import BenchSettings
from recast.pipeline.sources import vqa_source

LEVEL_FORMAT, LEVEL_VERSION = "recast-scene-level", 1
DRIVER = "pdm-closed"
"""Planner that drives each trajectory once, for all arms (paper, section 5, Q2)."""
LEVEL_MOTIONS = ("cut-in", "oncoming", "stationary", "advancing")
"""The paper's four, with both settings each."""

_FILES = ("inception", "clip", "lpips")
"""Networks that are named by a path."""


@dataclass(frozen=True)
class NetworkFiles:
    """Weights of the networks; a score whose network is not given has no column.

    Attributes:
        inception: weights file, see `load_inception`.
        clip: folder of a CLIP model.
        lpips: ImageNet weights of AlexNet or VGG-16, see `load_lpips`.
        vqa: what `load_vqa_scorer` takes as text.
        device: where the networks compute: cpu, cuda or cuda:1.
    """

    inception: Path | None = None
    clip: Path | None = None
    lpips: Path | None = None
    vqa: str | None = None
    device: str = "cpu"

    def hashes(self) -> dict[str, str]:
        """What stands for each network that is given, in keys and results.

        Raises:
            InputError: a file is missing, or the VQA scorer is unknown.
        """
        found = {}
        for name in _FILES:
            path = getattr(self, name)
            if path is not None and not path.exists():
                raise InputError(path, name, "is missing", "name a file or folder that is there")
            if path is not None:
                found[name] = folder_hash(path) if path.is_dir() else file_hash(path)
        if self.vqa is not None:
            found["vqa"] = vqa_source(self.vqa)
        return found


@dataclass(frozen=True)
class LevelSettings:
    """A scene-level evaluation.

    Attributes:
        grid: scenes, motions and arms (the first is the baseline); its one planner is `DRIVER`.
        rule: when an image counts.
        crop: "boxed" keeps the background around the vehicle, "masked" takes away what lies outside
            of the box's outline.
        most_references: logged crops of a scene that LPIPS and the CLIP image score compare with.
        networks: weights.
        hashes: hashes of the networks' files by name.
        frechet_samples: bootstrap samples of Frechet distances; the other scores' are the grid's.
    """

    grid: BenchSettings
    rule: FrameRule
    crop: Literal["boxed", "masked"]
    most_references: int
    networks: NetworkFiles
    hashes: Mapping[str, str]
    frechet_samples: int

    def __post_init__(self) -> None:
        run = self.grid.run.model_copy(update={"planners": (DRIVER,), "films": False})
        object.__setattr__(self, "grid", replace(self.grid, run=run))

    def absolute(self) -> Self:
        """The same with absolute paths of logs and weights, see `BenchSettings.absolute`."""
        files = {
            name: path.absolute()
            for name in _FILES
            if (path := getattr(self.networks, name)) is not None
        }
        return replace(self, grid=self.grid.absolute(), networks=replace(self.networks, **files))

    def validate(self) -> None:
        """Raise InputError naming the option at fault."""
        self.rule.validate()
        for option, value in (
            ("--references", self.most_references), ("--frechet-samples", self.frechet_samples)
        ):  # fmt: skip
            if value < 1:
                raise InputError(option, "value", f"is {value}", "give 1 or more")

    def record(self) -> dict[str, Any]:
        """What makes this evaluation another than others: plain data."""
        return {
            **self.grid.record(),
            "format": LEVEL_FORMAT,
            "version": LEVEL_VERSION,
            "rule": asdict(self.rule),
            "crop": self.crop,
            "most_references": self.most_references,
            "networks": dict(self.hashes),
            "frechet_samples": self.frechet_samples,
        }
