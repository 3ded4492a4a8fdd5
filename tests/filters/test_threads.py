"""Threads take turns with one filter."""

from __future__ import annotations

import random
import subprocess
import sys
import threading
from typing import Any

import numpy as np
from filter_examples import every_filter, make

from slamkit import SlamkitError, Storage

CHILD = """
import sys
sys.path[:0] = {path!r}
from family import FILTERS
from test_threads import race
for name in FILTERS:
    for compress_above in (0, 64):
        race(name, compress_above)
        print(name, compress_above)
"""


def race(name: str, compress_above: int, steps: int = 60) -> None:
    """Two threads step and read one filter; the belief is that of all their steps, in some order."""
    f = make(name, storage=Storage(compress_above=compress_above))
    wrong: list[str] = []

    def drive(thread: int) -> None:
        rng = random.Random(thread)
        for k in range(steps):
            scan = {(thread, rng.randrange(20)): (3 + rng.random(), rng.uniform(-1, 1)) for _ in range(3)}
            try:
                f.step((0.1, 0.1), 0.1, scan)
                missing = [i for i in scan if i not in f.landmarks]
                if missing or f.x.shape[0] < 3 + 2 * len(scan):
                    wrong.append(f"after step {k}: {missing}")
                if rng.random() < 0.2:
                    P = f.P
                    if not np.array_equal(P, P.T):
                        wrong.append("P is not symmetric")
                if rng.random() < 0.05:
                    f.sensor, f.gate, f.order = f.sensor, rng.choice([None, 1e9]), rng.choice(["sequential", "batch"])
                if rng.random() < 0.05:
                    f.remove(next(iter(scan)))
            except SlamkitError as error:
                wrong.append(repr(error))

    threads = [threading.Thread(target=drive, args=(n,)) for n in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    P = np.array(f.P)
    assert not wrong, wrong[:3]
    assert len(f.landmark_ids) == (f.dim_x - 3) / 2 == len(f.landmarks)
    assert np.linalg.eigvalsh(P)[0] > -1e-9 * P.max()


def test_two_threads_may_share_a_filter() -> None:
    """In a process of its own: a fatal signal is a finding."""
    child = CHILD.format(path=[*sys.path, str(__file__).rpartition("/")[0]])
    done = subprocess.run([sys.executable, "-c", child], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-100:] + done.stderr[-2000:]


@every_filter
def test_threads_give_what_their_turns_give(name: str) -> None:
    """Landmarks that one thread alone sights are those of its own sightings: nothing is mixed up."""
    f = make(name)

    def sight(thread: int) -> None:
        for k in range(30):
            f.observe((thread, k), (3.0 + k, 0.1 * thread))

    threads = [threading.Thread(target=sight, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    g: Any = make(name)
    for i in f.landmark_ids:
        g.observe(i, (3.0 + i[1], 0.1 * i[0]))
    assert np.array_equal(f.x, g.x) and np.array_equal(f.P, g.P)
