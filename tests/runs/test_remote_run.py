"""A run whose log and store lie in object storage, on two machines."""

from __future__ import annotations

from pathlib import Path

import pytest
from upath import UPath

from recast.cli.main import main
from recast.core.artefact import CACHE_VARIABLE


def test_what_one_machine_made_another_only_reads(
    bucket: UPath, tiny_log_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in sorted(tiny_log_folder.rglob("*")):
        if path.is_file():
            (bucket / "log" / path.relative_to(tiny_log_folder).as_posix()).write_bytes(
                path.read_bytes()
            )
    root = str(bucket).rstrip("/")
    command = [
        "run",
        f"{root}/log",
        "--store",
        f"{root}/store",
        "--track",
        "0",
        "--threads",
        "1",
        "--motion",
        "advancing-a",
        "--steps",
        "10",
        "--iterations",
        "4",
        "--scale",
        "0.5",
        "--generator",
        "support.own_parts:Box",
        "--refine",
        "False",
    ]
    for machine in ("a", "b"):
        monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / machine / "cache"))
        assert main([*command, "--out", str(tmp_path / machine / "run")]) == 0
    first, second = (tmp_path / machine / "run" for machine in ("a", "b"))
    for name in ("metrics.json", "run.json"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    records = [
        {path.parent.name: path.read_bytes() for path in (tmp_path / m).rglob("artefact.json")}
        for m in ("a", "b")
    ]
    # Records say how long the making took: the second machine has those of the first.
    assert records[0].items() >= records[1].items() and len(records[1]) >= 5
    assert main(["report", str(second)]) == 0
