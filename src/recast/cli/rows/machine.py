"""What `recast doctor`, `weights` and `store` look at and print."""

from __future__ import annotations

import ctypes
import json
import os
import platform
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.table import Table
from rich.text import Text
from rich.tree import Tree

from recast import __version__, kernel
from recast.cli.docs import docs_folder
from recast.cli.shared import Rows
from recast.core import Artefact, Store, files
from recast.core.artefact import references
from recast.core.errors import InputError, printable
from recast.core.plugins import GENERATORS, IMPORTERS, PLANNERS, SEGMENTERS
from recast.core.workers import usable_cores
from recast.weights import PUBLISHED, Weights, published, weights_folder
from recast.weights.fetch import fetch, is_whole
from recast.weights.table import is_fetched, read_weights_record, verify

_EXTRAS = {
    "synthetic": (("embreex", "trimesh"), "synthetic worlds, recast demo"),
    "search": (("optuna", "scikit-learn"), "recast search"),
    "viewer": (("viser",), "recast view"),
    "env": (("gymnasium",), "reinforcement learning, recast.envs"),
    "bridges": (("recast-bridges",), "other programs' simulators, scores, scenes and files"),
    "alpasim": (("recast-bridges", "grpcio"), "drivers and services of AlpaSim"),
    "py123d": (("recast-bridges", "py123d"), "logs that py123d converted"),
    "s3": (("s3fs",), "logs and stores in object storage"),
    "distributed": (("ray", "accelerate"), "batches on several machines, training on several GPUs"),
    "cuda": (("gsplat",), "training and rendering scenes on a GPU"),
    "mitsuba": (("mitsuba",), "path-traced light in synthetic worlds"),
    "tensorboard": (("tensorboard",), "training curves"),
    "docs": (("mkdocs-material", "mkdocstrings"), "building these pages"),
    "dev": (("pytest", "ruff", "mypy"), "working on recast, make test"),
}
"""Extras of recast-sim: packages that tell whether one is installed, and what it is for."""
_SEAMS = (IMPORTERS, PLANNERS, GENERATORS, SEGMENTERS)
_DRIVERS = ("libcuda.so.1", "nvcuda.dll")


@dataclass(frozen=True)
class MachineFinding:
    """One line of the examination.

    Attributes:
        present: whether it is there; None for plain information.
        detail: version or state.
        mend: how to get it, empty where nothing is missing.
    """

    part: str
    present: bool | None
    detail: str
    mend: str = ""


def examine() -> list[MachineFinding]:
    """Look at everything recast can use."""
    return [*_platform(), _pages(), _kernel(), *_cuda(), *_extras(), *_seams(), _weights()]


def findings_table(findings: list[MachineFinding]) -> Table:
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


def _platform() -> list[MachineFinding]:
    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "numpy", "nvidia-ncore"))
    return [
        MachineFinding("python", None, f"{platform.python_version()} on {platform.platform()}"),
        MachineFinding("packages", None, packages),
        MachineFinding("cpu", None, _cores()),
    ]


def _pages() -> MachineFinding:
    return MachineFinding("docs", None, str(docs_folder() or "missing"))


def _kernel() -> MachineFinding:
    info = kernel.info()
    if info.available:
        detail = (
            f"{info.isa} (this machine offers {', '.join(info.isas)}), {info.threads} threads, "
            f"{info.library}"
        )
        return MachineFinding("CPU kernel", True, detail)
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    mend = (
        "reinstall: pip install --force-reinstall --no-deps recast-sim"
        if compiler
        else "install a C++17 compiler (g++ or clang++), then reinstall recast-sim"
    )
    return MachineFinding("CPU kernel", False, f"{info.reason}; the slow reference is used", mend)


def _cores() -> str:
    machine, usable = os.cpu_count(), usable_cores()
    share = "" if usable == machine else f", {usable} of them for this process"
    return f"{platform.machine()}, {machine} cores{share}"


def _cuda() -> list[MachineFinding]:
    mend = "not needed: everything runs on a CPU"
    if not any(_loads(driver) for driver in _DRIVERS):
        return [MachineFinding("CUDA", False, "no NVIDIA driver", mend)]
    import torch  # takes seconds, so not without a driver

    if torch.version.cuda is None:
        found, mend = f"torch {torch.__version__} has no CUDA", "see pytorch.org/get-started"
        return [MachineFinding("CUDA", False, f"a driver, but {found}", mend)]
    if not torch.cuda.is_available():
        return [MachineFinding("CUDA", False, "a driver, but torch sees no GPU", mend)]
    name = torch.cuda.get_device_name(0)
    return [MachineFinding("CUDA", True, f"{name}, CUDA {torch.version.cuda}")]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _extras() -> list[MachineFinding]:
    findings = []
    for extra, (packages, purpose) in _EXTRAS.items():
        try:
            found = ", ".join(f"{name} {version(name)}" for name in packages)
        except PackageNotFoundError:
            mend = f"pip install 'recast-sim[{extra}]'"
            findings.append(MachineFinding(f"extra {extra}", False, purpose, mend))
        else:
            findings.append(MachineFinding(f"extra {extra}", True, f"{purpose} ({found})"))
    return findings


