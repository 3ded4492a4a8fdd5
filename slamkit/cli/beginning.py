"""The first steps of a log."""

from __future__ import annotations

from dataclasses import replace

from slamkit.logs import Log


def beginning(log: Log, steps: int) -> Log:
    """The log that ends with its first so many steps."""
    schedule = log.schedule
    if steps >= len(schedule.times):
        return log
    end, seen = float(schedule.times[steps - 1]), int(schedule.first[steps])
    assert log.end_time is not None
    acting = log.control_times < end
    truth = log.truth
    if truth is not None:
        known = truth.times <= schedule.times[steps]  # so that the last step finds the truth that is nearest to it
        truth = replace(truth, times=truth.times[known], poses=truth.poses[known])
    return replace(
        log,
        control_times=log.control_times[acting],
        controls=log.controls[acting],
        observation_times=log.observation_times[:seen],
        observation_ids=log.observation_ids[:seen],
        observations=log.observations[:seen],
        end_time=min(end, log.end_time),
        truth=truth,
    )
