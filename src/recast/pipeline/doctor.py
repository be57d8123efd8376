"""What this machine has, what is missing, and how to get it."""

from __future__ import annotations

import os
import platform
import shutil
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import torch
from rich.markup import escape
from rich.table import Table

from recast import __version__
from recast.actors import GENERATORS
from recast.logs.importers import IMPORTERS
from recast.planning import PLANNERS
from recast.splats import native

_OPTIONAL = {
    "embreex": ("synthetic worlds, the demo", "pip install 'recast-sim[synthetic]'"),
    "mitsuba": ("better light in synthetic worlds", "pip install 'recast-sim[mitsuba]'"),
    "gsplat": ("rasterize on CUDA", "pip install 'recast-sim[cuda]'"),
    "ray": ("batches on several machines", "pip install 'recast-sim[distributed]'"),
    "accelerate": ("training on several GPUs", "pip install 'recast-sim[distributed]'"),
}
_SEAMS = (IMPORTERS, PLANNERS, GENERATORS)


@dataclass(frozen=True)
class Finding:
    """One line of the examination.

    Attributes:
        part: what was looked at.
        present: whether it is there; None for plain information.
        detail: version or state.
        mend: how to get it, empty where nothing is missing.
    """

    part: str
    present: bool | None
    detail: str
    mend: str = ""


def examine() -> list[Finding]:
    """Look at everything recast can use."""
    return [*_platform(), _kernel(), *_cuda(), *_optional(), *_seams()]


def findings_table(findings: list[Finding]) -> Table:
    """The examination as a table for the console."""
    table = Table(title=f"recast {__version__}", title_justify="left")
    for heading in ("part", "", "found", "to get it"):
        table.add_column(heading, overflow="fold")
    marks = {True: "[green]yes[/green]", False: "[yellow]no[/yellow]", None: ""}
    for finding in findings:
        table.add_row(
            finding.part, marks[finding.present], escape(finding.detail), escape(finding.mend)
        )
    return table


def _platform() -> list[Finding]:
    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "numpy", "nvidia-ncore"))
    return [
        Finding("python", None, f"{platform.python_version()} on {platform.platform()}"),
        Finding("packages", None, packages),
        Finding("cpu", None, f"{platform.machine()}, {os.cpu_count()} cores"),
    ]


def _kernel() -> Finding:
    info = native.info()
    if info.available:
        detail = (
            f"{info.isa} (this machine offers {', '.join(info.isas)}), {info.threads} threads, "
            f"{info.library}"
        )
        return Finding("CPU kernel", True, detail)
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    mend = (
        "reinstall: pip install --force-reinstall --no-deps recast-sim"
        if compiler
        else "install a C++17 compiler (g++ or clang++), then reinstall recast-sim"
    )
    return Finding("CPU kernel", False, f"{info.reason}; the slow reference is used", mend)


def _cuda() -> list[Finding]:
    if not torch.cuda.is_available():
        return [Finding("CUDA", False, "torch sees no GPU", "not needed: everything runs on a CPU")]
    name = torch.cuda.get_device_name(0)
    return [Finding("CUDA", True, f"{name}, CUDA {torch.version.cuda}")]


def _optional() -> list[Finding]:
    findings = []
    for package, (purpose, mend) in _OPTIONAL.items():
        try:
            findings.append(Finding(package, True, f"{version(package)} ({purpose})"))
        except PackageNotFoundError:
            findings.append(Finding(package, False, purpose, mend))
    return findings


def _seams() -> list[Finding]:
    return [Finding(f"{seam.kind}s", None, ", ".join(seam.names())) for seam in _SEAMS]
