"""A study as text: Markdown, CSV, LaTeX, HTML."""

from __future__ import annotations

import csv
import html
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from slamkit.logs import PathLike, replacing
from slamkit.study.summary import with_split
from slamkit.study.wording import count, short

if TYPE_CHECKING:
    from slamkit.study.study import Study

#: Heading → key of the summary, digits.
_ACCURACY = {
    "pose NEES (3)": ("pose_nees", 2),
    "heading NEES (1)": ("heading_nees", 2),
    "position RMSE [m]": ("position_rmse_m", 3),
    "heading RMSE [°]": ("heading_rmse_deg", 2),
    "landmark NEES (2)": ("landmark_nees", 2),
    "landmark RMSE [m]": ("landmark_rmse_m", 3),
    "NIS per dof": ("nis_per_dof", 2),
}
_SHORT = {
    "position RMSE [m]": ("position_rmse_m", 3),
    "heading RMSE [°]": ("heading_rmse_deg", 2),
    "pose NEES (3)": ("pose_nees", 2),
    "gauge NEES (3)": ("gauge_nees", 2),
    "relative NEES per dof": ("relative_nees_per_dof", 2),
    "NIS per dof": ("nis_per_dof", 2),
}


def markdown_text(study: Study) -> str:
    """See :meth:`slamkit.study.Study.report`."""
    summary = study.summary()
    lines = [f"# {study.world}: {count(len(summary), 'filter')}, {_runs_and_steps(study)}", ""]
    if study.simulated:
        lines += [f"Seed {study.seed}; every filter ran on the same logs. ± is one standard error over the runs.", ""]
    else:
        lines += ["A recorded log. If it has a truth, errors are taken after alignment with it.", ""]
    if said := study.findings():
        lines += [" ".join(said), ""]
    lines += _accuracy(summary) + _gauge(study, summary)
    if study.failures:
        far = f"position error above {float(study.facts['diverged_at']):g} times the world's size"
        rows = [[t.filter, str(t.number), short(t.error or far)] for t in study.failures]
        lines += ["## Failed and diverged trials", "", *_markdown(["filter", "trial", "why"], rows), ""]
    left_out = [[t.filter, f"trial {t.number}", short(t.note)] for f in study.trials.values() for t in f if t.note]
    left_out += [[c.filter, "gauge check", short(c.error)] for c in study.gauge.values() if c.error]
    if left_out:
        lines += ["## Numbers that are left out", "", *_markdown(["filter", "where", "what and why"], left_out), ""]
    return "\n".join(lines)


def csv_text(study: Study) -> str:
    """See :meth:`slamkit.study.Study.to_csv`."""
    rows = study.table()
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({n: None if isinstance(v, float) and math.isnan(v) else v for n, v in row.items()})
    return text.getvalue()


def latex_text(study: Study) -> str:
    """See :meth:`slamkit.study.Study.to_latex`."""
    rows = [
        [_latex(name), *(_cell(v, key, digits, r"$\pm$") for key, digits in _SHORT.values())]
        for name, v in study.summary().items()
    ]
    head = ["filter", *map(_latex, _SHORT)]
    return "\n".join(
        [
            rf"\begin{{tabular}}{{l{'r' * len(_SHORT)}}}",
            r"\hline",
            " & ".join(head) + r" \\",
            r"\hline",
            *(" & ".join(row).replace("–", "--") + r" \\" for row in rows),
            r"\hline",
            r"\end{tabular}",
            "",
        ]
    )


