"""A loss of one's own: one class in the list is trained and told."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from recast.logs import DrivingLog
from recast.reconstruction import TrainingStatus, train_scene
from recast.reconstruction.losses import LOSS_TERMS, Drawing, LossTerm
from recast.reconstruction.views import Level
from support.tiny_street import TINY

SHORT = TINY.model_copy(
    update={"iterations": 10, "sweep_points": 0, "densify_every": 100, "evaluate_every": 10}
)


class DarknessTerm(LossTerm):
    """Draws everything black."""

    name = "darkness"
    weight = 50.0

    def value(self, drawing: Drawing, view: Level) -> torch.Tensor:
        return drawing.image.mean()


def test_a_term_of_ones_own_is_trained_and_told(
    tiny_log: DrivingLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain: list[TrainingStatus] = []
    usual = train_scene(tiny_log, tmp_path / "usual", SHORT, progress=plain.append)
    monkeypatch.setattr("recast.reconstruction.step.LOSS_TERMS", [*LOSS_TERMS, DarknessTerm])
    told: list[TrainingStatus] = []
    dark = train_scene(tiny_log, tmp_path / "dark", SHORT, progress=told.append)
    before, after = (result.scene.background.sh[:, 0].mean().item() for result in (usual, dark))
    assert after < before - 0.02
    assert set(plain[-1].terms) == {"photometric", "depth", "sky", "solid", "exposure"}
    assert set(told[-1].terms) == {*plain[-1].terms, "darkness"}
    assert told[-1].terms["darkness"] > 0


def test_the_terms_add_up_to_the_loss_and_have_names_of_their_own(
    tiny_log: DrivingLog, tmp_path: Path
) -> None:
    told: list[TrainingStatus] = []
    one = SHORT.model_copy(update={"iterations": 1, "evaluate_every": 1})
    train_scene(tiny_log, tmp_path / "scene", one, progress=told.append)
    assert told[-1].loss == pytest.approx(sum(told[-1].terms.values()), rel=1e-6)
    assert len({term.name for term in LOSS_TERMS}) == len(LOSS_TERMS)
