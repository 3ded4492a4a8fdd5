"""The events of a log, merged by time into steps of one prediction and the sightings at its end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slamkit.arrays import Array, Indices


class Schedule(NamedTuple):
    """A log as a sequence of steps: predict over `dt` with one control, then use the observations of that instant."""

    times: Array  #: (K,) time at the end of each step [s]
    dt: Array  #: (K,) duration of the prediction [s]; 0 where there is nothing to predict
    control: Indices  #: (K,) row of ``Log.controls`` that acts in the step; -1 where dt is 0
    first: Indices  #: (K + 1,) observations first[k] … first[k+1]-1 belong to step k

    @property
    def start_time(self) -> float:
        """Time at which the first step begins [s]; 0 without steps."""
        return float(self.times[0] - self.dt[0]) if len(self.times) else 0.0


def make_schedule(
    control_times: Array, observation_times: Array, observation_ids: Indices, end: float, increments: bool
) -> Schedule:
    """Merge controls and observations into steps.

    Parameters
    ----------
    control_times : ndarray (T,)
        Sorted [s].
    observation_times, observation_ids : ndarray (M,)
        In the order of :func:`order_of_observations`.
    end : float
        When the last control stops acting [s].
    increments : bool
        True: a control is one motion that is never split; its sightings wait for its end.
    """
    ct, ot = control_times, observation_times
    breaks = np.append(ct, end) if len(ct) else ct
    if increments:
        at = np.searchsorted(breaks, ot)
        inside = (at > 0) & (at < len(breaks))
        ot = ot.copy()
        ot[inside] = breaks[at[inside]]
    cuts = _repeats(ot, observation_times, observation_ids)
    # A stable sort of nearly sorted values takes only a few passes.
    instants = _distinct(np.sort(np.concatenate([breaks, _distinct(ot)]), kind="stable"))
    times = np.sort(np.concatenate([instants, ot[cuts]]), kind="stable")
    first = np.sort(np.concatenate([np.searchsorted(ot, instants), cuts]), kind="stable")
    dt = np.diff(times, prepend=times[0])
    control = np.searchsorted(ct, times) - 1  # the last that begins before times[k]
    acts = (dt > 0) & (control >= 0) & (times <= end)
    keep = acts | (np.diff(first, append=len(ot)) > 0)
    return Schedule(
        times[keep],
        np.where(acts, dt, 0.0)[keep],
        np.where(acts, control, -1)[keep],
        np.append(first[keep], len(ot)),
    )


def order_of_controls(times: Array, controls: Array) -> Indices:
    """Row numbers (T,) by time; controls of one time are sorted by their values."""
    return np.lexsort((*controls.T[::-1], times))


def order_of_observations(times: Array, ids: Indices, z: Array) -> Indices:
    """Row numbers (M,) by time; in one instant come the first sightings of all landmarks, then the second ones, …"""
    order = np.lexsort((*z.T[::-1], ids, times))
    nth = _nth_in_run(times[order], ids[order])
    return order[np.lexsort((ids[order], nth, times[order]))]


def _repeats(instants: Array, times: Array, ids: Indices) -> Indices:
    """Observations at which another step of the same instant begins, so that no step repeats a landmark.

    A cut is made only where the sightings of one time begin, or the second sightings of one time. It therefore does
    not depend on the order of ``Log.landmark_ids``.
    """
    if not np.any((instants[1:] == instants[:-1]) & (ids[1:] <= ids[:-1])):
        return np.empty(0, dtype=np.int64)
    order = np.lexsort((ids, instants))
    same = (np.diff(instants[order]) == 0) & (np.diff(ids[order]) == 0)
    before = np.full(len(ids), -1)  # the previous sighting of the same landmark in the same instant
    before[order[1:][same]] = order[:-1][same]
    groups = np.flatnonzero(np.append(True, (np.diff(times) > 0) | (np.diff(ids) <= 0)))
    latest = np.maximum.reduceat(before, groups)
    cuts: list[int] = []
    begin = 0
    for group in np.flatnonzero(latest >= 0):
        if latest[group] >= begin:
            begin = int(groups[group])
            cuts.append(begin)
    return np.array(cuts, dtype=np.int64)


def _distinct(values: Array) -> Array:
    """Each value of a sorted array once."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    return np.concatenate([values[:1], values[changes]])


def _nth_in_run(*columns: Array | Indices) -> Indices:
    """For each row of sorted columns, the number of equal rows before it."""
    rows = np.arange(len(columns[0]))
    begins = np.append(True, np.any([np.diff(column) != 0 for column in columns], axis=0))[: len(rows)]
    return rows - np.maximum.accumulate(np.where(begins, rows, 0))
