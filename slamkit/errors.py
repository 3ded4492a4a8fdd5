"""Every error that slamkit raises on purpose derives from :class:`SlamkitError`."""

from __future__ import annotations


class SlamkitError(Exception):
    """Root of slamkit's own errors; catch it to catch them all."""


class InputError(SlamkitError, ValueError):
    """A value that was given does not fit: what was given, what was expected, and where."""


class LogFileError(InputError):
    """A file of a log cannot be read: the message names the file, the line and what was expected."""


class ModelError(SlamkitError):
    """A motion or sensor model does not keep its protocol, or gave a value that no filter can use."""


class DivergenceError(SlamkitError):
    """The numbers of a filter left the range in which they mean anything."""


class MemoryCapError(SlamkitError, MemoryError):
    """Growing the map would pass the configured cap on memory."""


class UnsupportedError(SlamkitError, TypeError):
    """The call belongs to the base class, but makes no sense here; the message names what to call instead."""


class AssignmentError(SlamkitError, AttributeError):
    """An attribute that does not exist, or cannot be changed after construction, was assigned."""
