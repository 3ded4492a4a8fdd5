"""How numerical functions become machine code, and the tables that they share with Python.

Importing this package imports no Numba; the first call of a compiled function does.
"""

from slamkit.compiled.cache import CacheWarning
from slamkit.compiled.decorator import Compiled, MachineCode, compiled, intrinsics, needed, rows_of
from slamkit.compiled.model_table import Models, models_of
from slamkit.compiled.tables import TILE, OwnFields, OwnNumbers, Shared, Table, aligned

#: Terms of a sum that vector code writes out, which divides every rank that it is given.
UNROLLED = 4

__all__ = [
    "TILE",
    "UNROLLED",
    "CacheWarning",
    "Compiled",
    "MachineCode",
    "Models",
    "OwnFields",
    "OwnNumbers",
    "Shared",
    "Table",
    "aligned",
    "compiled",
    "intrinsics",
    "models_of",
    "needed",
    "rows_of",
]
