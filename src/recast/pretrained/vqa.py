"""VQAScore (Lin et al. 2024): how probable a network finds it that a picture shows a text.

The seam, and what stands behind it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.errors import InputError
from recast.plugins import Registry
from recast.pretrained.pictures import Picture

Array = NDArray[np.float64]


class VqaScorer(Protocol):
    """A network that answers yes or no to a question about a picture.

    Scores of different networks do not compare, so that results name theirs.

    Attributes:
        name: of the network, for results.
    """

    name: str

    def score(self, images: Sequence[Picture], texts: Sequence[str]) -> Array:
        """(N, M) in [0, 1]: how probable it is that image n, (H, W, 3) RGB, shows text m."""


VQA_SCORERS = Registry(
    "VQA scorer",
    "recast.vqa_scorers",
    {},
    members=("name", "score"),
    protocol="recast.pretrained.VqaScorer",
    folder="recast.pretrained.clip_t5_load:load_clip_t5",
    prefixes={"t2v_metrics:": "recast.pretrained.vqa:T2vMetrics"},
)
"""Each is a class or function that makes a `VqaScorer`; it may take the option `device`."""


def load_vqa_scorer(value: Any, device: str = "cpu", dtype: str | None = None) -> VqaScorer:
    """The scorer that a value stands for.

    Args:
        value: a folder of CLIP-FlanT5 (see `load_clip_t5`), `t2v_metrics:MODEL` (see `T2vMetrics`),
            a name of the entry-point group `recast.vqa_scorers`, "module:attribute", or a scorer.
        device, dtype: given to the code that makes the scorer, if it takes them.

    Raises:
        InputError: see `Registry.resolve`.
    """
    scorer: VqaScorer = VQA_SCORERS.resolve(value, device=device, dtype=dtype)
    return scorer


def checked_scores(scores: Any, images: int, texts: int, name: str) -> Array:
    """(images, texts) what a scorer returned, in float64.

    Raises:
        InputError: another shape, or a value outside of [0, 1].
    """
    found = np.asarray(scores, np.float64)
    if found.shape != (images, texts):
        problem = f"have shape {found.shape}, not {(images, texts)}"
    elif not np.all((found >= 0) & (found <= 1)):
        problem = "are not all in [0, 1]"
    else:
        return found
    raise InputError(name, "scores", problem, "see recast.pretrained.VqaScorer")


class T2vMetrics:
    """The scorers of the authors' package t2v_metrics, which the user installs.

    The package reads its weights from the cache of Hugging Face and downloads what is missing;
    HF_HUB_OFFLINE=1 forbids that. It takes files, so that pictures are written to a temporary
    folder, as PNG. What has been run: a stand-in with the interface of `t2v_metrics.VQAScore`.

    Args:
        model: one of its names.
        device: torch device.

    Raises:
        InputError: the package is not installed.
    """

    def __init__(self, model: str = "clip-flant5-xxl", device: str = "cuda") -> None:
        self.name = f"t2v_metrics:{model}"
        try:
            package = import_module("t2v_metrics")
        except ImportError as error:
            raise InputError(
                self.name, "package", f"cannot be imported ({error})",
                "pip install t2v-metrics, or give a folder of zhiqiulin/clip-flant5-xxl",
            ) from error  # fmt: skip
        self._score = package.VQAScore(model=model, device=device)

    def score(self, images: Sequence[Picture], texts: Sequence[str]) -> Array:
        """See `VqaScorer.score`.

        Raises:
            InputError: the package returns something else than such scores.
        """
        if not images or not texts:
            return np.empty((len(images), len(texts)))
        with tempfile.TemporaryDirectory(prefix="recast-vqa-") as folder:
            paths = [str(Path(folder) / f"{index}.png") for index in range(len(images))]
            for path, image in zip(paths, images, strict=True):
                Image.fromarray(image).save(path)
            scores = self._score(images=paths, texts=list(texts))
        return checked_scores(scores.detach().float().cpu(), len(images), len(texts), self.name)
