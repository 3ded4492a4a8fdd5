"""The figure class. This module imports Matplotlib, so it is imported only when a figure is made."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A Matplotlib figure that Jupyter displays when it is the value of a cell.

    It is unknown to pyplot, so Jupyter does not show it a second time at the end of the cell.
    """

    def _repr_png_(self) -> bytes:
        """The figure as PNG, for IPython's display."""
        png = BytesIO()
        self.savefig(png, format="png", bbox_inches="tight", pad_inches=0.05)
        return png.getvalue()
