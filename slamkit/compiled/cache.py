"""Where machine code is kept on disk, and whether what lies there may be used.

Each function has a folder of its own below a folder named after a digest of every source that takes part. A folder is
written elsewhere and moved into place when it is whole, with a checksum of its files: it is never stale, never half
written, and a damaged one is found before it is loaded. Machine code is code: only folders that belong to the user, and
that others cannot write to, are used.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import platform
import shutil
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from slamkit.compiled.digest import Unkeyed, digest_of

__all__ = ["CacheWarning", "compile_cached", "load_numba_types"]

CHECKSUM = "checksum"


class CacheWarning(UserWarning):
    """Machine code is not kept, or was damaged and is made anew."""


@cache
def load_numba_types() -> ModuleType:
    """`slamkit.compiled.numba_types`, imported at the first need of it."""
    return importlib.import_module("slamkit.compiled.numba_types")


def compile_cached(function: Any, make_source: Callable[[], Any], *, in_table: bool = False) -> Any:
    """Numba's dispatcher of a :class:`~slamkit.compiled.Compiled` with its one signature compiled.

    Parameters
    ----------
    function : Compiled
        Its signature, and what it uses.
    make_source : callable
        Gives its source over compiled functions. It is asked only where machine code has to be made: what is read from
        the cache holds the code of everything that it calls.
    in_table : bool
        Whether it is for a table, whose functions take arrays as an address and extents.
    """
    signature = load_numba_types().signature_of(function.signature, in_table=in_table)
    place = _folder_of(function, in_table)
    if place is None:
        return _compile(make_source(), signature, None, in_table)
    if place.is_dir():
        dispatcher = _load(function.function, signature, place, in_table)
        if dispatcher is not None:
            return dispatcher
        shutil.rmtree(place, ignore_errors=True)
    try:
        scratch = Path(tempfile.mkdtemp(prefix=".", dir=place.parent))
    except OSError:
        return _compile(make_source(), signature, None, in_table)
    try:
        dispatcher = _compile(make_source(), signature, scratch, in_table)
        if any(scratch.iterdir()):
            (scratch / CHECKSUM).write_text(_checksum(scratch), encoding="ascii")
            # Another process may have been faster: its folder is as good.
            os.rename(scratch, place)
    except OSError:
        pass
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return dispatcher


def _load(source: Any, signature: Any, place: Path, in_table: bool) -> Any:
    """The dispatcher that was stored in a folder, or None where that is damaged or Numba holds it for outdated."""
    from numba.core.errors import NumbaError

    if _is_whole(place):
        try:
            dispatcher = _compile(source, signature, place, in_table)
            # A miss means that Numba holds the source for changed, and has stored it anew without a checksum.
            return None if dispatcher.stats.cache_misses else dispatcher
        except NumbaError:  # it holds the file of the source for changed, and cannot compile this form of it
            return None
        except Exception:  # whatever Numba's reader stumbles over
            pass
    _warn(f"machine code in {place.parent} was damaged: it is made anew")
    return None


def _compile(source: Any, signature: Any, folder: Path | None, in_table: bool) -> Any:
    import numba
    from numba.core.errors import NumbaExperimentalFeatureWarning

    # contract lets a·b + c be one instruction; no other rule of floating-point arithmetic is relaxed.
    options = {"fastmath": {"contract"}, "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    options["no_cpython_wrapper"] = in_table  # Python never calls these
    with warnings.catch_warnings(), _numba_caches_in(folder):
        warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
        try:
            dispatcher = numba.njit(cache=folder is not None, **options)(source)
        except RuntimeError:  # a source without a file, as in a notebook, cannot be cached
            dispatcher = numba.njit(**options)(source)
        dispatcher.compile(signature)
    dispatcher.disable_compile()
    return dispatcher


@contextmanager
def _numba_caches_in(folder: Path | None) -> Iterator[None]:
    """Within the block Numba caches in this folder; the caller's own setting is put back afterwards."""
    from numba import config

    before = config.CACHE_DIR
    if folder is not None:
        config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before


def _folder_of(function: Any, in_table: bool) -> Path | None:
    """The folder of one function, which need not exist; None where its machine code is not to be kept."""
    from numba import config

    root = _root(config.CACHE_DIR)
    if root is None:
        return None
    module, name = function.__module__, function.function.__qualname__
    key = _slamkit_digest()
    if module.partition(".")[0] != "slamkit":
        try:
            key = digest_of(function, key)
        except Unkeyed:
            return None
    parent = _private(root / f"compiled-{key}")
    unit = f"{module}.{name}{'-in-table' if in_table else ''}".replace("<", "").replace(">", "")
    return None if parent is None else parent / f"{unit}-{_source_stamp(function.function)}"


def _source_stamp(source: Any) -> str:
    """By which Numba tells the file of a source from others, and from what it was: path, time and size.

    As a part of the name it keeps apart checkouts of the same version, which would take turns to overwrite each other's
    machine code.
    """
    path = source.__code__.co_filename
    try:
        found = os.stat(path)
    except OSError:  # a notebook's cell, or a source without a file
        return "no-file"
    return hashlib.sha256(f"{path} {found.st_mtime_ns} {found.st_size}".encode()).hexdigest()[:8]


@cache
def _root(configured: str) -> Path | None:
    """Folder of all machine code, or None and a warning where there is none that is safe to use."""
    if configured:
        root = Path(configured)
    else:
        import platformdirs

        root = Path(platformdirs.user_cache_dir("slamkit", appauthor=False))
    if _private(root) is None:
        _warn(
            f"machine code is not kept: {root} cannot be written, does not belong to you, or others can write to it. "
            "Every process compiles anew; set NUMBA_CACHE_DIR to a folder of your own"
        )
        return None
    return root


@cache
def _private(folder: Path) -> Path | None:
    """The folder, made where it is missing, if it can be written by its owner, who is this user, and by nobody else."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError:
        return None
    if not os.access(folder, os.W_OK | os.X_OK):
        return None
    if hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return None
    return folder


def _checksum(folder: Path) -> str:
    digest = hashlib.blake2b()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != CHECKSUM:
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _is_whole(folder: Path) -> bool:
    try:
        return (folder / CHECKSUM).read_text(encoding="ascii") == _checksum(folder)
    except (OSError, UnicodeDecodeError):
        return False


@cache
def _warn(message: str) -> None:
    """Say it once."""
    warnings.warn(message, CacheWarning, stacklevel=2)


@cache
def _slamkit_digest() -> str:
    """Digest of every source of slamkit that takes part in compilation, and of the versions that decide the result."""
    import numba

    package = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256(f"{numba.__version__} {sys.version} {platform.machine()}".encode())
    # `rglob` does not follow the link that models is in a checkout.
    for path in sorted([*package.rglob("*.py"), *(package / "models").glob("*.py")]):
        source = path.read_bytes()
        # Tables, and constants that compiled functions take from elsewhere, are declared in these.
        if b"@compiled(" in source or b"Table(" in source or path.parent.name in ("compiled", "cycle"):
            digest.update(path.relative_to(package).as_posix().encode() + source)
    return digest.hexdigest()[:16]
