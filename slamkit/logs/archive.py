"""Archives: npz files of named arrays and a few facts, without code, checked before anything in them is used.

An archive holds one member ``slamkit`` with its kind, version and facts as JSON, and the arrays, each in NumPy's npy
form. Members are not compressed: nothing that is read can be larger than the file.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from slamkit.errors import InputError, LogFileError
from slamkit.logs.atomic import PathLike, replacing

_HEADER = "slamkit"


@dataclass(frozen=True)
class Field:
    """What an array of an archive must be.

    Examples
    --------
    >>> poses, rows = Field(np.float64, ("K", 3)), Field(np.int64, ("M",), lower=-1)
    """

    dtype: type[np.generic]  #: exactly this, in the machine's byte order
    shape: tuple[str | int, ...]  #: a length, or the name of one that all arrays of the archive share
    finite: bool = True  #: NaN and infinities are refused
    lower: float | None = None  #: least value
    upper: float | None = None  #: greatest value
    optional: bool = False  #: may be missing


def check_arrays(
    arrays: Mapping[str, NDArray[Any]], fields: Mapping[str, Field], sizes: Mapping[str, int] | None = None
) -> dict[str, int]:
    """Check names, dtypes, shapes and values of arrays against each other.

    Parameters
    ----------
    arrays : mapping name → ndarray
    fields : mapping name → Field
    sizes : mapping name → int, optional
        Lengths that are known from elsewhere.

    Returns
    -------
    dict
        Every named length.

    Raises
    ------
    InputError
        A name is unknown or missing, or an array is not what its field says.
    """
    found = _check_form({name: (a.dtype, a.shape) for name, a in arrays.items()}, fields, sizes)
    for name, a in arrays.items():
        _check_values(name, a, fields[name])
    return found


def write_archive(path: PathLike, kind: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays and facts to an npz file that holds no pickle and no date: the same content, the same bytes.

    Parameters
    ----------
    path : path
        File to write, under exactly this name.
    kind : str
        What it is; :func:`read_archive` refuses another kind.
    facts : mapping
        What JSON can hold.
    arrays : mapping name → ndarray
        Arrays without Python objects.
    """
    text = json.dumps({_HEADER: kind, "version": 1, "facts": dict(facts)})
    members = {_HEADER: np.array(text), **arrays}
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in members.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array, order="C"), allow_pickle=False)


