"""Entry point of the `recast` command."""

from __future__ import annotations

import argparse
import ast
import logging
import os
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from io import StringIO, TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TextIO

import tyro
from tyro import _errors as refused  # private: pyproject.toml bounds tyro's version

from recast.cli import shared
from recast.cli.bench import Bench, Search
from recast.cli.docs import Docs
from recast.cli.eval import Eval
from recast.cli.log import Log, Scenario
from recast.cli.machine import Doctor, Store, Trellis, Weights
from recast.cli.recar import Recar
from recast.cli.run import Demo, Report, Run, ViewCommand
from recast.cli.scene import Actor, Scene
from recast.cli.shared import line_of
from recast.core import diagnostics, files
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError, nearest, printable
from recast.core.plugins import INSTALLED_BY


@dataclass(frozen=True)
class Completion:
    """Print the completion script of a shell; recast docs install says how to install it."""

    shell: tyro.conf.Positional[Literal["bash", "zsh", "fish"]]
    """Shell that completes `recast`."""

    def __call__(self) -> None:
        print(completion_script(self.shell), end="")


COMMANDS: shared.Commands = shared.with_installed(
    "",
    {
        "demo": Demo,
        "log": Log,
        "scene": Scene,
        "actor": Actor,
        "recar": Recar,
        "eval": Eval,
        "bench": Bench,
        "trellis": Trellis,
        "scenario": Scenario,
        "run": Run,
        "search": Search,
        "report": Report,
        "view": ViewCommand,
        "store": Store,
        "weights": Weights,
        "doctor": Doctor,
        "docs": Docs,
        "completion": Completion,
    },
)
Command: Any = Annotated[
    shared.one_of(COMMANDS),
    tyro.conf.arg(help=""),  # else tyro parses its own source for one, in 50 ms
]

_DESCRIPTION = """Closed-loop driving simulation from recorded logs.

Every command also takes --verbose (show debug records and the tracebacks of errors) and --log-file
FILE (append the same records to FILE). recast --version prints the version.

The pages of the documentation: recast docs. One of them: recast docs install."""

_APART = {
    "recast-bridges": (
        "serve",
        "eval rollouts",
        "log export",
        "scenario export",
        "scenario import",
        *(f"scene import {of}" for of in ("street-gaussians", "drivestudio", "mtgs", "hugsim")),
    ),
    "recast-tools": ("planner", "recar assets", "recar autoencoder", "recar assemble"),
}
"""Commands of the other distributions, for the hint when one is not installed."""
_LOG = logging.getLogger(__name__)


def main(args: Sequence[str] | None = None) -> int:
    """Run one command; bad input ends in one line on stderr and exit code 2."""
    words = list(sys.argv[1:] if args is None else args)
    if isinstance(sys.stdout, TextIOWrapper):  # names of files may not be in a terminal's encoding
        sys.stdout.reconfigure(errors="backslashreplace")
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
        with _system_errors(), _plain_warnings():
            code = command()
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
    return code if isinstance(code, int) else 0


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Warnings are a line each, without the place in the code that gave them."""
    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_, **__: f"warning: {printable(str(message))}\n"
    try:
        yield
    finally:
        warnings.formatwarning = before


@contextmanager
def _system_errors() -> Iterator[None]:
    """The last resort: whatever the system refuses, and an exit of a plug-in, is one line."""
    try:
        with files.disk_errors("disk"):
            yield
    except (SystemExit, GeneratorExit) as error:
        if isinstance(error.__context__, BrokenPipeError):  # rich exits when nobody reads on
            raise error.__context__ from None
        problem = f"code of a plug-in ended the program ({type(error).__name__}: {error})"
        mend = "raise an exception that says what is wrong; run it with --verbose to see its place"
        raise InputError("command", "exit", problem, mend) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        where = error.filename if isinstance(error.filename, str) else "system"
        reason = error.strerror or str(error) or type(error).__name__
        mend = "run it with --verbose to see where it comes from"
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
        InputError: an unknown command or option, or a value of another type.
        SystemExit: help was asked for, or no command was named; the help is printed.
    """
    path, below = _path(words)
    program, rest = " ".join(("recast", *path)), words[len(path) :]
    if below and rest and not rest[0].startswith("-"):
        word = " ".join((*path, rest[0]))
        package = next((name for name, commands in _APART.items() if word in commands), None)
        if package is not None:
            problem = f"is a command of {package}, which is not installed"
            raise InputError("command line", word, problem, f"run {INSTALLED_BY[package]}")
        problem = f"is not a command of {program}"
        raise InputError("command line", rest[0], problem, _choice(rest[0], below, program))
    page = _Page(sys.stdout)
    try:
        with refused.on_parse_error(partial(_refuse, program, rest)), redirect_stdout(page):
            return _parsed(words if rest or not below else [*path, "--help"])
    except SystemExit:
        print(page.fitted(), end="")
        raise SystemExit(0 if rest or not below else 2) from None


