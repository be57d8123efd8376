"""Sample sheets of a stage in training: the same held-out vehicles, views and noise throughout."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import torch

from recast.recar.picture import Image
from recast.recar.targets import TargetCache
from recast.recar.training.sheet import SheetRow, sample_sheet
from recast.recar.training.state import TrainingState
from recast.recar.training.tokens import ConditionTokens, View
from recast.storage import write_bytes
from recast.trellis import ImageTo3D
from recast.trellis.sparse import SparseTensor

_SEED = 20_260


class StageSheets:
    """Draws a sheet after every so many steps, with the weights that would be written then.

    Args:
        model: whose flow is in training.
        targets: cache of targets.
        identities: held-out vehicles, a row each.
        tokens: of their pictures.
        stem: of the files: path without the step.
        every: steps between sheets.
        average: whether the moving average is what is written.
    """

    def __init__(
        self, model: ImageTo3D, targets: TargetCache, identities: Sequence[str],
        tokens: ConditionTokens, stem: Path, every: int, average: bool,
    ) -> None:  # fmt: skip
        self._model, self._targets, self._tokens = model, targets, tokens
        self._stem, self._every, self._average = stem, every, average
        rng = np.random.default_rng(_SEED)
        self._rows = [self._row(one, rng) for one in identities]

    def __call__(self, state: TrainingState) -> None:
        """Draw a sheet where one is due."""
        if state.step % self._every:
            return
        with _written_weights(state, average=self._average):
            sheet = sample_sheet(self._model, self._rows, _SEED)
        path = self._stem.with_name(f"{self._stem.name}-{state.step:07d}.png")
        write_bytes(path, _png(sheet))

    def _row(self, identity: str, rng: np.random.Generator) -> SheetRow:
        source = self._tokens.source
        view = View(identity, int(rng.integers(source.count(identity))))
        target, device = self._targets.target(identity), self._model.device
        latent = SparseTensor.stack(
            [torch.from_numpy(target.coords).to(device)],
            [torch.from_numpy(target.latent).to(device)],
        )
        return SheetRow(
            identity, self._tokens.crop(view, None, rng), source.picture(identity, view.index),
            self._model.decode(latent)[0].to("cpu"),
        )  # fmt: skip


@contextmanager
def _written_weights(state: TrainingState, *, average: bool) -> Iterator[None]:
    """The weights that would be written now; those in training are put back to the bit."""
    if not average:
        yield
        return
    kept = {n: {k: v.clone() for k, v in m.state_dict().items()} for n, m in state.modules.items()}
    for name, one in state.averages.items():
        one.copy_to(state.modules[name])
    try:
        yield
    finally:
        for name, module in state.modules.items():
            module.load_state_dict(kept[name])


def _png(sheet: Image) -> bytes:
    written, data = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    assert written
    return data.tobytes()
