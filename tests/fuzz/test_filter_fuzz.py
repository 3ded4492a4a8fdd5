"""Random operations on every filter, in a child process: see `filter_machine`."""

from __future__ import annotations

import secrets
from pathlib import Path

import pytest
from child import run_child


def test_no_series_of_operations_breaks_a_filter(tmp_path: Path) -> None:
    print(run_child("filter_machine.py", 2_000, 1, tmp_path, timeout=1800))


@pytest.mark.slow
def test_no_long_series_of_operations_breaks_a_filter(tmp_path: Path) -> None:
    seed = secrets.randbelow(10**6)
    print(run_child("filter_machine.py", 200_000, seed, tmp_path, timeout=12 * 3600))
