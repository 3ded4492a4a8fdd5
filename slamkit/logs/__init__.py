"""Logs (what a robot did and saw), histories (what a filter estimated), and their files.

Times are in seconds on any one clock. Everything is kept in flat arrays, sorted by time.
"""

from slamkit.logs.archive import Field, check_arrays, decode_id, encode_id, read_archive, reading, write_archive
from slamkit.logs.atomic import PathLike, read_files, replacing, write_files
from slamkit.logs.csv import csv_columns
from slamkit.logs.history import History
from slamkit.logs.log import Log
from slamkit.logs.scan import LogStep, Scan
from slamkit.logs.schedule import Schedule
from slamkit.logs.text_tables import Table, read_table
from slamkit.logs.truth import Truth

__all__ = [
    "Field",
    "History",
    "Log",
    "LogStep",
    "PathLike",
    "Scan",
    "Schedule",
    "Table",
    "Truth",
    "check_arrays",
    "csv_columns",
    "decode_id",
    "encode_id",
    "read_archive",
    "read_files",
    "read_table",
    "reading",
    "replacing",
    "write_archive",
    "write_files",
]
