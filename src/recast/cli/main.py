"""Entry point of the `recast` command."""

from __future__ import annotations

import argparse
import logging
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import tyro

from recast.cli import shared
from recast.cli.actor import Actor
from recast.cli.bench import Bench
from recast.cli.eval import Eval
from recast.cli.log import Log
from recast.cli.machine import Doctor, Weights
from recast.cli.output import line_of
from recast.cli.planner import Planner
from recast.cli.recar import Recar
from recast.cli.run import Demo, Report, Run, View
from recast.cli.scenario import Scenario
from recast.cli.scene import Scene
from recast.cli.serve import Serve
from recast.cli.store import Store
from recast.cli.trellis import Trellis
from recast.core import diagnostics, files
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError


@dataclass(frozen=True)
class Completion:
    """Print the completion script of a shell; docs/install.md says how to install it."""

    shell: tyro.conf.Positional[Literal["bash", "zsh", "fish"]]
    """Shell that completes `recast`."""

    def __call__(self) -> None:
        print(completion_script(self.shell), end="")


Command: Any = Annotated[
    shared.one_of(
        {
            "demo": Demo,
            "log": Log,
            "scene": Scene,
            "actor": Actor,
            "recar": Recar,
            "eval": Eval,
            "bench": Bench,
            "trellis": Trellis,
            "planner": Planner,
            "scenario": Scenario,
            "run": Run,
            "report": Report,
            "view": View,
            "serve": Serve,
            "store": Store,
            "weights": Weights,
            "doctor": Doctor,
            "completion": Completion,
        }
    ),
    tyro.conf.arg(help=""),  # else tyro parses its own source for one, in 50 ms
]

_DESCRIPTION = """Closed-loop driving simulation from recorded logs.

Every command also takes --verbose (show debug records and the tracebacks of errors) and --log-file
FILE (append the same records to FILE). recast --version prints the version."""

_LOG = logging.getLogger(__name__)


def main(args: Sequence[str] | None = None) -> int:
    """Run one command; bad input ends in one line on stderr and exit code 2."""
    words = list(sys.argv[1:] if args is None else args)
    command = None
    try:
        where, words = _diagnostics(words)
        diagnostics.begin(where)
        if words == ["--version"]:
            from recast import __version__

            print(f"recast {__version__}")
            return 0
        if _LOG.isEnabledFor(logging.DEBUG):
            from recast import __version__  # asks the installed package, in 40 ms

            _LOG.debug("recast %s: %s", __version__, words)
        command = _command(words)
        with _system_errors():
            command()
    except InputError as error:
        _LOG.debug("refused", exc_info=True)
        print(f"recast: {line_of(error, command)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever reads the output has enough
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        _LOG.debug("interrupted", exc_info=True)
        print("recast: interrupted; the same command resumes", file=sys.stderr)
        return 130
    except Exception:
        _LOG.critical("a fault of recast or of a plug-in", exc_info=True)
        raise
    _LOG.debug("done")
    return 0


@contextmanager
def _system_errors() -> Iterator[None]:
    """The last resort: whatever the system refuses, and an exit of a plug-in, is one line."""
    try:
        with files.disk_errors("disk"):
            yield
    except (SystemExit, GeneratorExit) as error:
        problem = f"code of a plug-in ended the program ({type(error).__name__}: {error})"
        mend = "raise an exception that says what is wrong; see --verbose for its place"
        raise InputError("command", "exit", problem, mend) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        where = error.filename if isinstance(error.filename, str) else "system"
        reason = error.strerror or str(error) or type(error).__name__
        mend = "see --verbose for where it comes from"
        raise InputError(where, type(error).__name__, reason, mend) from error


class _Options(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError("command line", "options", message, "see recast --help")


def _diagnostics(words: Sequence[str]) -> tuple[Diagnostics, list[str]]:
    """What --verbose and --log-file say, wherever they stand, and the other words."""
    options = _Options(add_help=False, allow_abbrev=False)
    options.add_argument("--verbose", action="store_true")
    options.add_argument("--log-file", type=Path)
    found, others = options.parse_known_args(words)
    return Diagnostics(found.verbose, found.log_file), others


def _command(words: Sequence[str]) -> Callable[[], None]:
    """What the words ask for.

    Raises:
        InputError: an unknown command or option, or a value that is none.
        SystemExit: help was asked for, and given.
    """
    shown = StringIO()
    try:
        with redirect_stderr(shown):
            command = _parsed(words)
    except SystemExit as ended:
        if not ended.code:
            raise
        raise _refusal(shown.getvalue()) from None
    return command


def _parsed(words: Sequence[str]) -> Callable[[], None]:
    return tyro.cli(
        Command,
        prog="recast",
        description=_DESCRIPTION,
        config=(
            tyro.conf.OmitSubcommandPrefixes,
            tyro.conf.OmitArgPrefixes,
            tyro.conf.DisallowNone,
        ),
        args=words,
    )


def completion_script(shell: str) -> str:
    """The script with which a shell ("bash", "zsh" or "fish") completes `recast`.

    In bash, arguments that are no option are completed as file names.
    """
    script = StringIO()
    with redirect_stdout(script), suppress(SystemExit):
        _parsed(["--tyro-write-completion", shell, "-"])
    return script.getvalue().replace("complete -F ", "complete -o default -F ")


def _refusal(boxed: str) -> InputError:
    """One line of the box that tyro draws: title, problem, rule, perhaps options alike, rule, help.

    Its frame is of lines or of ASCII. Explanations of options are indented by eight and left out.
    """
    first, *framed = boxed.splitlines() or ["options"]
    rows = [row[2:].rstrip(" │") for row in framed if not row.startswith("╰")]
    if rows and not rows[0].strip("-"):  # below the title, in ASCII
        del rows[0]
    rule = next((i for i, row in enumerate(rows) if not row.strip(" ─-")), len(rows))
    said = " ".join(row.strip() for row in rows[:rule] if not row.startswith(" " * 8))
    alike = ""
    if any(row.startswith("Perhaps you meant") for row in rows):
        option = next(row.split()[0] for row in rows[rule:] if row.startswith("    --"))
        alike = f"did you mean {option}? "
    asked = (re.search(r"recast[a-z0-9 -]* --help", row) for row in rows)
    shown = next((found[0] for found in asked if found), "recast --help")
    title = first.strip("╭╮─ ").lower()
    said = re.sub(f"(?i)^{re.escape(title)}:? *", "", said).rstrip(".")
    mend = f"{alike}see {shown}"
    return InputError("command line", title, said, mend)
