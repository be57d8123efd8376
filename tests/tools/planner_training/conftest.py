"""A straight road, and a small dataset on it whose pictures show what is in the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.core.files import write_json
from recast.dynamics import make_state
from recast.planning import DrivingCommand
from recast.planning.gtrs import PRIMITIVES
from recast.planning.gtrs.expert import score_trajectories
from recast.planning.types import ego_status
from recast_tools.planner_training.samples import (
    CLUES,
    COLUMNS,
    RECORD_FILE,
    DatasetRecord,
    Sample,
    world_folder,
    write_world,
)
from recast_tools.planner_training.targets import COLUMN_VALUES
from support.target_roads import moving, straight_road


@pytest.fixture(scope="session")
def small_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten worlds of two twins each: a car on the road, as a red patch, and without."""
    folder = tmp_path_factory.mktemp("planner") / "data"
    record = DatasetRecord(per_world=2, speeds=2, scenes=("made-up",))
    write_json(folder / RECORD_FILE, record.model_dump(mode="json"))
    rng = np.random.default_rng(0)
    road = straight_road()
    for number in range(10):
        gap = float(rng.uniform(8, 20))
        states = make_state(np.zeros((2, 3)), rng.uniform(4, 9, 2))
        samples = []
        for present in (True, False):
            image = rng.integers(100, 120, (128, 512, 3)).astype(np.uint8)
            clues = np.zeros(len(CLUES), np.float32)
            columns = np.zeros((COLUMNS, len(COLUMN_VALUES)), np.float32)
            if present:
                columns[15:17] = 1, np.log(gap), 1, 0, -states[0][3], 0
                image[60:90, 240:270] = 200, 20, 20
                clues[:5] = 1, gap, 0, 1, 0
            status = np.stack([ego_status(DrivingCommand.STRAIGHT, state) for state in states])
            found = [
                score_trajectories(possible, state, road, [moving(gap)] if present else [])
                for possible, state in zip(PRIMITIVES.trajectories(status), states, strict=True)
            ]
            scores = np.stack([one.scores for one in found])
            best = np.array([one.best for one in found], np.int32)
            samples.append(Sample(image, status, scores, best, clues, columns))
        write_world(world_folder(folder, number), samples, [1, 0], [-1, -1], PRIMITIVES)
    return folder
