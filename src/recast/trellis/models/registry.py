"""Networks by the class names of published checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.trellis.models.base import TrellisModel
from recast.trellis.models.flow_transformer import SLatFlowModel, SparseStructureFlowModel
from recast.trellis.models.slat_vae import SLatEncoder, SLatGaussianDecoder
from recast.trellis.models.ss_vae import SparseStructureDecoder, SparseStructureEncoder

MODELS: dict[str, type[TrellisModel]] = {
    model.published_name: model
    for model in (
        SparseStructureFlowModel,
        SparseStructureEncoder,
        SparseStructureDecoder,
        SLatFlowModel,
        SLatEncoder,
        SLatGaussianDecoder,
    )
}
"""The six networks by published name."""

# Training configurations name these classes with a controller of activation memory; their modules
# and weights are the same.
MODELS |= {
    f"Elastic{model.published_name}": model
    for model in (SLatFlowModel, SLatEncoder, SLatGaussianDecoder)
}


def model_class(
    name: str, where: str | Path, classes: Mapping[str, type[TrellisModel]] = MODELS
) -> type[TrellisModel]:
    """The network of a class name.

    Args:
        name: published name, such as "SLatFlowModel" or "ElasticSLatFlowModel".
        where: the file that holds the name, for the message.
        classes: networks to choose from.

    Raises:
        InputError: no such network.
    """
    if name not in classes:
        known = ", ".join(sorted(other for other in classes if not other.startswith("Elastic")))
        raise InputError(where, "name", f"{name!r} is no known network", f"choose one of {known}")
    return classes[name]


def build(
    name: str,
    args: Any,
    where: str | Path,
    classes: Mapping[str, type[TrellisModel]] = MODELS,
) -> TrellisModel:
    """A new network from its published configuration, `{"name": ..., "args": {...}}`.

    Args:
        name: see `model_class`.
        args: constructor arguments.
        where: the file that holds them, for the message.
        classes: networks to choose from.

    Raises:
        InputError: no such network, or an argument that is unknown, missing, wrong or makes layers
            too large to exist.
    """
    chosen = model_class(name, where, classes)
    mend = f"give the arguments of {chosen.published_name}"
    try:
        return chosen(chosen.config_class.model_validate(args))
    except ValidationError as error:
        raise validation_error(where, error, mend) from None
    except (RuntimeError, ValueError, TypeError, OverflowError) as error:  # of torch's layers
        reason = str(error).partition("\n")[0]
        raise InputError(where, "args", f"make no network ({reason})", mend) from None
