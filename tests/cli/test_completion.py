"""`recast completion`: the shells' own parsers take the script, and bash completes with it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from recast.cli.main import main


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_parses_the_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "offer(COMPLETION_SPEC)" in script and "cut-in-stop" in script
    assert {"bash": "{completions:+", "zsh": '-z "$comp', "fish": '-z "$res'}[shell] in script
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    done = subprocess.run([shell, "-n"], input=script, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("recast be", {"bench"}),
        ("recast bench closed-loop --planner-", {"--planner-device"}),
        ("recast run --preset stree", {"streetgs"}),
        ("recast weights ge", {"get"}),
        ("recast run --scene FOLDER/pla", {"FOLDER/place"}),
        ("recast run --motion cut-in-s", {"cut-in-stop", "cut-in-stop-a", "cut-in-stop-b"}),
        ("recast bench closed-loop --planner pdm", {"pdm-closed"}),
        ("recast bench closed-loop --planner FOLDER/pla", set()),  # bash completes files
        ("recast actor make log --generator templ", {"template"}),
        ("recast log import kit", {"kitti"}),
        ("recast log import kitti FOLDER --dri", {"--drive"}),
        ("recast log import kitti FOLDER/pla", set()),
        ("recast log synth --scene urb", {"urban-straight"}),
        ("recast weights get dino", {"dinov2"}),
    ],
)
def test_bash_completes(
    line: str, expected: set[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "place").mkdir()
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "recast.bash"
    script.write_text(capsys.readouterr().out)
    words = line.replace("FOLDER", str(tmp_path)).split()
    program = (
        f'source {script}; spec=$(complete -p recast); [[ $spec == *"-o default"* ]] || exit 9\n'
        f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}\n"
        '_tyro_recast; [ ${#COMPREPLY[@]} -eq 0 ] || printf "%s:\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", program], capture_output=True, text=True, check=True
    )
    wanted = {one.replace("FOLDER", str(tmp_path)) for one in expected}
    assert set(done.stdout.split()) == {f"{one}:" for one in wanted}
