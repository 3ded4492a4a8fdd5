"""Output for terminals that cannot show every character."""

from __future__ import annotations

import codecs
import os
import sys

__all__ = ["adapt_streams"]

#: ASCII text for the characters that slamkit and its libraries print.
ASCII = {
    "°": "deg", "±": "+-", "²": "2", "³": "3", "µ": "u", "·": "*", "×": "x", "√": "sqrt", "−": "-", "→": "->",
    "≤": "<=", "≥": ">=", "≈": "~", "…": "...", "–": "-", "—": "-", "“": '"', "”": '"', "‘": "'", "’": "'", "•": "*",
    "α": "alpha", "β": "beta", "θ": "theta", "ν": "nu", "π": "pi", "ρ": "rho", "σ": "sigma", "χ": "chi", "ω": "omega",
    "μ": "u", "₀": "0", "₁": "1", "₂": "2", "₃": "3", "₄": "4", "─": "-", "━": "=", "│": "|", "┃": "|", "║": "|",
    "═": "=", "❱": ">",
}  # fmt: skip
ASCII |= dict.fromkeys("┌┐└┘├┤┬┴┼╭╮╰╯┏┓┗┛┡┩╇┳┻╋╞╡╪", "+")


def _replace(error: UnicodeError) -> tuple[str, int]:
    """Error handler of a codec: the ASCII text of a character, or its code."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(ASCII.get(c) or c.encode("ascii", "backslashreplace").decode() for c in text), error.end


codecs.register_error("slamkit", _replace)


def adapt_streams() -> None:
    """Let stdout and stderr replace what they cannot encode. ``LANG=C`` and ``TERM=dumb`` ask for ASCII."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is None:
            continue
        dumb = os.environ.get("TERM") == "dumb" and stream.isatty()
        if dumb or _ascii_locale():
            reconfigure(encoding="ascii", errors="slamkit")
        elif not (stream.encoding or "").lower().startswith("utf"):
            reconfigure(errors="slamkit")


def _ascii_locale() -> bool:
    """Whether the user asks for the C locale.

    Python itself then encodes text as UTF-8: for LANG=C it sets LC_CTYPE to C.UTF-8, which is no wish of the user.
    """
    for name in ("LC_ALL", "LC_CTYPE", "LANG"):
        value = os.environ.get(name, "")
        if value and not (name == "LC_CTYPE" and value.upper() in ("C.UTF-8", "C.UTF8", "UTF-8")):
            return value in ("C", "POSIX")
    return False
