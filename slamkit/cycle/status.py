"""How a step ended."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["BAD_MOTION", "BAD_SIGHTING", "CAREFUL", "DUE", "FULL", "NOT_DEFINITE", "OK", "Status"]


class Status(IntEnum):
    """What a step returns. All but `OK` and `DUE` mean that it has changed nothing, or that the caller must undo it."""

    OK = 0  #: the step is done
    BAD_MOTION = 1  #: the motion model gave a pose, F or Q that is not finite
    BAD_SIGHTING = 2  #: a sighting that the sensor cannot use
    NOT_DEFINITE = 3  #: S is not positive definite, or P would no longer be
    FULL = 4  #: there is no room: arrays must grow
    DUE = 5  #: the step is done, and a flush would pay off
    CAREFUL = 6  #: numbers are so close to a double's limits that the caller must save the belief first


# Compiled code takes them as plain integers.
OK, BAD_MOTION, BAD_SIGHTING, NOT_DEFINITE, FULL, DUE, CAREFUL = (int(status) for status in Status)
