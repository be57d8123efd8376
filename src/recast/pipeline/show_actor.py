"""`recast actor show`: the sheet of an actor."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from recast import storage
from recast.actors import load_actor
from recast.errors import InputError
from recast.reporting.actor_sheet import draw_actor_sheet


def show_actor(folder: Path, out: Path | None = None) -> Path:
    """Draw the sheet of an actor, see `draw_actor_sheet`, and return its file.

    Args:
        folder: of the actor.
        out: PNG to write; beside the folder and of its name if None.

    Raises:
        InputError: no actor lies there, `out` is no PNG or exists already, or the disk refuses.
    """
    if out is None:
        place = Path(folder).resolve()
        out = place.with_name(f"{place.name}.png")
    if out.suffix.lower() != ".png":
        raise InputError(out, "--out", "is no PNG", "end its name in .png")
    if out.exists():
        raise InputError(out, "--out", "exists already", "name another one or remove it")
    sheet = Image.fromarray(draw_actor_sheet(load_actor(folder)))
    with storage.atomic_file(out) as partial:
        sheet.save(partial, format="PNG")
    return out
