"""The page of the screening: one file that needs no other."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

CONTENT_POLICY = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the browser lets the page do: ask its own server, nothing else."""


@cache
def page() -> bytes:
    """HTML with style and script inside."""
    folder = files("recast.recar.screening") / "web"
    text = (folder / "page.html").read_text(encoding="utf-8")
    for name, mark in (("page.css", "/* STYLE */"), ("page.js", "/* SCRIPT */")):
        text = text.replace(mark, (folder / name).read_text(encoding="utf-8"))
    return text.encode()
