"""What an import of a foreign scene did, for the console."""

from __future__ import annotations

from recast.scene.importers import ImportRecord


def import_lines(record: ImportRecord) -> list[tuple[str, str]]:
    """Lines and their styles: place, actors, what was changed, left out, and what looks wrong."""
    names = ", ".join(f"{name} is track {track}" for name, track in record.tracks.items())
    lines = [(f"placed by: {record.placed_by}", ""), (f"actors: {names or 'none'}", "")]
    lines += [(f"changed: {sentence}", "") for sentence in record.changed]
    lines += [(f"left out: {sentence}", "yellow") for sentence in record.left_out]
    lines += [(f"warning: {sentence}", "bold yellow") for sentence in record.warnings]
    return lines
