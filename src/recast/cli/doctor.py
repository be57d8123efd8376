"""`recast doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class Doctor:
    """Print versions, the CPU kernel, CUDA and optional parts, and how to install missing ones."""

    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        """Run the command."""
        from recast.pipeline.doctor import examine, findings_table

        findings = examine()
        if self.json:
            from recast.cli.rows.machine import finding_rows

            print_json(finding_rows(findings))
            return
        console_for(False).print(findings_table(findings))
