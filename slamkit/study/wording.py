"""Numbers and messages as they stand in sentences and tables."""

from __future__ import annotations

import re

_LONGEST = 200


def count(n: int, noun: str) -> str:
    """A number with its noun, in the plural if need be."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def short(text: str | None) -> str:
    """A message that fits into a table: on one line, without matrices, cut at 200 characters."""
    line = re.sub(r"(?:array\()?\[\s*\[.*?\]\s*\](?:,\s*dtype=\w+)?\)?", "[matrix]", text or "", flags=re.DOTALL)
    line = re.sub(r"(?:array\()?\[[^\[\]]{60,}\](?:,\s*dtype=\w+)?\)?", "[values]", line, flags=re.DOTALL)
    line = " ".join(line.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 2]} …"
