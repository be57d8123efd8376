"""The command itself: bad options, records of what happened, errors of the system."""

from __future__ import annotations

import errno
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import recast
from recast.cli.machine import Doctor
from recast.cli.main import main
from recast.core import diagnostics
from recast.core.diagnostics import Diagnostics

RUN = ("run", "log", "--track", "0", "--out", "x")


@pytest.fixture(autouse=True)
def quiet_again() -> Iterator[None]:
    yield
    diagnostics.begin(Diagnostics())


def test_a_reader_that_has_enough_is_no_fault() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "recast", "scenario", "list"]  # rich exits by itself
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_package_is_the_command() -> None:
    command = [sys.executable, "-m", "recast"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"recast {recast.__version__}\n")
    done = subprocess.run([*command, "rnu"], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("recast: command line: rnu: is not a")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nonesuch",), "nonesuch: is not a command of recast; choose one of demo, log"),
        (("rnu",), "rnu: is not a command of recast; did you mean run? see recast --help"),
        (("log", "improt"), "did you mean import? see recast log --help"),
        (("store", "list", "--store", "X"), "--store: is not an option of recast store list; give"),
        (("store", "list"), "STORE: is missing; see recast store list --help"),
        (("run",), "LOG, --track STR, --out PATH: are missing; see recast run --help"),
        ((*RUN, "--preset", "omnier"), "--preset: is 'omnier'; did you mean omnire?"),
        ((*RUN, "--seed", "x"), "--seed: is 'x'; give an integer"),
        (("demo", "--out", "o", "--seed", "x"), "--seed: is 'x'; give an integer"),
        (("actor", "generate", "a", "--out", "x", "--model", "m", "--cfg", "1"), "--cfg: is '1'"),
        (("--versoin",), "did you mean --version?"),
        ((*RUN, "--steps", "many"), "--steps"),
        ((*RUN, "--steps", "5.5"), "--steps"),
        ((*RUN, "--steps", "9" * 5000), "--steps"),
        ((*RUN, "--steps"), "--steps"),
        ((*RUN, "--preset", "\x1b[2J\nomnire"), "--preset"),
        ((*RUN, "--stpes", "4"), "did you mean --steps? see recast run --help"),
        ((*RUN, "--scale", "0.5", "0.25"), "0.25"),
        ((*RUN, "\udcff"), r"\udcff"),
        (("bench", "open-loop"), "open-loop"),
        (("log", "import"), "see recast log import --help"),
        ((*RUN, "--log-file"), "--log-file"),
        (("doctor", "--verbose=3"), "--verbose"),
    ],
)
def test_bad_options_are_one_line(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    captured = capsys.readouterr()
    [line] = captured.err.splitlines()
    assert line.startswith("recast: command line: ") and said in line
    assert len(line) < 320 and line.isprintable()
    assert captured.out == ""


@pytest.mark.parametrize("seed", ["nan", "1e999", "-", "0x10", "1_"])
def test_numbers_that_are_none(seed: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, f"--seed={seed}"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_help_is_help_and_names_the_options_of_every_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for words in (["--help"], ["run", "--help"]):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert not ended.value.code
    main_help = " ".join(capsys.readouterr().out.split())
    assert "--verbose" in main_help and "--log-file FILE" in main_help


@pytest.mark.parametrize("before", [True, False])
def test_records_go_to_a_file_wherever_the_option_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], before: bool
) -> None:
    file = tmp_path / "file.log"
    option, words = ("--log-file", str(file)), ("report", str(tmp_path / "nowhere"))
    for _ in range(2):
        assert main([*option, *words] if before else [*words, *option]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2, "as quiet as without"
    text = file.read_text()
    assert text.count("is missing") == 2, "appended"
    assert "Traceback (most recent call last)" in text
    assert "FileNotFoundError" in text, "the cause"
    assert f"DEBUG {os.getpid()} recast.cli.main" in text


def test_verbose_shows_where_an_error_comes_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(tmp_path / "nowhere"), "--verbose"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("recast: ")
    assert any("FileNotFoundError" in line for line in lines)
    assert main(["report", str(tmp_path / "nowhere")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1, "not the next command's"


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"recast {recast.__version__}\n"


def test_a_log_file_that_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for file in (tmp_path, tmp_path / "no" / "file.log", tmp_path / "nul\0"):
        assert main(["doctor", "--log-file", str(file)]) == 2
        [line] = capsys.readouterr().err.splitlines()
        assert line.startswith(f"recast: {tmp_path}")


def test_a_name_cannot_forge_a_record(tmp_path: Path) -> None:
    diagnostics.begin(Diagnostics(file=tmp_path / "file.log"))
    logging.getLogger("recast.tests").info("scene %s", "a\n2026 ERROR forged\x1b[2J")
    assert len((tmp_path / "file.log").read_text().splitlines()) == 1
    assert "\x1b" not in (tmp_path / "file.log").read_text()


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EROFS, "Read-only file system", "/x/y"),
        OSError(errno.EACCES, "Permission denied", "/x/y"),
        OSError(errno.ESTALE, "Stale file handle", "/x/y"),
        OSError(errno.EMFILE, "Too many open files"),
        OSError("cannot identify image file"),
        TimeoutError(),
    ],
    ids=lambda error: type(error).__name__ + str(error.errno),
)
def test_what_the_system_refuses_anywhere_is_one_line(
    error: OSError, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(command: Doctor) -> None:
        raise error

    monkeypatch.setattr(Doctor, "__call__", refuse)
    assert main(["doctor"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("recast: /x/y: " if error.filename else "recast: ") and ";" in line


def test_a_reader_that_has_enough_ends_it_quietly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(command: Doctor) -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr(Doctor, "__call__", refuse)
    monkeypatch.setattr(os, "dup2", lambda *_: None)  # else of the tests themselves
    assert main(["doctor"]) == 0
    assert capsys.readouterr().err == ""


def test_a_fault_of_ours_keeps_its_traceback_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(command: Doctor) -> None:
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(Doctor, "__call__", fail)
    with pytest.raises(ZeroDivisionError):
        main(["doctor", "--log-file", str(tmp_path / "file.log")])
    assert "in fail" in (tmp_path / "file.log").read_text()


@pytest.mark.parametrize("command", [RUN, ("demo", "--out", "x")])
@pytest.mark.parametrize("threads", ["-1", "9" * 30])
def test_threads_that_no_machine_has(
    command: tuple[str, ...], threads: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, f"--threads={threads}"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "threads" in line