def _path(words: Sequence[str]) -> tuple[Sequence[str], shared.Commands]:
    """The command that words begin with, and its own commands; none if it runs by itself."""
    below: shared.Commands = COMMANDS
    for count, word in enumerate(words):
        if word not in below:
            return words[:count], below
        below = getattr(below[word], "commands", {})
    return words, below


class _Page(StringIO):
    """Collects a help page in the form for a stream: its encoding, and colours on a terminal."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream; tyro draws frames with ASCII unless it is "utf-8"."""
        return (self._stream.encoding or "ascii").lower()

    def isatty(self) -> bool:
        """Whether tyro shall colour the page."""
        return self._stream.isatty() and not os.environ.get("NO_COLOR")

    def fitted(self) -> str:
        """The page, with the lines wrapped that tyro does not wrap: those above the boxes."""
        columns = shutil.get_terminal_size().columns
        first, *lines = self.getvalue().splitlines() or [""]
        usage = re.sub(r"\x1b\[[\d;]*m", "", first).replace(",", ", ")
        if not usage.startswith("usage: "):
            return self.getvalue()
        wrapped = textwrap.wrap(usage, columns, subsequent_indent=" " * len("usage: "))
        for line in lines:
            plain = "\x1b" not in line and len(line) > columns
            wrapped += textwrap.wrap(line, columns) if plain else [line.rstrip()]
        text = "\n".join((*wrapped, ""))
        return text if self.encoding == "utf-8" else text.replace("•", "*")


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

    Names of motions, parts, streets and weights are those of now. Whatever else an argument is, it
    is completed as a file name.
    """
    script = StringIO()
    with redirect_stdout(script), suppress(SystemExit):
        _parsed(["--tyro-write-completion", shell, "-"])
    text = re.sub(
        r"^COMPLETION_SPEC = .*\n",
        lambda spec: f"{spec[0]}{_OFFER.format(values=_values())}",
        script.getvalue(),
        flags=re.MULTILINE,
    )
    for said, better in _FILES[shell].items():
        text = text.replace(said, better)
    return text


def _values() -> dict[str, list[str]]:
    """Names by option, by command and option, or by command for its first argument."""
    from recast.core.plugins import GENERATORS, IMPORTERS, PLANNERS, RESTORERS, SEGMENTERS
    from recast.simulation import MOTIONS
    from recast.synthetic import SCENES
    from recast.weights import PUBLISHED

    motions = [*MOTIONS, *dict.fromkeys(motion.name for motion in MOTIONS.values())]
    parts = (GENERATORS, PLANNERS, RESTORERS, SEGMENTERS)
    return {
        "--motion": motions,
        "--scenes": [*SCENES],
        "demo --scene": [*SCENES],
        "eval planner": [*PLANNERS.names()],
        "log import": [*IMPORTERS.names()],
        "log synth --scene": [*SCENES],
        "scenario list": motions,
        "search": [*SCENES],
        **{f"weights {word}": [*PUBLISHED] for word in ("get", "path", "verify")},
        **{f"--{part.kind}": [*part.names()] for part in parts},
    }


_FILES: dict[str, dict[str, str]] = {
    "bash": {
        # An empty list, which has one empty word in tyro's script, lets bash complete files.
        'COMPREPLY=("${matches[@]}")': 'COMPREPLY=(${completions:+"${matches[@]}"})',
        "complete -F ": "complete -o default -F ",
    },
    "zsh": {
        'if [[ "$completions" == "__TYRO': 'if [[ -z "$completions" || "$completions" == "__TYRO'
    },
    "fish": {'if test "$results" = __TYRO': 'if test -z "$results"; or test "$results" = __TYRO'},
}
"""What is replaced in tyro's scripts, so that words without a name among ours are file names."""
_OFFER = """
VALUES = {values}


def offer(spec, path=''):
    for option in spec['options']:
        for flag in option['flags']:
            names = VALUES.get(flag) or VALUES.get(path + ' ' + flag)
            if names:
                option.update(type='choice', choices=names)
    for word, below in list(spec['subcommands'].items()):
        offer(below, (path + ' ' + word).strip())
    for name in VALUES.get(path, ()):
        spec['subcommands'][name] = dict(spec, description=name, subcommands={{}})


offer(COMPLETION_SPEC)
"""
"""Adds names to what tyro wrote. A first argument is told as a command with the same options. The
scripts quote it in three ways: no double quotes, backslashes or dollars."""


