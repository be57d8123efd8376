"""The README's picture, from a demo's run: one view drawn with both vehicles and the truth.

python tools/figures/three_ways.py runs/demo/run
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot
from PIL import Image

OUT = Path(__file__).parents[2] / "docs" / "images" / "three-ways.jpg"
NAMES = {
    "baseline": "reconstructed from the log",
    "candidate": "replaced by recast",
    "truth": "truth",
}


def main(run: Path) -> None:
    """Write the picture from the folder that compares a run's vehicles with the truth."""
    folder = run / "truth" / "replaced" / "views"
    record = json.loads((folder / "oracle_views.json").read_text())
    view = next(one for one in record["views"] if one["index"] == record["showcase"])
    figure, axes = pyplot.subplots(1, 3, figsize=(12, 3.1), layout="constrained")
    for axis, (key, name) in zip(axes, NAMES.items(), strict=True):
        axis.imshow(Image.open(folder / f"showcase_{key}.png"))
        score = view.get(key)
        axis.set_title(name if score is None else f"{name}: {score['psnr']:.1f} dB", fontsize=13)
        axis.axis("off")
    figure.savefig(OUT, dpi=110, bbox_inches="tight", pil_kwargs={"quality": 88})
    print(f"wrote {OUT}, seen {view['angle']:.0f} degrees from the nearest logged image")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
