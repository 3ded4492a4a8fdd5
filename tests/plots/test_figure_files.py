"""Laws of figures as files and in notebooks."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from drawing import axes, run
from matplotlib.figure import Figure

from slamkit import plots
from slamkit.errors import InputError

pytestmark = pytest.mark.filterwarnings("error")


def test_jupyter_displays_a_figure_exactly_once() -> None:
    """IPython displays the value of a cell by its `_repr_png_`, and at the end of a cell every figure of pyplot."""
    code = """
import sys
import numpy as np
from slamkit import plots
from slamkit.logs import History
with plots.new_figure(3, 2) as figure:
    plots.plot_gauge(figure.subplots(), np.arange(3.0), {"ekf": np.ones(3)})
png = figure._repr_png_()
import matplotlib.pyplot
assert matplotlib.pyplot.get_fignums() == []
assert figure._repr_html_() is None
sys.stdout.buffer.write(png)
"""
    png = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert png.startswith(b"\x89PNG\r\n")
    width, height = (int.from_bytes(png[k : k + 4], "big") for k in (16, 20))
    assert 200 < width < 400 and 100 < height < 300


def test_the_overview_displays_itself() -> None:
    history, truth = run()
    figure: Any = plots.overview(history, truth=truth)
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_a_figure_can_be_pickled() -> None:
    history, truth = run()
    again = pickle.loads(pickle.dumps(plots.overview(history, truth=truth, size=(6.0, 5.0))))
    assert again._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_the_same_figure_gives_the_same_bytes(suffix: str, tmp_path: Any) -> None:
    history, truth = run(M=60)
    files = []
    for k in "ab":
        ax = axes()
        plots.plot_map(ax, history, truth)
        files.append(plots.save(ax.figure, tmp_path / f"{k}{suffix}", dpi=50))
    first, second = (file.read_bytes() for file in files)
    assert first == second
    assert len(first) > 5000


def test_dots_an_inch_set_the_size_of_a_png(tmp_path: Any) -> None:
    from matplotlib.image import imread

    figure = plots.overview(*run(M=60)[:1])
    low, high = (imread(plots.save(figure, tmp_path / f"{d}.png", dpi=d)).shape for d in (50, 100))
    np.testing.assert_allclose(np.array(high[:2]) / low[:2], 2, rtol=0.02)


def test_a_file_with_another_ending_or_a_missing_folder_is_refused(tmp_path: Any) -> None:
    with pytest.raises(InputError, match=r"'\.docx', expected one of \.png"):
        plots.save(Figure(), tmp_path / "a.docx")
    with pytest.raises(InputError, match="no folder"):
        plots.save(Figure(), tmp_path / "none" / "a.png")


def test_importing_plots_does_not_import_heavy_packages() -> None:
    code = "import sys, slamkit.plots; print(*sorted({'matplotlib', 'pandas', 'numba'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == ""
