"""SPZ files: golden bytes, bounds of the quantisation, and every way a file can be wrong."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.splats import MIP, Gaussians
from recast.splats.gaussians import C0
from recast_bridges.splats.spz import read_low_pass, read_spz, write_spz
from support.splat_scenes import random_gaussians

HEADER = bytes.fromhex("4e475350 04000000 01000000 00 0c 00 05 20000000") + bytes(12)
LEGACY = bytes.fromhex("4e475350 03000000 01000000 00 0c 01 00")
# x = 1, y = -0.5, z = 0; opacity 1/2; grey; log deviations 0; no rotation (w is the largest).
FIELDS = bytes.fromhex("001000 00f8ff 000000  80  808080  a0a0a0  000000c0")


def one(degree: int = 0) -> Gaussians:
    return Gaussians(
        torch.tensor([[1.0, -0.5, 0.0]]),
        torch.tensor([[2.0, 0.0, 0.0, 0.0]]),
        torch.zeros(1, 3),
        torch.zeros(1),
        torch.zeros(1, (degree + 1) ** 2, 3),
    )


def unzipped(path: Path) -> bytes:
    return zlib.decompress(path.read_bytes(), 16 + zlib.MAX_WBITS)


def zipped(path: Path, data: bytes) -> Path:
    packer = zlib.compressobj(wbits=16 + zlib.MAX_WBITS)
    path.write_bytes(packer.compress(data) + packer.flush())
    return path


def test_golden_bytes(tmp_path: Path) -> None:
    write_spz(tmp_path / "a.spz", one(), version=4)
    data = (tmp_path / "a.spz").read_bytes()
    assert data[:32] == HEADER
    table = struct.unpack_from("<10Q", data, 32)
    assert table[1::2] == (9, 1, 3, 3, 4) and len(data) == 32 + 80 + sum(table[::2])
    write_spz(tmp_path / "b.spz", one(), MIP, version=3)
    assert unzipped(tmp_path / "b.spz") == LEGACY + FIELDS
    assert read_low_pass(tmp_path / "b.spz") == MIP
    assert read_low_pass(tmp_path / "a.spz") is None


def test_a_file_of_version_2(tmp_path: Path) -> None:
    """Its rotations are x, y and z in a byte each: here half a turn around x, nearly."""
    header = LEGACY.replace(b"\x03", b"\x02", 1)
    read = read_spz(zipped(tmp_path / "a.spz", header + FIELDS[:-4] + bytes([255, 128, 127])))
    assert read.means.tolist() == [[1.0, -0.5, 0.0]]
    assert torch.allclose(read.quats[0].abs(), torch.tensor([0, 1, 1 / 255, 1 / 255]), atol=1e-6)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_quantisation_bounds(tmp_path: Path, version: int, degree: int) -> None:
    gaussians = random_gaussians("normal", count=400, degree=degree)
    gaussians = replace(gaussians, sh=gaussians.sh.clamp(-0.9, 0.9))
    write_spz(tmp_path / "a.spz", gaussians, version=version)  # type: ignore[arg-type]
    read = read_spz(tmp_path / "a.spz")
    rounding = 1e-6
    off = {name: (value - getattr(gaussians, name)).abs() for name, value in vars(read).items()}
    assert off["means"].max() <= 2**-13
    assert off["log_scales"].max() <= 1 / 32 + rounding
    opacities = read.logit_opacities.sigmoid() - gaussians.logit_opacities.sigmoid()
    assert opacities.abs().max() <= 1 / 510 + rounding
    assert off["sh"][:, 0].max() <= 1 / 76.5 + rounding
    assert degree < 1 or off["sh"][:, 1:4].max() <= 4.5 / 128 + rounding
    assert degree < 2 or off["sh"][:, 4:].max() <= 8.5 / 128 + rounding
    quats = gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)
    apart = (quats * (quats * read.quats).sum(dim=1, keepdim=True).sign() - read.quats).abs()
    largest = quats.abs().argmax(dim=1, keepdim=True)
    step = 0.5 * 0.5**0.5 / 511
    # The largest follows from the rest: l dl = sum q dq, with l >= 1/2 and |q| adding up to 3/2.
    assert apart.gather(1, largest).max() <= 3.1 * step
    assert apart.scatter(1, largest, 0.0).max() <= step + rounding


def test_what_lies_far_out_gets_fewer_fractional_bits(tmp_path: Path) -> None:
    far = replace(one(), means=torch.tensor([[5000.3, -8191.9, 0.1]]))
    write_spz(tmp_path / "a.spz", far, version=3)
    assert unzipped(tmp_path / "a.spz")[13] == 10
    assert (read_spz(tmp_path / "a.spz").means - far.means).abs().max() <= 2**-11
    with pytest.raises(InputError, match="leave out Gaussians that far"):
        write_spz(tmp_path / "b.spz", replace(one(), means=torch.full((1, 3), 1e7)))


def test_numbers_beyond_a_range_are_clipped(tmp_path: Path) -> None:
    extreme = replace(
        one(1),
        log_scales=torch.tensor([[-50.0, 0.0, 13.0]]),
        logit_opacities=torch.tensor([60.0]),
        sh=torch.tensor([[[9.0] * 3, [-7.0] * 3, [7.0] * 3, [0.0] * 3]]),
    )
    write_spz(tmp_path / "a.spz", extreme)
    read = read_spz(tmp_path / "a.spz")
    assert read.log_scales.tolist() == [[-10.0, 0.0, 255 / 16 - 10]]
    assert 1 - 1 / 510 <= float(read.logit_opacities.sigmoid()) < 1
    assert read.sh[0, :, 0].tolist() == pytest.approx([0.5 / 0.15, -1, 127 / 128, 0])
    assert float(read.sh[0, 0, 0]) * C0 + 0.5 > 1.4


def test_no_gaussians_at_all(tmp_path: Path) -> None:
    nothing = one().select(torch.zeros(0, dtype=torch.int64))
    for version in (3, 4):
        write_spz(tmp_path / "a.spz", nothing, version=version)  # type: ignore[arg-type]
        assert len(read_spz(tmp_path / "a.spz")) == 0


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (b"NGSX" + HEADER[4:], "is not that of an SPZ file"),
        (HEADER[:15], "is not that of an SPZ file"),
        (HEADER[:12] + b"\x04" + HEADER[13:], "degree 4"),
        (HEADER[:8] + b"\xff\xff\xff\xff" + HEADER[12:], "4294967295 Gaussians"),
        (HEADER[:4] + b"\x09" + HEADER[5:], "version 9"),
        (HEADER[:14] + b"\x02" + HEADER[15:], "extensions"),
        (HEADER[:15] + b"\x06" + HEADER[16:], "another number of streams"),
        (HEADER, "no table"),
        (HEADER + struct.pack("<10Q", *[5, 1 << 60] * 5), "for 1152921504606846976, expected 9"),
        (HEADER + struct.pack("<10Q", 5, 9, *[5, 1] * 4) + b"abcde" * 5, "stream 0"),
        (LEGACY + FIELDS, "without gzip"),
    ],
)
def test_broken_files(tmp_path: Path, data: bytes, line: str) -> None:
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(InputError, match=line):
        read_spz(tmp_path / "a.spz")


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (LEGACY + FIELDS[:-1], "19 of 20 bytes"),
        (LEGACY[:4] + b"\x01" + LEGACY[5:] + FIELDS, "version 1"),
        (LEGACY[:4] + b"\x04" + LEGACY[5:] + FIELDS, "version 4"),
        (LEGACY[:8] + struct.pack("<I", 10_000_000) + LEGACY[12:] + FIELDS, "of 200000000 bytes"),
    ],
)
def test_broken_zipped_files(tmp_path: Path, data: bytes, line: str) -> None:
    with pytest.raises(InputError, match=line):
        read_spz(zipped(tmp_path / "a.spz", data))
    whole = zipped(tmp_path / "b.spz", LEGACY + FIELDS).read_bytes()
    (tmp_path / "b.spz").write_bytes(whole[:20] + b"\xff" * 8 + whole[28:])
    with pytest.raises(InputError):
        read_spz(tmp_path / "b.spz")


def test_no_more_is_unzipped_than_the_header_says(tmp_path: Path) -> None:
    """A megabyte of file that would become a gigabyte: the rest of it is never looked at."""
    path = zipped(tmp_path / "a.spz", LEGACY + FIELDS + bytes(1 << 26))
    assert np.isfinite(read_spz(path).means.numpy()).all() and len(read_spz(path)) == 1
