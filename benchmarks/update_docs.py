"""Copy the tables that the pages in docs/ quote from benchmarks/results/. `make bench` runs it after the benchmarks.

A page quotes a table by a comment, and the table follows it:

    <!-- table 1 of benchmarks/results/scaling.md: N | slamkit, run -->

The number counts the tables of the file. The column headings after the colon are optional; without them every column
is quoted.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: A comment, and the table that follows it where there is one.
QUOTE = re.compile(r"^(<!-- table (\d+) of (\S+?)(?:: (.+))? -->)\n(?:\|.*\n)*", re.MULTILINE)


def tables(text: str) -> list[list[list[str]]]:
    """Cells of every Markdown table: table, row, column. The second row of a table is its alignment."""
    found = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    return [[[cell.strip() for cell in line.strip(" |").split(" | ")] for line in t.splitlines()] for t in found]


def quoted(match: re.Match[str]) -> str:
    """A comment followed by the table that it names."""
    comment, number, name, columns = match.groups()
    rows = tables((ROOT / name).read_text(encoding="utf-8"))[int(number) - 1]
    rows[1] = re.findall(r":?-+:?", "".join(f"{cell} " for cell in rows[1]))
    keep = [rows[0].index(heading) for heading in columns.split(" | ")] if columns else range(len(rows[0]))
    return "\n".join([comment, *(f"| {' | '.join(row[k] for k in keep)} |" for row in rows)]) + "\n"


def updated(page: str) -> str:
    """Text of a page with every quoted table as it is in the results now."""
    return QUOTE.sub(quoted, page)


def main() -> None:
    for path in sorted((ROOT / "docs").rglob("*.md")):
        page = path.read_text(encoding="utf-8")
        if (new := updated(page)) != page:
            path.write_text(new, encoding="utf-8")
            print(f"updated {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
