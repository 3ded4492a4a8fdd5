"""Built-in models, and strategies for their arguments, that the tests of this room share."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from slamkit import se2
from slamkit.arrays import Array
from slamkit.models import EulerUnicycle, Odometry, RangeBearing, RelativePosition, Unicycle

PI = np.pi
POSE_NOISE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])

MOTIONS = [
    Unicycle(0.1, 0.05),
    Unicycle(0.0, 0.0, POSE_NOISE),
    EulerUnicycle(0.2, 0.3, np.diag([0.01, 0.0, 0.0])),
    Odometry(0.1, 0.01, 0.05, 0.02),
    Odometry(0.0, 0.0, 0.0, 0.0),
]
SENSORS = [RangeBearing(0.1, 0.02), RangeBearing(1e-4, 3.0), RelativePosition(0.1), RelativePosition(25.0)]
CONTROL_DIM = {Unicycle: 2, EulerUnicycle: 2, Odometry: 3}

headings = st.floats(-PI, PI, exclude_max=True) | st.sampled_from([-PI, np.nextafter(PI, 0), 0.0, PI / 2])
poses = st.builds(lambda x, y, t: np.array([x, y, t]), st.floats(-100, 100), st.floats(-100, 100), headings)
rates = st.floats(-3, 3) | st.sampled_from([0.0, 1e-12, -1e-9, 1e-6, -1e-3])
durations = st.floats(1e-3, 2.0)


def name(model: object) -> str:
    return type(model).__name__


def same_pose(a: Array, b: Array, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(a[:2], b[:2], rtol=0, atol=atol)
    np.testing.assert_allclose(se2.wrap(a[2] - b[2]), 0, rtol=0, atol=atol)


def control(model: object, numbers: tuple[float, float, float]) -> Array:
    return np.array(numbers[: CONTROL_DIM[type(model)]])
