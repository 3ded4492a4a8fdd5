"""Trajectories in the TUM form, which many evaluation tools read.

Source: Sturm, Engelhard, Endres, Burgard, Cremers, "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import finite_array
from slamkit.errors import InputError
from slamkit.logs.atomic import PathLike, replacing
from slamkit.logs.text_tables import text_columns


def write_tum(path: PathLike, times: ArrayLike, poses: ArrayLike) -> None:
    """Write a trajectory, one line per pose: ``t x y z qx qy qz qw`` with z = qx = qy = 0.

    Parameters
    ----------
    path : path
        File to write; a file that is there is replaced once the new one is complete.
    times : array_like (K,)
        Times [s], never decreasing. Of several poses with one time the last is written.
    poses : array_like (K, 3)
        Poses [m, m, rad]; the heading becomes the unit quaternion (0, 0, sin θ/2, cos θ/2).

    Raises
    ------
    InputError
        Wrong shapes, a value that is not finite, or times that step back.
    """
    t, x = finite_array("times", times, (-1,)), finite_array("poses", poses, (-1, -1))
    if x.shape != (len(t), 3):
        raise InputError(f"poses have shape {x.shape}, {len(t)} times need ({len(t)}, 3)")
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back):
        raise InputError(f"times step back from {t[back[0]]} to {t[back[0] + 1]} s at row {back[0] + 1}")
    last = np.diff(t, append=np.inf) > 0
    t, x = t[last], x[last]
    zero = np.zeros(len(t))
    columns = text_columns(t, x[:, :2], zero, zero, zero, np.sin(x[:, 2] / 2), np.cos(x[:, 2] / 2))
    with replacing(path) as file:
        file.write("".join(f"{' '.join(row)}\n" for row in zip(*columns, strict=True)).encode())
