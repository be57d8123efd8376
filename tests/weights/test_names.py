"""Names of weights in place of folders and files, conversions, and the command line."""

from __future__ import annotations

import pickle
import sys
from functools import partial
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from recast.actors import GENERATORS, segmenter_of
from recast.actors.generate import ImageTo3DGenerator
from recast.actors.grounded_segmenter import GroundedSamSegmenter
from recast.cli.main import main
from recast.core.artefact import folder_hash
from recast.core.errors import InputError
from recast.planning import PLANNERS, make_planner
from recast.planning.gtrs import load_checkpoint, new_model, write_vocabulary
from recast.planning.gtrs.planner import PREFIX
from recast.runs.sources import generator_source, planner_source, segmenter_source
from recast.weights import (
    PUBLISHED,
    Licence,
    Weights,
    WeightsSource,
    located,
    place,
    weights_folder,
)
from recast.weights.fetch import fetch
from recast.weights.table import read_weights_record
from support.tiny_gtrs import TINY, fan
from support.tiny_networks import write_tiny_networks
from support.trellis_folder import write_golden_model
from weights.hub import MIT, Content, Hub, entry, sha256


def publish(hub: Hub, folder: Path, repository: str, into: str = "") -> WeightsSource:
    """Put all files of a folder on the hub."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    files: dict[str, Content] = {path.relative_to(folder).as_posix(): path for path in paths}
    return WeightsSource(repository, tuple(files), MIT, hub.commit(repository, files), into=into)


def told(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Exit code, and what was printed or the one line of an error."""
    capsys.readouterr()
    code = main(["weights", *words])
    captured = capsys.readouterr()
    assert code == 0 or len(captured.err.splitlines()) == 1, captured.err
    return code, " ".join((captured.err if code else captured.out).split())


