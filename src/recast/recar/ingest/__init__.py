"""Making a vehicle set of photographs: a folder for each vehicle, and a table about them.

    PHOTOS/vehicles.csv (or vehicles.json)
    PHOTOS/ID/001.jpg, 002.jpg, ...    in order of azimuth

Or walk-arounds at irregular azimuths with poses, see `recast.recar.ingest.walkaround`. See
docs/recar.md.
"""

from recast.recar.ingest.duplicates import DUPLICATE_BITS, perceptual_hash
from recast.recar.ingest.ingest import IngestReport, ingest_photographs
from recast.recar.ingest.photograph import PhotographCutout, PhotographMasker
from recast.recar.ingest.settings import EXPERIMENTAL, LAYOUTS, IngestSettings

__all__ = [
    "DUPLICATE_BITS",
    "EXPERIMENTAL",
    "LAYOUTS",
    "IngestReport",
    "IngestSettings",
    "PhotographCutout",
    "PhotographMasker",
    "ingest_photographs",
    "perceptual_hash",
]
