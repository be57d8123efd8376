"""The one error that users see: which file, which field, what is wrong, and the mend."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

LINE_LIMIT = 300
"""Characters of an `InputError`'s line, at most."""

_UNPRINTABLE = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


class InputError(ValueError):
    """Bad input from outside: a file, a folder, a configuration or a command-line value.

    The CLI prints it as one line and exits with code 2, so the message must stand alone. The line
    has at most `LINE_LIMIT` characters, control characters in it are escaped; the attributes hold
    the whole text.

    Args:
        where: file or folder at fault; of a setting its name in backquotes, which the CLI shows as
            its option (so too in `field` and `mend`).
        field: the field, record or member inside it.
        problem: what is wrong, with the value found.
        mend: what the user can do about it.
        page: page of the documentation that helps, such as "docs/weights.md#names"; None for the
            page of the part of recast that raises the error (`recast.cli.shared.PAGES`).
    """

    def __init__(
        self, where: str | Path, field: str, problem: str, mend: str, page: str | None = None
    ) -> None:
        self.where = str(where)
        self.field = field
        self.problem = problem
        self.mend = mend
        self.page = page
        super().__init__(self.line(page))

    def line(self, page: str | None) -> str:
        """The whole message in one line; a page is named at its end."""
        ending = "" if page is None else f"{'' if self.mend.endswith('?') else ';'} see {page}"
        names = printable(self.where), printable(self.field)
        # Texts of libraries may span lines; names may not.
        texts = (printable(" ".join(text.split())) for text in (self.problem, self.mend))
        room = LINE_LIMIT - len(": : ; ") - len(ending)
        where, field, problem, mend = _fitted([*names, *texts], room)
        return f"{where}: {field}: {problem}; {mend}{ending}"

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str, str | None]]:
        # Exceptions pickle through `args`, which holds the joined line; worker processes need the
        # parts.
        return (type(self), (self.where, self.field, self.problem, self.mend, self.page))


class UnreachableError(InputError):
    """Another program that is needed is not there: the same command may work later."""


def require_range(least: float, most: float | None = None, **settings: float | None) -> None:
    """Refuse a setting below `least` or above `most`; None was not given."""
    for name, value in settings.items():
        if value is not None and not least <= value <= (value if most is None else most):
            allowed = f"{least} or more" if most is None else f"{least} to {most}"
            raise InputError(f"`{name}`", "value", f"is {value}", f"give {allowed}")


def printable(text: str) -> str:
    """`text` with control characters, marks of text direction and lone surrogates escaped."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        one.encode("unicode_escape").decode() if unicodedata.category(one) in _UNPRINTABLE else one
        for one in text
    )


def nearest(word: str, choices: Iterable[str]) -> str | None:
    """The choice that is spelled most alike, for "did you mean"; None if there is none alike."""
    by_lower = {choice.lower(): choice for choice in choices}
    alike = get_close_matches(word.lower(), by_lower, 1)
    return by_lower[alike[0]] if alike else None


def _fitted(parts: list[str], limit: int) -> list[str]:
    """Where, field, problem and hint, shortened to `limit` characters together.

    Users act by the hint and the field, so lists of names go first, then the problem and the
    path; the hint itself goes last.
    """
    parts = list(parts)
    for index, kept, shorten in _STEPS:
        over = sum(map(len, parts)) - limit
        if over > 0 and len(parts[index]) > kept:
            parts[index] = shorten(parts[index], max(kept, len(parts[index]) - over))
    return parts


def _head(text: str, length: int) -> str:
    return text[: length - 1] + "…"


def _tail(text: str, length: int) -> str:
    return "…" + text[len(text) - length + 1 :]  # a path is known by its end


def _shorter_list(text: str, length: int) -> str:
    """`text` without the last names of its longest list; longer than asked for if they are few."""
    lists = re.findall(r"[^\s,;]+(?:, (?!or\b|and\b)[^\s,;]+)+", text)
    names = max(lists, key=len, default="").split(", ")
    kept = names[:]
    while len(kept) > 2 and len(text) - len(", ".join(names)) + len(", ".join(kept)) + 3 > length:
        kept.pop()
    return text if kept == names else text.replace(", ".join(names), ", ".join((*kept, "…")))


_WHERE, _FIELD, _PROBLEM, _HINT = range(4)
_STEPS = (
    (_HINT, 0, _shorter_list),
    (_PROBLEM, 110, _head),
    (_WHERE, 60, _tail),
    (_PROBLEM, 60, _head),
    (_FIELD, 60, _head),
    (_HINT, 60, _head),
)
"""Parts of a line in the order in which they are shortened, each to this many characters."""
