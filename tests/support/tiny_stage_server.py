"""What a server that forks training processes imports first: all that they would, seconds."""

import torch
from transformers import Dinov2WithRegistersConfig, Dinov2WithRegistersModel

from support import tiny_stage

# The first optimiser imports torch's compiler.
torch.optim.AdamW([torch.zeros(1, requires_grad=True)]).step()

__all__ = ["Dinov2WithRegistersConfig", "Dinov2WithRegistersModel", "tiny_stage"]
