"""What cameras beside a synthetic drive truly see."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from recast.scene import ShiftedView
from recast.synthetic import Oracle, World
from recast.synthetic.oracle_pool import OraclePool
from recast.synthetic.rig import exposure, sensor_number

Image = NDArray[np.uint8]

_STREAM = 801


class ShiftedTruth:
    """Ray-traces shifted views, each camera with the exposure it has in the log.

    Close it, or use it as a context manager: it may hold processes.

    Args:
        world: of the log, see `recast.synthetic.world_of`.
        workers: processes; 0 for one for each core, 1 for none but this one.

    Raises:
        InputError: workers is negative, or embreex is not installed.
    """

    def __init__(self, world: World, workers: int = 0) -> None:
        self._pool = OraclePool(world, workers)

    def __call__(self, views: Sequence[ShiftedView]) -> Iterator[Image]:
        """(H, W, 3) uint8 of each view; moving vehicles are where they were."""
        return self._pool.map(_render, views)

    def __enter__(self) -> Self:
        """Nothing starts before it is needed."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the processes."""
        self._pool.close()


def _render(oracle: Oracle, view: ShiftedView) -> Image:
    seed, camera = oracle.world.seed, view.camera_name
    frame = oracle.render(
        view.camera,
        view.world_from_camera,
        timestamp_us=view.timestamp_us,
        exposure=exposure(seed, camera),
        rng=np.random.default_rng([seed, _STREAM, sensor_number(camera), view.frame]),
    )
    return frame.rgb
