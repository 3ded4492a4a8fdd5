"""Readers of published data sets, one a module, and their list :data:`DATASETS`."""

from slamkit.datasets.dataset import REQUIRED, DataSet, Option, Recording, Source
from slamkit.datasets.fetch import fetch
from slamkit.datasets.registry import DATASETS

__all__ = ["DATASETS", "REQUIRED", "DataSet", "Option", "Recording", "Source", "fetch"]
