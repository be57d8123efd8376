"""`recast recar perturb`: what driving logs do to pictures of vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import console_for


@dataclass(frozen=True)
class Perturb:
    """Draw all perturbations of Stage II on one picture, from weak to strong."""

    crop: tyro.conf.Positional[Path]
    """Picture of one cut-out vehicle, PNG with alpha."""
    out: Path
    """Picture to write (PNG)."""
    config: Annotated[
        Path | None,
        shared.option("JSON file with changes to the perturbations.", "none", metavar="PATH"),
    ] = None
    write_config: Annotated[
        Path | None,
        shared.option("JSON file to write the whole configuration to.", metavar="PATH"),
    ] = None
    seed: Annotated[int, shared.SEED] = 0

    def __call__(self) -> None:
        """Run the command."""
        from recast.recar.perturb import (
            PerturbationConfig,
            read_perturbations,
            write_perturbations,
        )
        from recast.recar.perturb.sheet import write_sheet
        from recast.trellis import read_crop

        config = PerturbationConfig() if self.config is None else read_perturbations(self.config)
        crop = read_crop(self.crop)
        console = console_for(False)
        write_sheet(crop, config, self.seed, self.out)
        console.print(f"wrote {self.out}", markup=False)
        if self.write_config is not None:
            write_perturbations(self.write_config, config)
            console.print(f"wrote {self.write_config}", markup=False)
