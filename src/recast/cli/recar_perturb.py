"""`recast recar perturb`: what driving logs do to pictures of vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Perturb:
    """Draw a sheet of all perturbations of Stage II, from weak to strong, on one picture."""

    crop: tyro.conf.Positional[Path]
    """Picture of one cut-out vehicle, PNG with alpha."""
    out: Path
    """Sheet to write, PNG."""
    config: Path | None = None
    """Perturbations as JSON; what it leaves out, or all without it, is as in the defaults."""
    write_config: Path | None = None
    """Write the configuration with every figure to this JSON file, to edit it."""
    seed: int = 0
    """Seed of everything random."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar.perturb import (
            PerturbationConfig,
            read_perturbations,
            write_perturbations,
        )
        from recast.recar.perturb.sheet import write_sheet
        from recast.trellis import read_crop

        config = PerturbationConfig() if self.config is None else read_perturbations(self.config)
        crop = read_crop(self.crop)
        console = Console()
        write_sheet(crop, config, self.seed, self.out)
        console.print(f"wrote {self.out}", markup=False)
        if self.write_config is not None:
            write_perturbations(self.write_config, config)
            console.print(f"wrote {self.write_config}", markup=False)
