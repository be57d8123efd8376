"""Every class that a checkpoint folder may name: the six networks and the image encoders."""

from __future__ import annotations

from collections.abc import Mapping

from recast.trellis.conditioning import CompactImageEncoder, Dinov2Encoder
from recast.trellis.models import MODELS
from recast.trellis.models.base import TrellisModel

MODEL_CLASSES: Mapping[str, type[TrellisModel]] = {
    **MODELS,
    Dinov2Encoder.published_name: Dinov2Encoder,
    CompactImageEncoder.published_name: CompactImageEncoder,
}
"""By published name; give it to `recast.trellis.models.build`."""