def _seams() -> list[MachineFinding]:
    return [MachineFinding(f"{seam.kind}s", None, ", ".join(seam.labels())) for seam in _SEAMS]


def _weights() -> MachineFinding:
    here = ", ".join(name for name in PUBLISHED if is_fetched(name)) or "none"
    return MachineFinding("weights", None, f"{here} in {weights_folder()}", "recast weights list")


def finding_rows(findings: Sequence[MachineFinding]) -> Rows:
    """One row for each part of the machine; `present` is null for plain information."""
    return {"parts": [vars(finding) for finding in findings]}


def weights_rows() -> Rows:
    """One row for each entry of the table of published weights."""
    rows = []
    for name, weights in PUBLISHED.items():
        here = is_fetched(name)
        commits = read_weights_record(weights_folder(name)).revisions if here else {}
        rows.append(
            {
                "name": name,
                "use": weights.use,
                "options": weights.options,
                "licences": [licence.name for licence in weights.licences],
                "restricted": weights.restricted,
                "pinned": weights.pinned,
                "download_gb": weights.gigabytes,
                "fetched": here,
                "commits": [f"{where} {commit}" for where, commit in commits.items()],
            }
        )
    return {"weights": rows}


def weights_table() -> Table:
    """All entries of the table, and which of them are here; made to fit 80 columns."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 1, 0))
    for title in ("name, options", "for, licence, commits", "GB"):
        table.add_column(title, overflow="fold", justify="right" if title == "GB" else "left")
    for name, weights in PUBLISHED.items():
        here = is_fetched(name)
        pins = "pinned by recast" if weights.pinned else "pinned on first use"
        licences = "; ".join(one.name for one in weights.licences)
        lines = [weights.use, licences + (" (to accept)" if weights.restricted else ""), pins]
        if here:
            record = read_weights_record(weights_folder(name))
            lines += [f"{where} {commit}" for where, commit in record.revisions.items()]
        first = "\n".join((name, *weights.options, "here" if here else "not downloaded"))
        table.add_row(escape(first), escape("\n".join(lines)), f"{weights.gigabytes:.3g}")
    return table


def get_weights(name: str, accepted: bool, console: Console) -> None:
    """Show the licences, ask for consent where it is needed, and fetch; InputError: see `fetch`.

    Args:
        accepted: consent from the command line; else a terminal is asked.
    """
    weights = published(name)
    folder = weights_folder(name)
    if is_whole(weights, folder):
        path = fetch(weights)
        console.print(f"{name} is here: {path}", markup=False, soft_wrap=True)
        return
    for source in weights.sources:
        console.print(
            f"{source.where}: {source.licence.name}, {source.licence.link}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    if weights.restricted and not accepted and sys.stdin.isatty():
        accepted = console.input("accept these terms? [y/N] ", markup=False).strip().lower() == "y"
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        tasks: dict[str, int] = {}

        def progress(file: str, came: int, of: int | None) -> None:
            if file not in tasks:
                tasks[file] = bars.add_task(file, total=of)
            bars.update(tasks[file], completed=came, visible=came != of)  # type: ignore[arg-type]

        path = fetch(weights, accepted=accepted, progress=progress)
    console.print(_told(weights, f"downloaded to {path}"), markup=False, soft_wrap=True)


def verify_weights(name: str | None, console: Console) -> None:
    """Read every byte of downloaded weights.

    Args:
        name: of an entry; None for all that are here.

    Raises:
        InputError: no such entry, not here, or the first file at fault; the others are checked too.
    """
    names = [name] if name else [one for one in PUBLISHED if is_fetched(one)]
    faults: list[InputError] = []
    for one in names:
        weights, folder = published(one), weights_folder(one)
        try:
            if not is_fetched(one):
                get = f"run `recast weights get {one}`"
                raise InputError("weights", one, "are not downloaded", get)
            verify(folder, read_weights_record(folder))
            told = _told(weights, "as downloaded")
        except InputError as error:
            faults.append(error)
            told = f"{one}: {error}"
        console.print(told, markup=False, highlight=False, soft_wrap=True)
    if faults:
        raise faults[0]
    if not names:
        console.print(f"no weights in {weights_folder()}", markup=False, soft_wrap=True)


def _told(weights: Weights, what: str) -> str:
    record = read_weights_record(weights_folder(weights.name))
    return f"{weights.name}: {len(record.files)} files, {record.size / 1e9:.2f} GB, {what}"


_STORE_PAGE = "docs/runs.md#the-store"
_DIGITS = 10
"""Digits of a key, as lists show it."""


def list_store(store: Store, console: Console) -> None:
    """Print a line for each artefact; InputError: there is no store, or one of another version."""
    users = store.users()
    table = Table(box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    for heading in ("kind", "key", "what"):
        table.add_column(heading, no_wrap=heading != "what")
    for heading in ("MB", "s", "runs"):
        table.add_column(heading, justify="right", no_wrap=True)
    total = 0
    for one in store.artefacts():
        used = sum(one.reference in names for names in users.values())
        total += one.size
        table.add_row(
            one.record.kind,
            one.record.key[:_DIGITS],
            Text(printable(one.record.name)),
            f"{one.size / 1e6:.1f}",
            f"{one.record.seconds:.0f}",
            str(used),
        )
    console.print(table)
    console.print(
        f"artefacts: {table.row_count}, {total / 1e6:.1f} MB; run folders: {len(users)}",
        highlight=False,
    )


def explain_artefact(place: str, key: str, console: Console) -> None:
    """Print the inputs of an artefact as a tree, with those of the artefacts among them.

    Raises:
        InputError: no artefact, or several, have this key.
    """
    store = opened_store(place)
    found = [one for one in store.artefacts() if key and one.record.key.startswith(key)]
    if len(found) != 1:
        problem = f"{len(found)} artefacts have this key" if found else "no artefact has this key"
        mend = "give a whole key, see recast store list"
        raise InputError(place, f"key {key}", problem, mend, _STORE_PAGE)
    console.print(_tree(store, found[0]))


def prune_store(place: str, remove: bool, older_than_h: float, console: Console) -> None:
    """Print what nobody needs, and remove it if that is wanted.

    Args:
        older_than_h: hours since an artefact was made; younger ones are left.

    Raises:
        InputError: there is no store, or the disk refuses.
    """
    store = opened_store(place)
    unused, leftovers = store.unused(3600.0 * older_than_h), store.leftovers()
    for one in unused:
        line = f"{one.record.kind} {one.record.key[:_DIGITS]} {one.record.name}"
        console.print(printable(line), markup=False, highlight=False)
        if remove:
            store.remove(one)
    for folder in leftovers:
        console.print(f"left behind: {folder.name}", markup=False, highlight=False)
        if remove:
            with files.disk_errors(folder):
                shutil.rmtree(folder)
    size = sum(one.size for one in unused) / 1e6
    verb = "removed" if remove else "can be removed with --yes"
    console.print(
        f"{len(unused)} artefacts ({size:.1f} MB) and {len(leftovers)} leftovers {verb}",
        highlight=False,
    )


def store_rows(store: Store) -> Rows:
    """One row for each artefact of a local store."""
    users = store.users().values()
    return {
        "artefacts": [
            {
                "kind": one.record.kind,
                "key": one.record.key,
                "name": one.record.name,
                "size_bytes": one.size,
                "making_s": one.record.seconds,
                "runs": sum(one.reference in names for names in users),
            }
            for one in store.artefacts()
        ]
    }


def opened_store(place: str) -> Store:
    """A local store that is there.

    Raises:
        InputError: it is elsewhere, or is none.
    """
    if "://" in place or not (Path(place) / "store.json").is_file():
        mend = "name the folder of a store"
        raise InputError(place, "store", "is not a local store", mend, _STORE_PAGE)
    return Store(place)


def _tree(store: Store, artefact: Artefact) -> Tree:
    record = artefact.record
    title = f"{record.kind} {record.key[:_DIGITS]}  {record.name}  ({record.seconds:.0f} s)"
    tree = Tree(Text(printable(title), style="bold"))
    for name, value in record.inputs.items():
        if next(references(value), None) is None:
            tree.add(Text(printable(f"{name}: {_short(value)}")))
            continue
        branch = tree.add(Text(printable(name)))
        for reference in references(value):
            try:
                inner = store.open(reference)
            except InputError as error:
                branch.add(Text(printable(f"{reference}: {error.problem}")))
                continue
            branch.add(_tree(store, inner))
    return tree


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 100 else f"{text[:99]}…"
