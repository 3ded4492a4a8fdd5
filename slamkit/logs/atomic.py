"""Writing files so that a reader finds the old content or the new, even if the writer is killed.

One file is written under a temporary name and renamed. Several files of a folder form one unit: all are written under
temporary names, then a list of them, and then they are renamed. From the moment at which the list is there the new
content counts, and :func:`read_files` follows the list. The next writer finishes an interrupted renaming.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import IO

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PathLike = str | os.PathLike[str]

LIST = ".slamkit-files"  #: names the files of a folder that are being replaced, while they are

_NAME = re.compile(r"\.(?P<target>.+)\.[0-9a-f]{16}\.tmp")


@contextmanager
def replacing(path: PathLike) -> Iterator[IO[bytes]]:
    """Open a file that takes the place of `path` once all of it is written.

    If that fails, `path` stays as it is and nothing else remains. A killed writer leaves a temporary file beside
    `path`, which the next one removes.
    """
    target = Path(os.path.realpath(path))
    _remove_stale(target.parent, [target.name])
    temporary = target.with_name(f".{target.name}.{os.urandom(8).hex()}.tmp")
    try:
        with _create(temporary) as file:
            yield file
            _flush(file)
            if fcntl is not None:  # while the lock is held, so that no other writer removes the file
                os.replace(temporary, target)
        if fcntl is None:  # Windows cannot rename an open file
            os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_files(folder: PathLike, contents: Mapping[str, bytes]) -> None:
    """Write several files of a folder as one unit; the folder is made where it does not exist.

    A reader that uses :func:`read_files` finds all of the old files or all of the new ones, no matter when the writer
    is killed.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder, exclusive=True):
        _finish(folder)
        _remove_stale(folder, [*contents, LIST])
        temporary = {name: f".{name}.{os.urandom(8).hex()}.tmp" for name in contents}
        try:
            for name, content in contents.items():
                with _create(folder / temporary[name]) as file:
                    file.write(content)
                    _flush(file)
            with replacing(folder / LIST) as file:
                file.write("".join(f"{name}\n" for name in temporary.values()).encode())
        except BaseException:
            for name in temporary.values():
                (folder / name).unlink(missing_ok=True)
            raise
        _flush_folder(folder)
        _finish(folder)


def read_files(folder: PathLike, names: Iterable[str]) -> dict[str, bytes]:
    """Contents of those files that exist, all from before or all from after a :func:`write_files`.

    Raises
    ------
    OSError
        A file exists, but cannot be read.
    """
    folder = Path(folder)
    contents = {}
    with _locked(folder, exclusive=False):
        pending = _pending(folder)
        for name in names:
            path = folder / pending.get(name, name)
            with suppress(FileNotFoundError, NotADirectoryError):
                contents[name] = path.read_bytes()
    return contents


def finish_interrupted(folder: PathLike) -> None:
    """Rename what a killed :func:`write_files` left under temporary names; nothing where no writer was killed."""
    if (Path(folder) / LIST).exists():
        with _locked(Path(folder), exclusive=True):
            _finish(Path(folder))


def _pending(folder: Path) -> dict[str, str]:
    """Name → temporary name of the files that a list says are new and that have not been renamed yet."""
    try:
        lines = (folder / LIST).read_text(encoding="utf-8").splitlines()
    except (FileNotFoundError, NotADirectoryError):
        return {}
    named = [(match["target"], line) for line in lines if (match := _NAME.fullmatch(line)) and Path(line).name == line]
    return {target: line for target, line in named if (folder / line).exists()}


def _finish(folder: Path) -> None:
    for name, temporary in _pending(folder).items():
        os.replace(folder / temporary, folder / name)
    (folder / LIST).unlink(missing_ok=True)


def _remove_stale(folder: Path, names: Iterable[str]) -> None:
    """Remove the temporary files of killed writers: those that no process holds a lock on."""
    pending = set(_pending(folder).values())
    targets = set(names)
    try:
        entries = os.listdir(folder)
    except OSError:  # the caller's own attempt to write says what is wrong
        return
    for entry in entries:
        match = _NAME.fullmatch(entry)
        if match and match["target"] in targets and entry not in pending:
            with suppress(OSError):
                if fcntl is None:  # Windows refuses to remove a file that a writer has open
                    (folder / entry).unlink()
                    continue
                with open(folder / entry, "rb") as file:
                    fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
                    (folder / entry).unlink()


def _create(path: Path) -> IO[bytes]:
    """A new file, locked so that no other writer takes it for a left-over."""
    while True:
        file = open(path, "xb")  # noqa: SIM115  # the caller closes it
        _lock(file.fileno(), exclusive=True)
        if path.exists():
            return file
        file.close()  # between its creation and its lock another writer removed it


def _flush(file: IO[bytes]) -> None:
    file.flush()
    os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    """Make the names in a folder survive a power failure, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def _locked(folder: Path, *, exclusive: bool) -> Iterator[None]:
    """Hold a lock on a folder, where the system has such locks and the folder exists."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        yield
        return
    try:
        _lock(descriptor, exclusive)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, exclusive: bool) -> None:
    """Lock an open file or folder until it is closed; nothing where the system or the file system has no locks."""
    if fcntl is not None:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH)
