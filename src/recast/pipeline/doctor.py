"""What this machine has, what is missing, and how to get it."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from rich.markup import escape
from rich.table import Table

from recast import __version__, kernel
from recast.cores import usable_cores
from recast.parts import GENERATORS, IMPORTERS, PLANNERS, SEGMENTERS
from recast.weights import PUBLISHED, weights_folder
from recast.weights.place import is_fetched

_OPTIONAL = {
    "embreex": ("synthetic worlds, the demo", "pip install 'recast-sim[synthetic]'"),
    "mitsuba": ("better light in synthetic worlds", "pip install 'recast-sim[mitsuba]'"),
    "gsplat": ("rasterize on CUDA", "pip install 'recast-sim[cuda]'"),
    "ray": ("batches on several machines", "pip install 'recast-sim[distributed]'"),
    "accelerate": ("training on several GPUs", "pip install 'recast-sim[distributed]'"),
}
_SEAMS = (IMPORTERS, PLANNERS, GENERATORS, SEGMENTERS)
_DRIVERS = ("libcuda.so.1", "nvcuda.dll")


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
    return [*_platform(), _kernel(), *_cuda(), *_optional(), *_seams(), _weights()]


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
        Finding("cpu", None, _cores()),
    ]


def _kernel() -> Finding:
    info = kernel.info()
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


def _cores() -> str:
    machine, usable = os.cpu_count(), usable_cores()
    share = "" if usable == machine else f", {usable} of them for this process"
    return f"{platform.machine()}, {machine} cores{share}"


def _cuda() -> list[Finding]:
    mend = "not needed: everything runs on a CPU"
    if not any(_loads(driver) for driver in _DRIVERS):
        return [Finding("CUDA", False, "no NVIDIA driver", mend)]
    import torch  # takes seconds, so not without a driver

    if torch.version.cuda is None:
        found, mend = f"torch {torch.__version__} has no CUDA", "see pytorch.org/get-started"
        return [Finding("CUDA", False, f"a driver, but {found}", mend)]
    if not torch.cuda.is_available():
        return [Finding("CUDA", False, "a driver, but torch sees no GPU", mend)]
    name = torch.cuda.get_device_name(0)
    return [Finding("CUDA", True, f"{name}, CUDA {torch.version.cuda}")]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _optional() -> list[Finding]:
    findings = []
    for package, (purpose, mend) in _OPTIONAL.items():
        try:
            findings.append(Finding(package, True, f"{version(package)} ({purpose})"))
        except PackageNotFoundError:
            findings.append(Finding(package, False, purpose, mend))
    return findings


def _seams() -> list[Finding]:
    return [Finding(f"{seam.kind}s", None, ", ".join(seam.labels())) for seam in _SEAMS]


def _weights() -> Finding:
    here = ", ".join(name for name in PUBLISHED if is_fetched(name)) or "none"
    return Finding("weights", None, f"{here} in {weights_folder()}", "recast weights list")
