"""`recast trellis verify` and `export`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from recast.cli.main import main
from recast.trellis import ImageTo3D
from recast.trellis.checkpoints import first_fault, verify_checkpoint
from support.trellis_folder import write_golden_model


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_golden_model(tmp_path / "model")


def refused(capsys: pytest.CaptureFixture[str], *args: str | Path) -> tuple[str, str]:
    """What is printed, and the one line on stderr."""
    assert main(["trellis", "verify", *map(str, args)]) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("recast: ")
    return captured.out, lines[0]


def test_a_sound_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trellis", "verify", str(folder)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.count(": ok") == 7
    assert "86/86" in captured.out
    assert "1,823,392 expected" in captured.out


def test_a_missing_weights_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "ckpts/ss_flow.safetensors").unlink()
    out, line = refused(capsys, folder)
    assert out.count(": ok") == 6
    assert "ckpts/ss_flow.safetensors is not in the folder" in line


def test_values_are_read_where_asked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder / "ckpts/ss_dec.safetensors"
    data = bytearray(path.read_bytes())
    data[-4:] = b"\xff\xff\xff\xff"  # a NaN
    path.write_bytes(data)
    assert main(["trellis", "verify", str(folder)]) == 0
    capsys.readouterr()
    out, line = refused(capsys, folder, "--values")
    assert "holds NaN or infinite values" in line
    assert "not finite: out_layer.2.weight" in out


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda p: p["args"]["models"].update(slat_encoder="../secret"),
            "is not a path inside the folder",
        ),
        (lambda p: p.update(args=1), "args"),
    ],
)
def test_a_wrong_pipeline(folder: Path, capsys, spoil, message: str) -> None:
    path = folder / "pipeline.json"
    pipeline = json.loads(path.read_text())
    spoil(pipeline)
    path.write_text(json.dumps(pipeline))
    out, line = refused(capsys, folder)
    assert out == ""
    assert message in line


def test_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere: does not exist" in refused(capsys, tmp_path / "nowhere")[1]


def test_an_exported_model_is_half_as_large_and_makes_almost_the_same(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "half"
    assert main(["trellis", "export", str(folder), "--out", str(out)]) == 0
    assert f"wrote {out}: " in capsys.readouterr().out
    assert first_fault(verify_checkpoint(out, values=True)) is None
    names = {"ss_flow", "ss_dec", "slat_flow", "slat_dec_gs", "dinov2_tiny"}
    assert {path.stem for path in (out / "ckpts").iterdir()} == names
    whole = (folder / "ckpts/ss_flow.safetensors").stat().st_size
    assert (out / "ckpts/ss_flow.safetensors").stat().st_size < 0.7 * whole
    noise = torch.zeros(1, *ImageTo3D.load(folder).structure_shape)
    cond = torch.ones(1, 3, 48)
    models = [ImageTo3D.load(one, device="cpu") for one in (folder, out)]
    ways = [one.structure_flow(noise, torch.ones(1), cond) for one in models]
    torch.testing.assert_close(ways[0], ways[1], rtol=0.02, atol=0.02)
    assert main(["trellis", "export", str(folder), "--out", str(out)]) == 2
    assert "half" in capsys.readouterr().err
