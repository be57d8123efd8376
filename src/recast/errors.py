"""The one error that users see: which file, which field, what is wrong, and the mend."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Bad input from outside: a file, a folder, a configuration or a command-line value.

    The CLI prints it as one line and exits with code 2, so the message must stand alone.

    Args:
        where: file or folder at fault (or the command-line argument).
        field: the field, record or member inside it.
        problem: what is wrong, with the value found.
        mend: what the user can do about it.
    """

    def __init__(self, where: str | Path, field: str, problem: str, mend: str) -> None:
        self.where = str(where)
        self.field = field
        self.problem = problem
        self.mend = mend
        super().__init__(f"{self.where}: {field}: {problem}; {mend}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        # Exceptions pickle through `args`, which holds the joined line; worker processes need the
        # parts.
        return (InputError, (self.where, self.field, self.problem, self.mend))
