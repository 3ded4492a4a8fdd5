"""Download of published data sets; nothing is downloaded but by a call of :func:`fetch`."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from ftplib import Error as FTPError
from operator import index
from pathlib import Path
from typing import BinaryIO
from urllib.parse import urlsplit

from slamkit.datasets.dataset import Source
from slamkit.datasets.registry import DATASETS
from slamkit.errors import InputError, LogFileError

TIMEOUT = 30  #: how long a silent server is waited for [s]


def fetch(
    name: str,
    number: int,
    folder: str | os.PathLike[str] | None = None,
    *,
    base_url: str | None = None,
    progress: Callable[[int], object] | None = None,
) -> Path:
    """Download one set, or find it where an earlier call put it.

    The publishers give no hashes, so none can be compared. What is checked instead, after a download and for a file
    that is there already: it is a whole zip, every member fits its checksum, and the files of a set are in it.
    The file appears under its name only after that; a broken one that is there is replaced.

    Parameters
    ----------
    name : {"mrclam"}
        Which data set.
    number : int
        Which of its sets: 1 to 9.
    folder : str or path-like, optional
        Where to put the file; made where it does not exist. By default the user's cache folder for slamkit.
    base_url : str, optional
        Another address (ftp, http or https) of the folder with the sets' files. By default the official one, for
        MRCLAM ``ftp://asrl3.utias.utoronto.ca/MRCLAM``.
    progress : callable, optional
        Called with the number of bytes received so far, each time some arrive.

    Returns
    -------
    Path
        The set's zip; :func:`slamkit.datasets.mrclam.load` reads it as it is.

    Raises
    ------
    InputError
        An unknown name, number or kind of address.
    LogFileError
        The file cannot be had: no connection, no such file, an interrupted transfer, or what came is not the set.
        No partial file stays behind.
    """
    sources = {name: data_set.source for name, data_set in DATASETS.items() if data_set.source is not None}
    if name not in sources:
        raise InputError(f"data set is {name!r}, expected one of: {', '.join(sources)}")
    source = sources[name]
    try:
        known = not isinstance(number, bool) and index(number) in source.numbers
    except TypeError:
        known = False
    if not known:
        raise InputError(f"set is {number!r}, {name} has the sets {source.numbers[0]} to {source.numbers[-1]}")
    file = source.file.format(number=index(number))
    url = f"{(source.base_url if base_url is None else base_url).rstrip('/')}/{file}"
    if not _is_address(url):
        raise InputError(f"base_url is {base_url!r}, expected an address such as {source.base_url} (ftp, http, https)")

    import pooch  # here, because it is slow to import and most runs download nothing

    place = Path(pooch.os_cache("slamkit") / name if folder is None else folder).expanduser()
    final = place / file
    if final.is_file() and _is_whole(final, source):
        return final
    try:
        place.mkdir(parents=True, exist_ok=True)
        # In the same folder, so that the last step is a rename: another process sees the whole file or none.
        with tempfile.TemporaryDirectory(prefix=f".{file}-", dir=place) as scratch:
            part = Path(scratch) / file
            with part.open("wb") as stream:
                _download(url, _Counted(stream, progress))
            _check_download(part, url, source)
            part.replace(final)
    except (OSError, EOFError, FTPError) as error:  # requests' errors are OSErrors
        raise LogFileError(f"{url} cannot be fetched to {final}: {error or type(error).__name__}") from None
    return final


def _is_address(url: str) -> bool:
    parts = urlsplit(url)
    try:
        return parts.scheme in ("ftp", "http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:  # a port that is no number
        return False


class _Counted:
    """A stream to write to that says how much has been written."""

    def __init__(self, stream: BinaryIO, progress: Callable[[int], object] | None) -> None:
        self._stream, self._progress, self._received = stream, progress, 0

    def write(self, data: bytes) -> int:
        written = self._stream.write(data)
        self._received += written
        if self._progress is not None:
            self._progress(self._received)
        return written

    def flush(self) -> None:
        self._stream.flush()


def _download(url: str, stream: _Counted) -> None:
    from pooch import FTPDownloader, HTTPDownloader

    parts = urlsplit(url)
    chunk = 1 << 16
    if parts.scheme == "ftp":
        # The port goes beside the address: pooch takes everything before the path for the host's name.
        downloader = FTPDownloader(port=parts.port or 21, timeout=TIMEOUT, chunk_size=chunk)
        downloader(f"ftp://{parts.hostname}{parts.path}", stream, None)
    else:
        HTTPDownloader(timeout=TIMEOUT, chunk_size=chunk)(url, stream, None)


def _is_whole(file: Path, source: Source) -> bool:
    try:
        source.check(file)
    except LogFileError:
        return False
    return True


def _check_download(part: Path, url: str, source: Source) -> None:
    try:
        source.check(part)
    except LogFileError as error:
        raise LogFileError(f"what {url} sent is not the set: {str(error).replace(str(part), part.name)}") from None