def html_text(study: Study) -> str:
    """The main numbers as an HTML table, for notebooks."""

    def line(tag: str, cells: Iterable[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in cells) + "</tr>"

    rows = [
        line("td", [name, *(_cell(v, key, digits) for key, digits in _SHORT.values())])
        for name, v in study.summary().items()
    ]
    caption = html.escape(f"{size(study)}{failed(study)}")
    head = line("th", ["filter", *_SHORT])
    return f"<table><caption>{caption}</caption><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"


def size(study: Study) -> str:
    """World, runs and steps."""
    return f"{study.world}: {_runs_and_steps(study)}"


def failed(study: Study) -> str:
    """How many trials failed or diverged, after a semicolon; empty if none did."""
    if study.all_failed:
        return "; every trial failed"
    return f"; {count(len(study.failures), 'trial')} failed or diverged" if study.failures else ""


def written(text: str, path: PathLike | None) -> str:
    """The text, which is also written to `path` if there is one."""
    if path is not None:
        with replacing(path) as file:
            file.write(text.encode())
    return text


def _accuracy(summary: Mapping[str, Mapping[str, Any]]) -> list[str]:
    head = ["filter", *_ACCURACY, "median pose NEES", "share above 6", "µs a step", "diverged"]
    rows = [
        [
            name,
            *(_cell(v, key, digits) for key, digits in _ACCURACY.values()),
            _number(v["pose_nees_median"], ".2f"),
            _number(v["pose_nees_above_6"], ".0%"),
            _number(v["seconds_per_step"], ".1f", 1e6),
            f"{v['diverged']} of {v['runs']}",
        ]
        for name, v in summary.items()
    ]
    lines = ["## Accuracy and consistency", "", *_markdown(head, rows), ""]
    if bounds := _bounds(summary, "pose_nees"):
        lines += [f"A consistent filter's mean pose NEES at one step lies in {bounds} (95 %).", ""]
    return lines


def _gauge(study: Study, summary: Mapping[str, Mapping[str, Any]]) -> list[str]:
    head = ["filter", "relative NEES per dof", "gauge NEES (3)", "median gauge NEES", "nullity"]
    head += ["gauge deviation falls by", "stochastic gauge [m]", "equivariance"]
    rows = [
        [
            name,
            _cell(v, "relative_nees_per_dof", 2),
            _cell(v, "gauge_nees", 2),
            _number(v["gauge_nees_median"], ".2f"),
            _number(v["nullity"], "d"),
            _number(v["gauge_deviation_drop"], ".1e"),
            _number(v["stochastic_gauge_m"], ".1e"),
            _number(v["equivariance"], ".1e"),
        ]
        for name, v in summary.items()
    ]
    lines = ["## The gauge", "", *_markdown(head, rows), ""]
    relative, gauge = _bounds(summary, "relative_nees"), _bounds(summary, "gauge_nees")
    if relative:
        also = f" and its gauge NEES in {gauge}" if gauge else ""
        lines += [f"A consistent filter's relative NEES per dof lies in {relative}{also} (95 %).", ""]
    return lines + [line for said in _observability(study) for line in (said, "")]


def _observability(study: Study) -> list[str]:
    """What the gauge check and the trials show about what is observable in this study."""
    n, said = study.unobservable, []
    if n == 3:
        said.append(
            "Moving robot and map together (two directions of translation and a rotation: the gauge) changes no "
            "measurement of these models, so all three directions are unobservable. A filter that does not claim to "
            "have learnt them has nullity 3 or more, and its gauge deviation never falls."
        )
    elif n is not None:
        left = {0: "none", 1: "one", 2: "two"}[n]
        said.append(
            f"The models anchor the map: {left} of the gauge's three directions stay unobservable. A filter that uses "
            f"what the models measure, and claims no more, has nullity {n} or more. Its gauge deviation may "
            "fall, and its stochastic gauge and equivariance need not be 0."
        )
    ideal = study.gauge["ideal"].nullity if "ideal" in study.gauge else None
    if ideal is not None and n is not None and ideal > n:
        said.append(
            f"The ideal filter, which linearises at the truth, has nullity {ideal}: this run leaves further directions "
            "unobserved, such as landmarks that are not tied to the others."
        )
    dof = {t.gauge_dof for name in study.filters for t in with_split(study.finished(name))}
    if dof and max(dof) < 3:
        said.append(
            f"The start fixes the gauge in part: at the end of the runs it has {max(dof)} degrees of freedom. Every "
            "gauge check, however, starts with an uncertain pose (0.1 m, 0.1 m, 5°)."
        )
    return said


def _bounds(summary: Mapping[str, Mapping[str, Any]], key: str) -> str:
    """The first filter's bounds that there are, as text."""
    for v in summary.values():
        if v[f"{key}_low"] is not None:
            return f"[{v[f'{key}_low']:.2f}, {v[f'{key}_high']:.2f}]"
    return ""


def _runs_and_steps(study: Study) -> str:
    return f"{count(study.runs, 'run')} of {count(len(study.times), 'step')}"


def _number(value: float | None, form: str, scale: float = 1) -> str:
    return "–" if value is None else format(scale * value, form)


def _cell(values: Mapping[str, Any], key: str, digits: int, plus_minus: str = "±") -> str:
    if values[key] is None or values[f"{key}_se"] is None:
        return _number(values[key], f".{digits}f")
    return f"{values[key]:.{digits}f} {plus_minus} {values[f'{key}_se']:.{digits}f}"


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(c.replace("|", "\\|").replace("\n", " ") for c in cells) + " |"

    return [line(head), line(["---"] * len(head)), *map(line, rows)]


_LATEX = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "°": r"$^\circ$",
}


def _latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)
