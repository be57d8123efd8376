"""Large fields of a Waymo TFRecord, read from the file when asked for."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from recast.errors import InputError
from recast.logs.importers.waymo_schema import MATRIX_FLOAT
from recast.logs.importers.waymo_segment import MEND, Place
from recast.logs.importers.waymo_values import shaped
from recast.logs.importers.waymo_wire import FieldError, decode
from recast.logs.types import Float32Array
from recast.storage import disk_errors

_LARGEST = 1 << 24
"""Bytes of an unpacked matrix; the largest of the dataset has four million."""


@dataclass(frozen=True)
class FilePart:
    """Bytes of a file; `StoredBytes`.

    Attributes:
        place: for messages.
        offset, size: in bytes.
        sealed: the record's checksum has been compared.
    """

    place: Place
    offset: int
    size: int
    sealed: bool = True

    def read(self) -> bytes:
        """The bytes."""
        with disk_errors(self.place.path), self.place.path.open("rb") as file:
            file.seek(self.offset)
            return file.read(self.size)

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, record and field."""
        return self.place.error(problem, mend)


@dataclass(frozen=True)
class PackedMatrix:
    """A matrix as a zlib stream of a MatrixFloat message; `StoredMatrix`."""

    part: FilePart

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, record and field."""
        return self.part.error(problem, mend)

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) float32 matrix.

        Raises:
            InputError: it is empty, damaged, or of another shape.
        """
        if self.part.size == 0:
            raise self.error("is empty")
        try:
            stream = zlib.decompressobj()
            data = stream.decompress(self.part.read(), _LARGEST)
        except zlib.error as error:
            raise self.error(f"is no zlib stream ({error})") from None
        if not stream.eof:
            raise self.error("is cut off or too large")
        try:
            message = decode(MATRIX_FLOAT, data)
            values, dims = message["data"], message["shape"]["dims"]
        except FieldError as error:
            raise self.error(f"holds no matrix: {error}") from None
        try:
            return shaped(values, dims, channels)
        except ValueError as error:
            raise self.error(str(error)) from None
