"""The list of the data sets that slamkit reads by name."""

from __future__ import annotations

from slamkit.datasets.dataset import DataSet, check_data_set
from slamkit.datasets.mrclam import MRCLAM
from slamkit.registry import Registry

#: Every data set by its name on the command line. ``DATASETS.register(name, data_set)`` adds one of your own.
DATASETS: Registry[DataSet] = Registry(
    "data set", {data_set.name: data_set for data_set in (MRCLAM,)}, check=check_data_set
)
