"""Make a figure in slamkit's style, and write one to a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamkit.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Metadata that would differ between two files of the same figure is left out.
_FORMATS: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
    ".svg": {"Date": None, "Creator": None},
}

_PAPER: Any = {
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "lines.linewidth": 1.2,
    "mathtext.default": "regular",
}


@contextmanager
def new_figure(width: float, height: float) -> Iterator[Figure]:
    """An empty figure with the constrained layout; slamkit's font sizes and line widths apply inside the block.

    Parameters
    ----------
    width, height : float
        Size [in].

    Yields
    ------
    Figure
        Jupyter displays it when it is the value of a cell.
    """
    import matplotlib

    from slamkit.plots.notebook import NotebookFigure

    with matplotlib.rc_context(_PAPER):
        yield NotebookFigure(figsize=(width, height), layout="constrained")


def save(figure: Figure, path: str | Path, dpi: float = 300.0) -> Path:
    """Write a figure to a file, cropped to its content. The same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
    path : str or Path
        Ends in .png, .pdf or .svg. Its folder must exist.
    dpi : float
        Dots per inch of a PNG, and of the rasterised parts of a PDF or SVG.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        The file has another ending, or its folder does not exist.
    """
    import matplotlib

    path = Path(path)
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"figure file {path} ends in {path.suffix!r}, expected one of {', '.join(_FORMATS)}")
    if not path.parent.is_dir():
        raise InputError(f"figure file {path}: there is no folder {path.parent}")
    # Type 42 embeds whole TrueType fonts, which journals ask for. The salt makes the ids inside an SVG repeatable.
    with matplotlib.rc_context({"svg.hashsalt": "slamkit", "pdf.fonttype": 42}):
        figure.savefig(path, dpi=dpi, bbox_inches="tight", pad_inches=0.05, metadata=_FORMATS[path.suffix.lower()])
    return path
