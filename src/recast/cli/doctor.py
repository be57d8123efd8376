"""`recast doctor`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Doctor:
    """Print versions, the CPU kernel, CUDA, optional parts, and how to get what is missing."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.doctor import examine, findings_table

        Console().print(findings_table(examine()))
