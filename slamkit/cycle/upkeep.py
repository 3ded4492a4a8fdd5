"""Upkeep: when a flush of a compressed belief pays off."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled
from slamkit.cycle.status import DUE, OK


@compiled("index(state, index)")
def upkeep(state: Any, n: int) -> int:
    """`DUE` where a flush pays off after a scan of n sightings, else `OK`.

    A larger active part makes every update more expensive. A flush makes it small again, but the base and what is in
    sight will soon be in the next flush too. So a flush pays off once the extra cost since the last flush exceeds the
    cost of a flush. All costs are in multiply-adds:

    - ``debt``: the extra cost since the last flush;
    - ``price_per_square``: cost of a flush for each coordinate in sight and D²; ``fixed_price``: its fixed cost;
    - ``most_columns``: columns at which a flush is due in any case;
    - ``spent``: cost of the updates since the last flush; ``spent_plain``: what they would have cost with all active;
    - ``limit``: the dimension above which the belief is compressed; ``stays``: steps for which nothing is to rest.
    """
    resting = state.resting
    C = resting.columns
    if C == 0:
        if state.belief.dim <= resting.limit:
            return OK
        resting.stays -= 1.0
        return DUE if resting.stays < 0.0 else OK
    D, need, whole = float(state.belief.active), 3.0 + 2.0 * n, float(state.belief.dim)
    cost = D * D + 2.0 * D * C + C * C
    resting.spent += n * cost
    resting.spent_plain += n * whole * whole
    resting.debt += n * max(0.0, cost - 4.0 * need * need)
    price = resting.price_per_square * need * whole * whole + resting.fixed_price
    return DUE if resting.V.shape[1] > 0 or resting.debt > price or resting.most_columns < C else OK
