"""Paths with umlauts in the locales of old systems, where names are not UTF-8."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.tiny_drive import DRIVE, TinyDrive

FOLDER = "Fährten".encode("latin-1")
COMMANDS = f"""
import sys
from pathlib import Path
import numpy as np
import pyarrow as pa
import torch
from safetensors.torch import save_file
from recast.cli.main import main
from recast.core.errors import InputError
from recast.core.files import write_text
from recast.core.torch_file import read_header, read_safetensors
from recast.reporting.video import read_video, write_video
from recast.core.table_files import check_batches, read_parquet, write_parquet

drive, out = sys.argv[1:]
words = "import", "kitti", drive, "--drive", "{DRIVE}", "--labels", drive + "/labels.txt"
words = (*words, "--no-refine")
assert main(["log", *words, "--out", out + "/log"]) == 0
assert main(["log", "info", out + "/log"]) == 0
assert main(["log", "info", out + "/none"]) == 2

folder, table = Path(out), pa.table({{"a": [1.0, 2.0]}})
write_parquet(folder / "a.parquet", table)
assert read_parquet(folder / "a.parquet", ["a"], "").numbers("a").tolist() == [1, 2]
with (folder / "a.arrow").open("wb") as stream, pa.ipc.new_file(stream, table.schema) as file:
    file.write_table(table)
check_batches(folder / "a.arrow", "", 1000)
save_file({{"a": torch.ones(2)}}, folder / "a.safetensors")
assert read_safetensors(folder / "a.safetensors", "", "")[0]["a"].tolist() == [1, 1]
assert [*read_header(folder / "a.safetensors", "")] == ["a"]
write_video(folder / "a.mp4", [np.zeros((16, 16, 3), np.uint8)])
assert read_video(folder / "a.mp4")[0].shape == (1, 16, 16, 3)
try:
    write_text(folder / "\\u0416", "a")
except InputError as error:
    assert "cannot be written in the encoding of the locale" in str(error)
else:
    assert sys.getfilesystemencoding() == "utf-8"
"""


def latin_1(folder: Path) -> dict[str, str]:
    """Environment of a German locale in Latin-1, which is compiled into `folder`."""
    target = folder / "de_DE.ISO-8859-1"
    try:
        command = ["localedef", "-i", "de_DE", "-f", "ISO-8859-1", str(target)]
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"the locale de_DE.ISO-8859-1 cannot be made: {error}")
    return {"LC_ALL": target.name, "LOCPATH": str(folder)}


@pytest.mark.parametrize("locale", ["latin-1", "C"])
def test_folders_with_umlauts(locale: str, tiny_drive: TinyDrive, tmp_path: Path) -> None:
    settings = latin_1(tmp_path) if locale == "latin-1" else {"LC_ALL": locale}
    folder = tmp_path / os.fsdecode(FOLDER)
    try:
        folder.mkdir()
    except OSError:  # macOS
        pytest.skip("the file system takes names in UTF-8 alone")
    shutil.copytree(tiny_drive.root, folder / "drive")
    kept = {name: value for name, value in os.environ.items() if name[:3] not in ("LC_", "PYT")}
    result = subprocess.run(
        [sys.executable, "-c", COMMANDS, folder / "drive", folder],
        env={**kept, **settings},
        capture_output=True,
        timeout=120,
    )
    said = result.stderr.decode("latin-1")
    shown = "F\xe4hrten" if locale == "latin-1" else r"F\udce4hrten"
    assert result.returncode == 0 and len(said.splitlines()) == 1, said
    assert said.startswith("recast: ") and f"/{shown}/none: log folder: " in said
