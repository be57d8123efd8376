"""Random transforms and poses."""

import numpy as np
from hypothesis import strategies as st

from recast.geometry import se3

coordinate = st.floats(-1e3, 1e3)
angle = st.floats(-10.0, 10.0)
planar_poses = st.tuples(coordinate, coordinate, angle).map(np.array)
points3 = st.tuples(coordinate, coordinate, coordinate).map(np.array)
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)
transforms = st.builds(
    lambda q, t: se3.from_rotation_translation(se3.quat_to_matrix(q), t), quaternions, points3
)
rotation_vectors = st.builds(
    lambda direction, size: size * direction / np.linalg.norm(direction),
    st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3),
    st.one_of(
        st.floats(0.0, np.pi - 1e-6),
        st.sampled_from([0.0, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 1e-3, np.pi - 1e-6]),
    ),
)
