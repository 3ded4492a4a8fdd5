"""The pages: links lead somewhere, code runs and prints what is written, quoted tables are those of the results."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from slamkit.filters import FILTERS

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "tutorials").glob("*.md"))]
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]
#: A Python block, and the block with its output that follows it.
CODE = re.compile(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = [
    (name, *found) for name, page in zip(NAMES, PAGES, strict=True) for found in CODE.findall(page.read_text("utf-8"))
]


def anchors(text: str) -> set[str]:
    """Anchors of the headings of a page, as GitHub forms them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", NAMES)
def test_every_link_leads_to_a_file_and_a_heading(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if target.startswith(("https://", "http://")):
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path).resolve() if path else page
        assert found.exists(), f"{target} does not exist"
        if anchor:
            assert anchor in anchors(found.read_text("utf-8")), f"{target}: there is no such heading"


@pytest.mark.parametrize(("name", "code", "printed"), BLOCKS, ids=[f"{block[0]}-{k}" for k, block in enumerate(BLOCKS)])
def test_the_code_of_a_page_prints_what_the_page_says(name: str, code: str, printed: str, tmp_path: Path) -> None:
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == printed


@pytest.mark.parametrize("name", NAMES)
def test_every_python_block_of_a_page_is_run(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    assert text.count("```python") == sum(block[0] == name for block in BLOCKS), "a block has no output block after it"


def test_quoted_tables_are_those_of_the_results() -> None:
    spec = importlib.util.spec_from_file_location("update_docs", ROOT / "benchmarks" / "update_docs.py")
    assert spec is not None and spec.loader is not None
    update_docs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(update_docs)
    quotes = 0
    for page in PAGES:
        text = page.read_text("utf-8")
        assert update_docs.updated(text) == text, (
            f"{page.name} is older than its results: run benchmarks/update_docs.py"
        )
        quotes += len(update_docs.QUOTE.findall(text))
    assert quotes >= 6


def test_the_readme_is_short_and_names_both_commands() -> None:
    text = (ROOT / "README.md").read_text("utf-8")
    assert text.count("\n") <= 150
    assert all(part in text for part in ("pip install", "make demo", "make test"))


def test_the_readme_lists_every_estimator() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \| `(\w+)` \|", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    assert set(rows) == {(name, kind.__name__) for name, kind in FILTERS.items()}


def test_the_glossary_defines_every_term_and_links_to_its_use() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text("utf-8")
    terms = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    names = [term.splitlines()[0] for term in terms]
    wanted = (
        "gauge NEES NIS ATE RPE nullity active resting flush slot sighting scan rejected gate clutter batch sequential"
    )
    assert {*wanted.split(), "first estimate", "dead reckoning", "map frame"} <= set(names)
    assert names == sorted(names, key=str.lower), "the terms are in alphabetical order"
    for name, term in zip(names, terms, strict=True):
        assert re.search(r"\]\([^)]+\)|`slamkit\.", term), f"{name}: no link to where it is used"
