"""Studies are tested with short refinements and films."""

from support.short_work import short_work as short_work
