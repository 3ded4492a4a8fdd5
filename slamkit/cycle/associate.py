"""Associate: which landmark each sighting is of."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled


@compiled("void(policy, models, state, integers, matrix)", generic=True)
def known_ids(policy: Any, models: Any, state: Any, slots: Any, z: Any) -> None:
    """The caller has given an id with every sighting, and its slot in the map is there already."""
