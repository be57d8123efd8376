"""A grid on a Ray cluster of three nodes whose workers share no folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from recast.cli.main import main

FILES = ("rollouts.parquet", "results.json", "bench.json")
OPTIONS = (
    *("--motions", "advancing-a", "--steps", "10", "--iterations", "4", "--scale", "0.5"),
    *("--arm", "native", "--arm", "template", "--refine", "False"),
)


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of three nodes of one core each."""
    ray: Any = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster  # type: ignore[import-untyped]

    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    for _ in range(2):
        made.add_node(num_cpus=1)
    try:
        yield made.address
    finally:
        ray.shutdown()
        made.shutdown()


@pytest.mark.slow
def test_three_nodes_give_the_same_bytes(
    cluster: str, tiny_log_folder: Path, tmp_path: Path
) -> None:
    scenes = [f"{tiny_log_folder}:0", f"{tiny_log_folder}:1"]
    command = ["bench", "closed-loop", "--scenes", *scenes, *OPTIONS, "--films"]
    command += ["--samples", "100"]
    assert main([*command, "--out", str(tmp_path / "here" / "grid")]) == 0
    there = [*command, "--out", str(tmp_path / "there" / "grid"), "--ray", cluster]
    assert main([*there, "--workers", "3"]) == 0
    for name in FILES:
        here = (tmp_path / "here" / "grid" / name).read_bytes()
        assert (tmp_path / "there" / "grid" / name).read_bytes() == here, name
    made = list((tmp_path / "there" / "store").rglob("artefact.json"))
    before = {path: path.stat().st_mtime_ns for path in made}
    assert len(before) > 8
    assert main([*there, "--workers", "3"]) == 0  # nothing is made twice
    assert {path: path.stat().st_mtime_ns for path in made} == before


@pytest.mark.slow
def test_three_nodes_measure_the_same_images(
    cluster: str, tiny_log_folder: Path, tmp_path: Path
) -> None:
    scenes = [f"{tiny_log_folder}:0", f"{tiny_log_folder}:1"]
    command = ["bench", "scene-level", "--scenes", *scenes, *OPTIONS]
    command += ["--samples", "200", "--frechet-samples", "20", "--least-px", "4", "--every", "2"]
    assert main([*command, "--out", str(tmp_path / "here" / "grid")]) == 0
    there = [*command, "--out", str(tmp_path / "there" / "grid"), "--ray", cluster]
    assert main([*there, "--workers", "3"]) == 0
    for name in ("scene_level.parquet", "results.json", "table.md", "figure_advancing.png"):
        here = (tmp_path / "here" / "grid" / name).read_bytes()
        assert (tmp_path / "there" / "grid" / name).read_bytes() == here, name


@pytest.mark.slow
def test_three_nodes_try_the_same_trials(
    cluster: str, tiny_log_folder: Path, tmp_path: Path
) -> None:
    command = ["search", f"{tiny_log_folder}:0", *OPTIONS[2:], "--motion", "advancing-a"]
    command += ["--over", "gap=1:4", "--over", "speed=0.2:0.6", "--trials", "20"]
    assert main([*command, "--out", str(tmp_path / "here" / "study")]) == 0
    there = [*command, "--out", str(tmp_path / "there" / "study"), "--ray", cluster]
    assert main([*there, "--workers", "3"]) == 0
    for name in ("trials.parquet", "results.json"):
        here = (tmp_path / "here" / "study" / name).read_bytes()
        assert (tmp_path / "there" / "study" / name).read_bytes() == here, name
