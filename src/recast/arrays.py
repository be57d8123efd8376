"""Names of numpy array types, which all packages use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Int64Array = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8]
"""Colours (H, W, 3) or (H, W, 4), or grey (H, W)."""
Mask = NDArray[np.bool_]
"""Pixels (H, W)."""
