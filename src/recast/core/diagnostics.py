"""Where the records of the `recast` loggers go: to the terminal, to a file, or nowhere.

Libraries only log, under the names of their modules. A program decides once where to, with `begin`;
worker processes are told the same.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from recast.core.errors import printable
from recast.core.files import disk_errors

_LOGGER = logging.getLogger("recast")
_LINE = "%(asctime)s %(levelname)s %(process)d %(name)s: %(message)s"


@dataclass(frozen=True)
class Diagnostics:
    """Where records go.

    Attributes:
        verbose: whether they go to standard error, with the tracebacks of errors that users caused.
        file: file that they are appended to, or None.
        warnings: whether warnings and errors go to standard error even if not `verbose`.
    """

    verbose: bool = False
    file: Path | None = None
    warnings: bool = False


_current = Diagnostics()


def begin(wanted: Diagnostics) -> None:
    """Send all records there from now on, and nowhere else.

    Raises:
        InputError: the file cannot be written.
    """
    global _current
    if wanted.file is not None:  # other processes may work in another folder
        wanted = replace(wanted, file=wanted.file.absolute())
    handlers: list[logging.Handler] = []
    if wanted.verbose or wanted.warnings:
        handlers.append(logging.StreamHandler())
        handlers[0].setLevel(logging.DEBUG if wanted.verbose else logging.WARNING)
    if wanted.file is not None:
        with disk_errors(wanted.file):
            # Several processes append to it: each record is one write.
            handlers.append(
                logging.FileHandler(wanted.file, encoding="utf-8", errors="backslashreplace")
            )
    for old in list(_LOGGER.handlers):
        _LOGGER.removeHandler(old)
        old.close()
    for handler in handlers or [logging.NullHandler()]:
        handler.setFormatter(_OneLine(_LINE))
        _LOGGER.addHandler(handler)
    _LOGGER.setLevel(min((handler.level or logging.DEBUG for handler in handlers), default=0))
    logging.raiseExceptions = not handlers  # a full disk below the file ends no run
    _current = wanted


def show_warnings() -> None:
    """Send warnings and errors to standard error, too: a server has nobody else to tell them."""
    begin(replace(_current, warnings=True))


def current() -> Diagnostics:
    """Where records go, for `begin` in another process."""
    return _current


class _OneLine(logging.Formatter):
    """Messages hold names from files; a record is a line, but for its traceback."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        record.message = printable(record.message)
        return super().formatMessage(record)
