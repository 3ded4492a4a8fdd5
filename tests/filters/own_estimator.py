"""An estimator as a user writes it, outside slamkit: with numbers of its own that compiled code reads and writes."""

from __future__ import annotations

from typing import Any

from slamkit import EKFSLAM
from slamkit.compiled import OwnFields, compiled
from slamkit.cycle import EstimatorFunctions
from slamkit.cycle.standard import sensor as standard_sensor

own = OwnFields({"noise_was": 2}, caution=1, scans=1, last_seen=2)


@compiled("void(models, state, integers, flag)", generic=True)
def prepare_scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """Let the caution decay by a tenth."""
    mine = own(state)
    mine.caution = 0.9 * mine.caution
    mine.scans = mine.scans + 1.0


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """The standard linearisation, with the noise times 1 + caution."""
    standard_sensor(models, state, pose, landmark, slot, z, row)
    mine, noise = own(state), state.scratch.noise
    mine.last_seen[0], mine.last_seen[1] = landmark[0], landmark[1]
    for i in range(z.shape[0]):
        mine.noise_was[row // z.shape[0], i % 2] = noise[row + i, i]
        for j in range(z.shape[0]):
            noise[row + i, j] *= 1.0 + mine.caution


class CautiousEKF(EKFSLAM):
    """An EKF that trusts its first sightings less."""

    name = "cautious"
    own_fields = own
    functions = EstimatorFunctions(prepare_scan=prepare_scan, sensor=sensor)

    def __init__(self, *arguments: Any, caution: float = 1.0, **options: Any) -> None:
        super().__init__(*arguments, **options)
        own(self._belief.state).caution = caution

    @property
    def caution(self) -> float:
        """By how much the noise is too large now."""
        return float(own(self._belief.state).caution)

    @property
    def scans(self) -> float:
        """How many scans were taken."""
        return float(own(self._belief.state).scans)