def read_archive(
    path: PathLike,
    kind: str,
    fields: Mapping[str, Field] | None = None,
    facts: Mapping[str, type | tuple[type, ...]] | None = None,
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what :func:`write_archive` wrote; call it within :func:`reading`.

    The form of every array is checked before its numbers are read. All arrays that are returned are writable,
    C-contiguous copies.

    Parameters
    ----------
    path : path
    kind : str
        The expected kind.
    fields : mapping name → Field, optional
        The arrays that the archive may hold. Without it any names, shapes and dtypes of numbers and texts are
        accepted, and the caller has to check them.
    facts : mapping name → type or tuple of types, optional
        The facts that the archive holds, all of them, each with its exact type. Without it any are accepted.

    Returns
    -------
    facts : dict
    arrays : dict name → ndarray

    Raises
    ------
    LogFileError
        The file holds another kind, comes from a later version of slamkit, or is not such an archive.
    InputError
        An array or a fact is not what `fields` or `facts` says.
    """
    with open(path, "rb") as file:
        if not zipfile.is_zipfile(file):
            raise LogFileError(f"{path} is not an npz file, or is a truncated one; expected a slamkit {kind}")
        size = os.fstat(file.fileno()).st_size
        file.seek(0)
        with zipfile.ZipFile(file) as archive:
            members = _members(archive, size)
            if _HEADER not in members:
                raise LogFileError(f"{path} has no member {_HEADER}.npy; expected a slamkit {kind}")
            header = members.pop(_HEADER)
            if header.dtype.kind != "U" or header.shape != ():
                raise LogFileError(f"{path} has a member {_HEADER}.npy that is not a text")
            content = _content(str(path), kind, str(header.read(archive)))
            if facts is not None:
                _check_facts(content, facts)
            if fields is not None:
                _check_form({name: (m.dtype, m.shape) for name, m in members.items()}, fields, None)
            arrays = {name: member.read(archive) for name, member in members.items()}
    for name, field in (fields or {}).items():
        if name in arrays:
            _check_values(name, arrays[name], field)
    return content, arrays


@contextmanager
def reading(path: PathLike, kind: str) -> Iterator[None]:
    """Turn every error inside into a LogFileError that names the file."""
    try:
        yield
    except LogFileError:
        raise
    except InputError as error:
        raise LogFileError(f"{path} cannot be read as a slamkit {kind}: {error}") from error
    # A damaged file can make zipfile, NumPy, json and a constructor raise nearly anything.
    except Exception as error:
        raise LogFileError(f"{path} cannot be read as a slamkit {kind}: {type(error).__name__}: {error}") from error


def encode_id(landmark_id: Hashable) -> Any:
    """A landmark id as a value of JSON: tuples become lists, NumPy's numbers Python's.

    Raises
    ------
    InputError
        It is not an int, str, float (other than NaN, which equals no id), bool, None or a tuple of these.
    """
    i: Any = landmark_id.item() if isinstance(landmark_id, np.generic) else landmark_id
    if type(i) is tuple:
        return [encode_id(part) for part in i]
    # A subclass would come back as its base: an IntEnum as an int.
    if i is None or type(i) in (bool, int, str) or (type(i) is float and i == i):
        return i
    raise InputError(
        f"landmark id {landmark_id!r} is a {type(landmark_id).__name__}; a file holds ids that are int, str, float "
        "(not NaN), bool, None or tuples of these"
    )


def decode_id(value: Any) -> Hashable:
    """The landmark id that :func:`encode_id` turned into a value of JSON; ValueError if there is none."""
    if isinstance(value, list):
        return tuple(decode_id(part) for part in value)
    if isinstance(value, dict) or value != value:
        raise ValueError(f"{value!r} is not a landmark id")
    id_: Hashable = value
    return id_


@dataclass(frozen=True)
class _Member:
    """An array of an archive whose header was read, and whose numbers were not."""

    info: zipfile.ZipInfo
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    columns_first: bool
    offset: int  #: bytes before the numbers

    def read(self, archive: zipfile.ZipFile) -> NDArray[Any]:
        with archive.open(self.info) as member:
            data = member.read()  # to the end: only then is the checksum compared
        if self.dtype == np.bool_ and np.frombuffer(data, np.uint8, offset=self.offset).max(initial=0) > 1:
            raise InputError(f"{self.info.filename} holds a truth value other than 0 and 1")
        a = np.frombuffer(data, self.dtype, prod(self.shape), self.offset)
        a = a.reshape(self.shape[::-1]).T if self.columns_first else a.reshape(self.shape)
        return np.array(a, order="C")


def _members(archive: zipfile.ZipFile, size: int) -> dict[str, _Member]:
    """Name → member, once it is certain that reading them all takes no more memory than the file has bytes."""
    members: dict[str, _Member] = {}
    infos = archive.infolist()
    if sum(info.file_size for info in infos) > size:
        raise InputError(f"its members claim to be larger than the file of {size} bytes")
    for info in infos:
        name = info.filename.removesuffix(".npy")
        if name == info.filename or name in members:
            raise InputError(f"it holds {info.filename} {'twice' if name in members else ', which is not an array'}")
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise InputError(f"{info.filename} is compressed; slamkit writes arrays as they are")
        with archive.open(info) as member:
            members[name] = _read_header(info, member, size)
    return members


def _read_header(info: zipfile.ZipInfo, member: IO[bytes], size: int) -> _Member:
    version = np.lib.format.read_magic(member)
    if version not in ((1, 0), (2, 0)):
        raise InputError(f"{info.filename} has version {version} of the npy form, expected 1 or 2")
    of = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, columns_first, dtype = of(member)
    if dtype.kind not in "biufU":
        raise InputError(f"{info.filename} has dtype {dtype}, expected numbers or texts")
    # An empty array may have any other lengths: none of them may be absurd.
    if any(n < 0 or n > size for n in shape):
        raise InputError(f"{info.filename} has shape {shape} in a file of {size} bytes")
    offset = member.tell()
    if offset + prod(shape) * dtype.itemsize != info.file_size:
        raise InputError(f"{info.filename} has {info.file_size - offset} bytes, which are not {shape} of {dtype}")
    return _Member(info, dtype, shape, columns_first, offset)


def _content(path: str, kind: str, text: str) -> dict[str, Any]:
    """The facts in the text of an archive of that kind."""
    header = json.loads(text)
    if not isinstance(header, dict) or header.keys() != {_HEADER, "version", "facts"}:
        raise LogFileError(f"{path} says something else than its kind, version and facts; expected a slamkit {kind}")
    if header[_HEADER] != kind:
        raise LogFileError(f"{path} holds a slamkit {header[_HEADER]}, expected a {kind}")
    if header["version"] != 1:
        raise LogFileError(f"{path} has version {header['version']} of slamkit's files, expected version 1")
    if not isinstance(header["facts"], dict):
        raise LogFileError(f"{path} holds no facts")
    return header["facts"]


def _check_facts(given: Mapping[str, Any], expected: Mapping[str, type | tuple[type, ...]]) -> None:
    _check_names("facts", given, set(expected), set(expected))
    for name, kinds in expected.items():
        allowed = kinds if isinstance(kinds, tuple) else (kinds,)
        if type(given[name]) not in allowed:
            names = " or ".join(kind.__name__ for kind in allowed)
            raise InputError(f"{name} is a {type(given[name]).__name__}, expected {names}")


def _check_names(what: str, given: Mapping[str, Any], allowed: set[str], needed: set[str]) -> None:
    if unknown := sorted(given.keys() - allowed):
        raise InputError(f"unknown {what}: {', '.join(unknown)}; expected {', '.join(sorted(allowed))}")
    if missing := sorted(needed - given.keys()):
        raise InputError(f"missing {what}: {', '.join(missing)}")


def _check_form(
    given: Mapping[str, tuple[np.dtype[Any], tuple[int, ...]]],
    fields: Mapping[str, Field],
    sizes: Mapping[str, int] | None,
) -> dict[str, int]:
    """Check names, dtypes and shapes; gives the named lengths."""
    _check_names("arrays", given, set(fields), {name for name, field in fields.items() if not field.optional})
    known = dict(sizes or {})
    for name, field in fields.items():
        if name not in given:
            continue
        dtype, shape = given[name]
        if len(shape) == len(field.shape):
            for length, of in zip(shape, field.shape, strict=True):
                if isinstance(of, str):
                    known.setdefault(of, length)
        expected = tuple(known.get(of, of) if isinstance(of, str) else of for of in field.shape)
        if dtype != np.dtype(field.dtype) or shape != expected:
            kind = np.dtype(field.dtype).name
            raise InputError(f"{name} has shape {shape} of {dtype}, expected {expected} of {kind}".replace("'", ""))
    return known


def _check_values(name: str, a: NDArray[Any], field: Field) -> None:
    if field.finite and a.dtype.kind == "f" and not np.isfinite(a).all():
        raise InputError(f"{name} holds a value that is not finite")
    for bound, beyond, word in ((field.lower, np.less, "least"), (field.upper, np.greater, "most")):
        if bound is not None and beyond(a, bound).any():
            raise InputError(f"{name} holds {a[beyond(a, bound)].flat[0]}, expected at {word} {bound:g}")
