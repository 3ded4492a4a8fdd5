"""Compile a C++ source of this folder and load it."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from contenders import MissingError

FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-std=c++17", "-shared", "-fPIC")


@cache
def library(source: str, compile_flags: Sequence[str] = (), link_flags: Sequence[str] = ()) -> ctypes.CDLL:
    """The shared library of a source file. It is compiled in a temporary folder that is deleted after loading.

    The compiler is $CXX, by default g++.

    Raises
    ------
    MissingError
        There is no compiler, or the source does not compile, for example because a header is missing.
    """
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        raise MissingError("no C++ compiler: expected g++, or the one named by CXX")
    with TemporaryDirectory() as folder:
        made = Path(folder) / "contender.so"
        command = [
            compiler,
            *FLAGS,
            *compile_flags,
            str(Path(__file__).with_name(source)),
            "-o",
            str(made),
            *link_flags,
        ]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            first_error = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip())
            raise MissingError(f"{source} does not compile: {first_error}")
        return ctypes.CDLL(str(made))
