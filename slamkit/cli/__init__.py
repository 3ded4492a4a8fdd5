"""The command line: each command parses its options, calls the library and prints."""

from slamkit.cli.app import app, main

__all__ = ["app", "main"]