def _refuse(program: str, words: Sequence[str], event: refused.ParseErrorEvent) -> None:
    """Raise what tyro is about to print as an error of one line.

    Args:
        program: the command, such as "recast log info".
    """
    options = _options(program)
    for word in words:
        option = word.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in ("--", *options):
            problem = f"is not an option of {program}"
            hint = _choice(option, options, program)
            if isinstance(event, refused.BadValue | refused.MissingArgs):
                names = (_shown(argument) for argument in _arguments(event))
                if (name := option[2:].upper()) in names:
                    hint = f"give {name} without {option}; see {program} --help"
            raise InputError("command line", option, problem, hint)
    see = f"see {program} --help"
    if isinstance(event, refused.MissingArgs):
        missing = [_shown(argument) for argument in _arguments(event)]
        problem = "is missing" if len(missing) == 1 else "are missing"
        raise InputError("command line", ", ".join(missing), problem, see)
    if isinstance(event, refused.UnrecognizedArgs):
        problem = f"is not an argument of {program}"
        raise InputError("command line", event.tokens[0], problem, see)
    argument = getattr(event, "argument", None)
    if argument is None:
        return  # of a kind that no command of ours has: in tyro's words
    name = _shown(argument).partition(" ")[0]
    if isinstance(event, refused.InvalidChoice):
        choices = sorted({*event.choices} - {"None"})
        hint = _choice(event.value, choices, program)
        raise InputError("command line", name, f"is {event.value!r}", hint)
    wanted = str(argument.lowered.metavar)
    give = f"give {_TYPES.get(wanted, wanted)}; {see}"
    if isinstance(event, refused.BadValue):
        raise InputError("command line", name, "has no value", give)
    if isinstance(event, refused.InstantiationFailure):
        if (values := re.search(r"instantiated from (\[.*\])", event.message)) is not None:
            said = " ".join(ast.literal_eval(values[1]))
            raise InputError("command line", name, f"is {said!r}", give)
        # In the words of `int` and `float`, which tyro passes on.
        given = re.search(r"(?:int\(\) with base 10|to float): ('.*')$", event.message.strip())
        if given is None:
            raise InputError("command line", name, event.message, see)
        raise InputError("command line", name, f"is {given[1]}", give)


_TYPES = {"INT": "an integer", "FLOAT": "a number"}


def _arguments(event: refused.MissingArgs | refused.BadValue) -> list[Any]:
    if isinstance(event, refused.BadValue):
        return [event.argument]
    return [missing.arg for missing in event.missing_arguments]


def _shown(argument: Any) -> str:
    """An argument in a message: "--out PATH", or its name in capitals if it has no option."""
    if argument.is_positional():
        return str(argument.field.intern_name).upper()
    return str(argument.get_invocation_text()[1].as_str_no_ansi())


def _options(program: str) -> list[str]:
    """All options of a command, as its help page lists them."""
    page = StringIO()
    with redirect_stdout(page), suppress(SystemExit):
        _parsed([*program.split()[1:], "--help"])
    lines = re.findall(r"^[^-\w]*(-[-\w].*?)(?:  |$)", page.getvalue(), flags=re.MULTILINE)
    ours = ["--version", "--verbose", "--log-file"] if program == "recast" else []
    return [*ours, *(option for line in lines for option in re.findall(r"--[\w-]+", line))]


def _choice(word: str, choices: Iterable[str], program: str) -> str:
    """The hint for a word that is not among the choices: the next alike, else all if they fit."""
    alike = nearest(word, choices)
    if alike is not None:
        return f"did you mean {alike}? see {program} --help"
    names = ", ".join(choices)
    return f"choose one of {names}" if len(names) < _MOST_NAMES else f"see {program} --help"


_MOST_NAMES = 160
"""Characters of a list of choices in one line, at most."""
