"""Short texts about logs and histories, for a console and for a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from slamkit.arrays import Array


def count(n: int, what: str) -> str:
    """``1 control``, ``2 controls``."""
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def span(*times: Array) -> str:
    """The first and the last of some times, such as ``0 … 250 s``; empty where there are none."""
    together = np.concatenate(times)
    return f"{together.min():g} … {together.max():g} s" if len(together) else ""


def html_table(title: str, rows: Mapping[str, str]) -> str:
    """A small table of two columns, for ``_repr_html_``."""
    body = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in rows.items()
    )
    return f"<table><caption>{escape(title)}</caption>{body}</table>"
