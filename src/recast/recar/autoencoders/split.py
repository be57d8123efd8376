"""Which training assets are held out."""

from __future__ import annotations

HELD_OUT_EVERY = 20


def is_held_out(number: int) -> bool:
    """Whether an asset, by its number, is never trained on: one in twenty."""
    return number % HELD_OUT_EVERY == 0


def split(count: int) -> tuple[list[int], list[int]]:
    """Numbers of the assets to train on, and of those held out."""
    numbers = range(count)
    return (
        [number for number in numbers if not is_held_out(number)],
        [number for number in numbers if is_held_out(number)],
    )
