"""Tables of foreign Arrow files: bytes in, checked columns out.

`read_feather` and `read_parquet` return a `ArrowTable`, whose methods give columns as numpy arrays;
`ParquetRows` streams a parquet file that is too large for memory; `check_batches` checks an Arrow
file that another library is about to read. For each of them holds:

- What the file would take in memory is worked out from its metadata, checked against a limit,
  before any of it is decoded: compressed buffers of feather, pages and dictionaries of parquet.
- Every decoded table is validated in full: offsets, lengths, dictionary indices and UTF-8.
- Whatever Arrow raises is one `InputError` that names the file.

`read_npy` and `read_npz` do the same for arrays of numpy.
"""

from recast.tables.arrow import ROW_LIMIT, ArrowTable, check_batches, read_feather
from recast.tables.npy import npz_array, npz_names, open_npz, read_npy, read_npz
from recast.tables.parquet import ParquetRows, read_parquet, write_parquet

__all__ = [
    "ROW_LIMIT",
    "ArrowTable",
    "ParquetRows",
    "check_batches",
    "npz_array",
    "npz_names",
    "open_npz",
    "read_feather",
    "read_npy",
    "read_npz",
    "read_parquet",
    "write_parquet",
]
