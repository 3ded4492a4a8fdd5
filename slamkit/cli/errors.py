"""How a command ends: its exit code, and the one line that says why it failed."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from slamkit.errors import SlamkitError

__all__ = ["FAILED", "TRACEBACK", "WRONG_USE", "RunError", "fail", "reason", "running"]

FAILED = 1  #: the command began its work and failed: a run diverged, a download broke off, a disk was full
WRONG_USE = 2  #: an option or a file that was given does not fit
TRACEBACK = "SLAMKIT_TRACEBACK"  #: environment variable: show tracebacks, for filters and models of one's own


class RunError(SlamkitError):
    """The command was used correctly, but its work failed: exit code 1."""


@contextmanager
def running() -> Iterator[None]:
    """Turn every error inside into a :class:`RunError`."""
    try:
        yield
    except RunError:
        raise
    except Exception as error:
        raise RunError(reason(error)) from error


def reason(error: BaseException) -> str:
    """What an error says. The type is named where slamkit did not raise the error on purpose."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    text = str(error)
    if isinstance(error, SlamkitError | OSError) and text:
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def fail(message: str, code: int, error: BaseException | None = None) -> NoReturn:
    """Print one line on stderr and leave with this exit code."""
    if error is not None and os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    # Click's echo would encode as UTF-8 for an ASCII terminal.
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)
