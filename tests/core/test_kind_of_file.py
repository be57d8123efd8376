"""Files that are something else than they should be: messages name what they are."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import feather, parquet

from recast.core.errors import InputError
from recast.core.files import kind_of_file, read_json, read_text
from recast.core.table_files import read_feather, read_parquet

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n"


def _tar() -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a"), io.BytesIO())
    return out.getvalue()


def _zip() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("a", "b")
    return out.getvalue()


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"", "empty"),
        (_tar(), "a tar archive"),
        (_zip(), "a zip archive"),
        (POINTER, "a pointer of Git LFS (git lfs pull downloads the file itself)"),
        (b"\n <!DOCTYPE html><p>404", "a web page"),
        (b"\xef\xbb\xbf<HTML>", "a web page"),
        (b"0 1 2", ""),
    ],
)
def test_kinds(data: bytes, kind: str) -> None:
    assert kind_of_file(data) == kind


def test_readers_name_what_a_file_is(tmp_path: Path) -> None:
    table = pa.table({"x": [1.0]})
    parquet.write_table(table, tmp_path / "parquet")
    feather.write_feather(table, str(tmp_path / "feather"))
    (tmp_path / "pointer").write_bytes(POINTER)
    (tmp_path / "zip").write_bytes(_zip() + b"\xff")
    for read, name, kind in (
        (lambda path: read_feather(path, ["x"], "mend"), "parquet", "a parquet file"),
        (lambda path: read_parquet(path, ["x"], "mend"), "feather", "a feather file"),
        (lambda path: read_feather(path, ["x"], "mend"), "pointer", "a pointer of Git LFS"),
        (read_json, "pointer", "a pointer of Git LFS"),
        (read_text, "zip", "a zip archive"),
    ):
        with pytest.raises(InputError) as raised:
            read(tmp_path / name)
        assert kind in str(raised.value)
