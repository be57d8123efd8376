"""A model folder in the published layout, made of the golden tiny networks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from support.trellis import FOLDER, golden_config, golden_tensors

# Role to golden network; the golden end-to-end case was made with the first four.
GOLDEN_MODELS = {
    "sparse_structure_flow_model": "ss_flow",
    "sparse_structure_decoder": "ss_dec",
    "slat_flow_model": "slat_flow",
    "slat_decoder_gs": "slat_dec_gs",
    "sparse_structure_encoder": "ss_enc",
    "slat_encoder": "slat_enc",
    "image_encoder": "dinov2_tiny",
}


def write_golden_model(folder: Path) -> Path:
    """Write `pipeline.json` and `ckpts/` of the golden tiny networks; gives `folder` back.

    The samplers are those of the golden end-to-end case (6 and 4 steps, guidance 5 in [0.5, 1],
    time rescaling 3), its latent normalisation too.
    """
    (folder / "ckpts").mkdir(parents=True)
    for name in GOLDEN_MODELS.values():
        config = golden_config(name)
        config["name"] = config["name"].removesuffix("(reg)")
        (folder / "ckpts" / f"{name}.json").write_text(json.dumps(config, indent=4))
        shutil.copyfile(FOLDER / f"{name}.safetensors", folder / "ckpts" / f"{name}.safetensors")
    (folder / "pipeline.json").write_text(json.dumps(golden_pipeline(), indent=4))
    return folder


def golden_pipeline() -> dict[str, Any]:
    """The `pipeline.json` of the golden networks."""
    case = golden_tensors("e2e_tiny")
    return {
        "name": "TrellisImageTo3DPipeline",
        "args": {
            "models": {role: f"ckpts/{name}" for role, name in GOLDEN_MODELS.items()},
            "sparse_structure_sampler": _sampler(steps=6),
            "slat_sampler": _sampler(steps=4),
            "slat_normalization": {
                "mean": case["mean"].flatten().tolist(),
                "std": case["std"].flatten().tolist(),
            },
            "image_cond_model": "image_encoder",
        },
    }


def _sampler(steps: int) -> dict[str, Any]:
    return {
        "name": "FlowEulerGuidanceIntervalSampler",
        "args": {"sigma_min": 1e-5},
        "params": {
            "steps": steps,
            "cfg_strength": 5.0,
            "cfg_interval": [0.5, 1.0],
            "rescale_t": 3.0,
        },
    }
