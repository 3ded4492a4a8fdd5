"""Studies that several tests look at."""

from __future__ import annotations

import pytest
from small_study import Changed, Lost, Nan, small

from slamkit import EKFSLAM
from slamkit.study import Study


@pytest.fixture(scope="session")
def study() -> Study:
    return small()


@pytest.fixture(scope="session")
def troubled() -> Study:
    return small(filters={"ekf": EKFSLAM, "raises": Changed, "nan": Nan, "lost": Lost}, runs=8)
