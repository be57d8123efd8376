"""Commands in a pseudo-terminal, as a person sees them."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import sys
import termios
from collections.abc import Sequence
from pathlib import Path

_ESCAPES = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")
RECAST = "from recast.cli.main import main; import sys; sys.exit(main())"
"""What the console script runs."""


def in_terminal(
    words: Sequence[str],
    *,
    columns: int = 80,
    code: str = RECAST,
    folder: str | Path = ".",
    **settings: str,
) -> tuple[int, str]:
    """Run Python code, by default the command `recast`, in a terminal of its own.

    Args:
        words: command-line words of the code.
        columns: width of the terminal.
        folder: present folder of the command.
        settings: environment variables.

    Returns:
        the exit code, and all that appeared, with its escape sequences.
    """
    # `-P`: as for a console script, the present folder is not where Python looks for modules.
    command = [sys.executable, "-P", "-c", code, *words]
    left_out = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "PYTHONIOENCODING")
    kept = {name: value for name, value in os.environ.items() if name not in left_out}
    process, terminal = pty.fork()
    if process == 0:
        try:
            fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
            os.chdir(folder)
            os.execve(sys.executable, command, {**kept, "TERM": "xterm-256color", **settings})
        finally:
            os._exit(127)
    shown = b""
    while True:
        try:
            piece = os.read(terminal, 65536)
        except OSError:  # Linux: the last process that had it open is gone
            break
        if not piece:
            break
        shown += piece
    os.close(terminal)
    _, status = os.waitpid(process, 0)
    return os.waitstatus_to_exitcode(status), shown.decode("utf-8", "backslashreplace")


def plain(shown: str) -> list[str]:
    """The lines without escape sequences."""
    return [line.rstrip("\r") for line in _ESCAPES.sub("", shown).rstrip().split("\n")]