def test_a_generator_by_name(hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = publish(hub, write_golden_model(tmp_path / "model"), "someone/tiny-trellis")
    weights = Weights("trellis", "tests", ("--generator", "--model"), 0.1, (source,), "generator")
    monkeypatch.setitem(PUBLISHED, "trellis", weights)  # type: ignore[arg-type]
    line = "weights: trellis: are not downloaded; run `recast weights get trellis`"
    for ask in (GENERATORS.resolve, generator_source, partial(GENERATORS.takes, option="axes")):
        with pytest.raises(InputError) as caught:
            ask("trellis")
        assert str(caught.value) == line
    folder = fetch(weights)
    generator = GENERATORS.resolve("trellis", axes="x,z")
    assert isinstance(generator, ImageTo3DGenerator) and generator.axes.declares_front
    assert generator.folder == folder == weights_folder("trellis")
    assert generator_source("trellis") == folder_hash(folder)
    (folder / "pipeline.json").write_text("{}")
    with pytest.raises(InputError, match="changed after trellis was downloaded"):
        GENERATORS.resolve("trellis")
    with pytest.raises(InputError, match="trellis: is not known"):
        PLANNERS.resolve("trellis")


def test_a_folder_of_that_name_is_written_with_a_dot(
    hub: Hub, toy: Weights, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here" / "toy").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    assert GENERATORS.place("./toy") == Path("toy")
    assert GENERATORS.place(Path("toy")) == Path("toy")
    with pytest.raises(InputError, match="weights: toy: are not downloaded"):
        GENERATORS.place("toy")
    assert located("--generator", Path("toy")) == Path("toy"), "options that take paths"


def test_a_segmenter_by_name(hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    networks = write_tiny_networks(tmp_path / "networks")
    parts = [
        publish(hub, networks / name, f"someone/{name}", name) for name in ("grounding-dino", "sam")
    ]
    weights = Weights("grounded-sam", "tests", ("--segmenter",), 0.1, tuple(parts), "segmenter")
    monkeypatch.setitem(PUBLISHED, "grounded-sam", weights)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="run `recast weights get grounded-sam`"):
        segmenter_of("grounded-sam")
    folder = fetch(weights)
    segmenter = segmenter_of("grounded-sam")
    assert isinstance(segmenter, GroundedSamSegmenter)
    assert segmenter.sam.path == folder / "sam"
    assert segmenter_source("grounded-sam") == folder_hash(folder)


def test_a_planner_by_name_is_converted_once(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = new_model(TINY, torch.Generator().manual_seed(0))
    state = {PREFIX + name: tensor for name, tensor in model.state_dict().items()}
    torch.save({"state_dict": state}, tmp_path / "gtrs_dense_vov.ckpt")
    write_vocabulary(tmp_path / "8192.npy", fan(20))
    real = PUBLISHED["gtrs-dense"]
    assert real.restricted and not real.pinned
    released = tmp_path / "gtrs_dense_vov.ckpt"
    hub.commit(real.sources[0].where, {released.name: released})
    vocabulary = (tmp_path / "8192.npy").read_bytes()
    hub.web[real.sources[1].address("8192.npy").partition("://")[2]] = vocabulary
    monkeypatch.setattr(
        "recast.planning.gtrs.planner.load_checkpoint", partial(load_checkpoint, config=TINY)
    )
    pinned = real.sources[1].sha256["8192.npy"]
    with pytest.raises(InputError, match=f"not {pinned[:20]}"):  # of the released vocabulary
        fetch(real, accepted=True)
    web = WeightsSource(
        real.sources[1].where, ("8192.npy",), MIT, sha256={"8192.npy": sha256(vocabulary)}
    )
    weights = Weights(
        "gtrs-dense",
        real.use,
        real.options,
        0.1,
        (real.sources[0], web),
        real.part,
        real.opens,
        real.converter,
        real.converted,
    )
    monkeypatch.setitem(PUBLISHED, "gtrs-dense", weights)  # type: ignore[arg-type]
    assert fetch(weights, accepted=True) == weights_folder("gtrs-dense", "planner")
    planner = make_planner("gtrs-dense", "cpu")
    assert planner.name == "gtrs-dense"
    assert planner_source("gtrs-dense") == folder_hash(weights_folder("gtrs-dense", "planner"))
    record = read_weights_record(weights_folder("gtrs-dense"))
    assert record.fetched[
        real.sources[0].address(released.name, record.revisions[real.sources[0].where])
    ].sha256 == sha256(released.read_bytes())
    assert sorted(record.files) == [
        f"planner/{name}" for name in ("config.json", "vocabulary.npy", "weights.safetensors")
    ]
    assert not (weights_folder("gtrs-dense") / released.name).exists()


def pickled_entry(hub: Hub, data: bytes) -> Weights:
    hub.commit("someone/pickle", {"config.json": b"{}", "pytorch_model.bin": data})
    return entry(
        WeightsSource("someone/pickle", ("config.json", "pytorch_model.bin"), MIT),
        name="pickle",
        converter="recast.weights.fetch:safetensors_of_pickle",
        converted=("pytorch_model.bin",),
    )


def test_a_pickle_becomes_safetensors(hub: Hub, tmp_path: Path) -> None:
    table = torch.randn(8, 4, generator=torch.Generator().manual_seed(0))
    state = {"a.weight": table, "tied.weight": table, "turned": table.T, "ids": torch.arange(9)}
    torch.save(state, tmp_path / "x.bin")
    folder = fetch(pickled_entry(hub, (tmp_path / "x.bin").read_bytes()))
    found = load_file(folder / "model.safetensors")
    assert found.keys() == state.keys()
    assert all(torch.equal(found[name], tensor) for name, tensor in state.items())
    record = read_weights_record(folder)
    assert sorted(record.files) == ["config.json", "model.safetensors"]
    assert record.converter == "recast.weights.fetch:safetensors_of_pickle"
    assert sha256((tmp_path / "x.bin").read_bytes()) in {f.sha256 for f in record.fetched.values()}
    assert sorted(p.name for p in folder.iterdir()) == [
        "config.json",
        "model.safetensors",
        "weights.json",
    ]


class Harm:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (sys.exit, ("code of a pickle was run",))


def test_a_pickle_with_code_is_refused(hub: Hub, tmp_path: Path) -> None:
    torch.save({"a": Harm()}, tmp_path / "x.bin")
    for data in ((tmp_path / "x.bin").read_bytes(), pickle.dumps({"a": Harm()}) + b" " * 2000):
        with pytest.raises(InputError, match=r"never unpickled|is damaged"):
            fetch(pickled_entry(hub, data))
        assert not weights_folder("pickle").exists()


def test_the_command_line(
    hub: Hub, toy: Weights, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert told(capsys, "path", "toy") == (
        2,
        "recast: weights: toy: are not downloaded; run `recast weights get toy`; "
        "see recast docs weights#names",
    )
    assert "no weights in" in told(capsys, "verify")[1]
    code, text = told(capsys, "get", "toy")
    assert code == 0 and text.startswith("someone/toy: MIT, https://example.org/mit toy: 2 files")
    folder = str(weights_folder("toy"))
    assert told(capsys, "path", "toy") == (0, folder)
    commit = next(iter(hub.repositories["someone/toy"]))
    monkeypatch.setenv("COLUMNS", "80")
    code, text = told(capsys, "list")
    assert f"someone/toy {commit}"[:40] in text and "pinned on first use" in text
    assert "pinned by recast" in text and "(to accept)" in text
    hub.stop()
    assert told(capsys, "get", "toy") == (0, f"toy is here: {folder}")
    assert told(capsys, "verify") == (0, "toy: 2 files, 0.00 GB, as downloaded")
    (weights_folder("toy") / "config.json").write_bytes(b'{"model": "tou"}')
    code, text = told(capsys, "verify", "toy")
    assert code == 2 and "changed after toy was downloaded" in text
    assert "is not a name of published weights" in told(capsys, "get", "tyo")[1]


@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("n", 2), (None, 2), ("--accept", 0)])
def test_terms_on_a_terminal_and_elsewhere(
    hub: Hub,
    toy: Weights,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    answer: str | None,
    code: int,
) -> None:
    terms = Licence("CC BY-NC 4.0", "https://example.org/terms", restricted=True)
    source = WeightsSource("someone/toy", ("config.json",), terms)
    monkeypatch.setitem(PUBLISHED, "toy", entry(source))  # type: ignore[arg-type]
    monkeypatch.setattr("sys.stdin.isatty", lambda: answer in ("y", "n"), raising=False)
    monkeypatch.setattr("builtins.input", lambda *text: answer)
    flags = ["--accept-licence"] if answer == "--accept" else []
    found, text = told(capsys, "get", "toy", *flags)
    assert found == code and ("--accept-licence" in text) is (code == 2)
    assert bool(hub.asked) is (code == 0)


def test_options_that_take_paths(
    hub: Hub, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for words in (
        ["actor", "generate", "car.png", "--model", "trellis", "--out", "x"],
        ["eval", "photographs", "set", "--out", "x", "--lpips-weights", "alexnet"],
        ["eval", "photographs", "set", "--out", "x", "--clip", "clip-vit-l14"],
        ["eval", "photographs", "set", "--out", "x", "--dino", "dinov2"],
        [
            "eval",
            "generation",
            "--model",
            "a=template",
            "--set",
            "set",
            "--out",
            "x",
            "--inception",
            "inception",
        ],
    ):
        assert main(words) == 2
        name = next(one for one in reversed(words) if one in PUBLISHED)
        line = f"recast: weights: {name}: are not downloaded; run `recast weights get {name}`"
        line += "; see recast docs weights#names"
        assert capsys.readouterr().err.splitlines() == [line]
    assert located("--clip", None) is None
    assert located("--clip", tmp_path) == tmp_path
    with pytest.raises(InputError, match="does not exist; give a path, or clip-vit-l14"):
        located("--clip", Path("alexnet"))  # weights for another option
    assert (located("--model", Path("recast-mini")) / "pipeline.json").is_file()
    assert (located("--start", Path("gtrs-mini")) / "config.json").is_file()
    with pytest.raises(InputError, match=r"did you mean recast-mini\?"):
        located("--model", Path("recast-mnii"))
    assert place("segmenter", "nothing") is None and place("planner", "trellis") is None
