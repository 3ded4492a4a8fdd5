"""Damaged files of every kind, in a child process: see `file_fuzz`."""

from __future__ import annotations

import secrets
from pathlib import Path

import pytest
from child import run_child


def test_no_damaged_file_does_harm(tmp_path: Path) -> None:
    print(run_child("file_fuzz.py", 500, 1, tmp_path, timeout=1800))


@pytest.mark.slow
def test_no_damaged_file_of_many_does_harm(tmp_path: Path) -> None:
    seed = secrets.randbelow(10**6)
    print(run_child("file_fuzz.py", 20_000, seed, tmp_path, timeout=12 * 3600))
