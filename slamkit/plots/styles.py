"""One colour, line style and marker for each name, the same in every figure."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

from slamkit.errors import InputError


@dataclass(frozen=True)
class Style:
    """How one thing looks in every figure.

    Parameters
    ----------
    label : str
        Its name in legends.
    color : str
        Hexadecimal RGB.
    dashes : tuple of float
        Lengths of dash, gap, dash, … [line widths]. Empty for a solid line.
    marker : str
        A Matplotlib marker.
    """

    label: str
    color: str
    dashes: tuple[float, ...]
    marker: str

    @property
    def linestyle(self) -> str | tuple[float, tuple[float, ...]]:
        """The dash pattern in Matplotlib's form."""
        return (0.0, self.dashes) if self.dashes else "-"


#: The styles of truth, dead reckoning, landmarks and every built-in filter, by its command-line name. Add your own with
#: :func:`register_style`. The first colours are those of Okabe & Ito (Color Universal Design, 2008). The others were
#: chosen so that any two colours differ by more than 14 in CIELAB, for normal sight and for protanopia, deuteranopia
#: and tritanopia as simulated by Machado, Oliveira & Fernandes (2009).
STYLES: dict[str, Style] = {
    "truth": Style("truth", "#000000", (), "x"),
    "dead_reckoning": Style("dead reckoning", "#666666", (1.0, 1.4), "."),
    "landmarks": Style("landmarks", "#009E73", (), "+"),
    "ekf": Style("EKF", "#D55E00", (), "o"),
    "fej": Style("FEJ-EKF", "#0072B2", (5.0, 1.6), "s"),
    "oc": Style("OC-EKF", "#56B4E9", (5.0, 1.5, 1.0, 1.5), "^"),
    "invariant": Style("invariant EKF", "#CC79A7", (2.5, 1.2), "D"),
    "iterated": Style("iterated EKF", "#E69F00", (1.6, 1.0), "v"),
    "ideal": Style("ideal EKF", "#1A3A5A", (9.0, 2.0), "*"),
    "robocentric": Style("robocentric EKF", "#5C0029", (7.0, 1.5, 1.0, 1.5, 1.0, 1.5), "P"),
    "ukf": Style("UKF", "#785EF0", (9.0, 1.5, 3.0, 1.5), "X"),
    "ukf-full": Style("UKF, full", "#4B0092", (3.0, 3.0), "<"),
    "oc-ukf": Style("OC-UKF", "#3B3B00", (5.0, 1.2, 1.0, 1.2, 1.0, 1.2, 1.0, 1.2), ">"),
}

# Looks for all other names. The colours differ from each other and from those of STYLES by the same limit. The numbers
# of colours, dash patterns and markers have no common factor, so that 210 names have different looks.
_COLORS = ("#406840", "#8000F8", "#789850", "#A80090", "#0000B8", "#A85020", "#A878F0")
_DASHES = (
    (12.0, 2.0),
    (2.0, 1.0, 2.0, 3.0),
    (6.0, 1.0, 2.0, 1.0),
    (10.0, 1.5, 1.0, 1.5, 1.0, 1.5),
    (4.0, 1.0, 1.0, 1.0, 4.0, 3.0),
    (1.0, 1.0, 1.0, 3.0),
)
_MARKERS = ("p", "d", "h", r"$\clubsuit$", r"$\spadesuit$")

_looks: dict[str, int] = {}  # name without a registered style → number of its look


def style(name: str) -> Style:
    """The style of a filter, or of anything else with a name.

    A name in :data:`STYLES` has the style registered there. Any other name gets a style of its own. It depends on the
    name alone, so that it is the same in every process, unless an earlier name of this process has that colour
    already: then the next free colour is taken. Once all seven colours are in use they return with other dashes and
    markers.

    Parameters
    ----------
    name : str
        The command-line name of a filter, or its name in a study.

    Returns
    -------
    Style
    """
    if name in STYLES:
        return STYLES[name]
    if name not in _looks:
        n, taken = len(_COLORS), set(_looks.values())
        start, first = crc32(name.encode()), n * (len(_looks) // n)
        _looks[name] = next(k for i in range(n) if (k := first + (start + i) % n) not in taken)
    k = _looks[name]
    # The label shows the name as it is: Matplotlib reads $…$ as mathematics and hides labels that begin with _.
    label = (" " if name.startswith("_") else "") + name.replace("$", r"\$")
    return Style(label, _COLORS[k % len(_COLORS)], _DASHES[k % len(_DASHES)], _MARKERS[k % len(_MARKERS)])


def register_style(name: str, style: Style) -> None:
    """Choose the style of a name: of a filter of your own, or of a built-in one.

    Parameters
    ----------
    name : str
        The command-line name of the filter, or its name in a study.
    style : Style
        It replaces an earlier one. Figures that are drawn already do not change.

    Raises
    ------
    InputError
        The name is not text, or `style` is not a Style or has a colour, dashes or a marker that Matplotlib lacks.
    """
    from matplotlib.colors import is_color_like
    from matplotlib.markers import MarkerStyle

    if not isinstance(name, str) or not name:
        raise InputError(f"the name of a style is {name!r}, expected text")
    try:
        is_valid = is_color_like(style.color) and min(style.dashes, default=1.0) > 0 and bool(MarkerStyle(style.marker))
    except (AttributeError, TypeError, ValueError):
        is_valid = False
    if not is_valid:
        raise InputError(
            f"the style of {name!r} is {style!r}, expected a Style with a color and a marker of Matplotlib's and with "
            "dashes that are lengths above 0"
        )
    STYLES[name] = style
