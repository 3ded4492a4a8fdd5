"""Settings that every test shares."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from slamkit.registry import Registry

ROOT = Path(__file__).resolve().parent.parent

# In the environment, so that processes which tests start draw without a display too.
os.environ["MPLBACKEND"] = "Agg"

# Compilation at a first call is slow and says nothing about a law. Hypothesis's own "ci" profile repeats its examples.
settings.register_profile("slamkit", settings.get_profile("ci" if os.environ.get("CI") else "default"), deadline=None)
settings.load_profile("slamkit")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of real logs: SLAMKIT_DATA, or else ../shared/data beside the checkout; skips where there is none."""
    named = os.environ.get("SLAMKIT_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        where = f"SLAMKIT_DATA names {folder}" if named else f"SLAMKIT_DATA is not set and {folder} does not exist"
        pytest.skip(f"no folder of real logs: {where}")
    return folder


@pytest.fixture
def register() -> Iterator[Callable[[Registry[Any], str, Any], None]]:
    """Register an item, also under a name that is taken, until the end of the test."""
    changed: list[tuple[Registry[Any], str, Any]] = []

    def register(registry: Registry[Any], name: str, item: Any) -> None:
        before = registry.get(name)
        registry.register(name, item, replace=True)
        changed.append((registry, name, before))

    yield register
    for registry, name, before in reversed(changed):
        if before is None:
            registry.unregister(name)
        else:
            registry.register(name, before, replace=True)
