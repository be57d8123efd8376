"""What all vehicles of a set of photographs share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from recast.errors import InputError
from recast.recar.ingest.perceptual_hash import BITS, DUPLICATE_BITS
from recast.recar.record import LARGEST_SIDE, MOST_VIEWS, SetRecord, regular_azimuths
from recast.recar.split import HELD_OUT_SHARE


@dataclass(frozen=True)
class Layout:
    """A data set of walk-arounds.

    Attributes:
        title: its name, for people.
        width, height: of the published photographs, pixels, either way up.
        photographs: of a vehicle, about.
    """

    title: str
    width: int
    height: int
    photographs: int


LAYOUTS: Mapping[str, Layout | None] = {
    "regular": None,
    "3drealcar": Layout("3DRealCar", 1920, 1440, 200),
    "mad-cars": Layout("MAD-CARS", 1920, 1080, 85),
}
"""By the word of the command line; None where photographs are regular, see `photographs_of`."""
EXPERIMENTAL = frozenset({"3drealcar", "mad-cars"})
"""Layouts that have not met real data."""


@dataclass(frozen=True)
class IngestSettings:
    """Settings of a set of photographs.

    Attributes:
        licence: of the pictures; of a vehicle whose row names none.
        source: where they are from, for people.
        views: photographs of each vehicle.
        width, height: of every picture in the set, pixels.
        clockwise: the photographs go around the vehicle clockwise, seen from above.
        elevation_deg: of the camera, where it was measured.
        fov_deg: across the width of a photograph, where it was measured; all photographs must then
            have the shape of the set's pictures.
        split_seed, held_out_share: decide the split of vehicles whose row names none.
        duplicate_bits: two pictures whose hashes differ in no more bits are the same one.
        layout: of the photographs, one of `LAYOUTS`; all but "regular" are walk-arounds.
        azimuth_within_deg: by which a photograph of a walk-around may be off its azimuth; half of
            the step between two views where it is None.
    """

    licence: str
    source: str = "photographs"
    views: int = 30
    width: int = 1200
    height: int = 800
    clockwise: bool = False
    elevation_deg: float | None = None
    fov_deg: float | None = None
    split_seed: int = 0
    held_out_share: float = HELD_OUT_SHARE
    duplicate_bits: int = DUPLICATE_BITS
    layout: str = "regular"
    azimuth_within_deg: float | None = None

    def validate(self) -> None:
        """Refuse impossible values.

        Raises:
            InputError: the first one, named as the option of the command line.
        """
        for option, value, low, high in (
            ("--views", self.views, 1, MOST_VIEWS),
            ("--width", self.width, 16, LARGEST_SIDE),
            ("--height", self.height, 16, LARGEST_SIDE),
            ("--elevation", self.elevation_deg, -89, 89),
            ("--fov", self.fov_deg, 1, 170),
            ("--split-seed", self.split_seed, 0, 2**63),
            ("--held-out", self.held_out_share, 0, 1),
            ("--duplicate-bits", self.duplicate_bits, 0, BITS),
            ("--azimuth-within", self.azimuth_within_deg, 0, 180),
        ):
            if value is not None and not low <= value <= high:
                raise InputError(option, "value", f"is {value}", f"give {low} to {high}")
        if self.layout not in LAYOUTS:
            raise InputError(
                "--layout", self.layout, "is unknown", f"choose of {', '.join(LAYOUTS)}"
            )
        for option, text in (("--licence", self.licence), ("--source", self.source)):
            if not text.strip():
                raise InputError(option, "value", "is empty", "say it in words")

    @property
    def azimuth_within(self) -> float:
        """Degrees by which a photograph of a walk-around may be off its azimuth."""
        return 180 / self.views if self.azimuth_within_deg is None else self.azimuth_within_deg

    def record(self, name: str, identities: int) -> SetRecord:
        """The record of the finished set."""
        return SetRecord(
            complete=True,
            name=name,
            licence=self.licence,
            source=self.source,
            identities=identities,
            azimuths_deg=regular_azimuths(self.views),
            elevation_deg=self.elevation_deg,
            fov_deg=self.fov_deg,
            width=self.width,
            height=self.height,
            split_seed=self.split_seed,
            held_out_share=self.held_out_share,
            generator=None,
        )
