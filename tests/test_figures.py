"""Figures in prose come from the tables of the benchmarks: docs/generate.py fills and checks them."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
GENERATE: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "generate.py"))
FIGURES = """<!-- written by a benchmark -->

## Streets: all

| | car recall | precision | span |
|---|---:|---:|---:|
| ours | 0.527 (0.40–0.60) | 0.913 | 4 |
| *the paper* | 0.867 | 0.962 | 8 |

### One

| street | way | car recall |
|---|---|---:|
| a | up | 12.5% |
| a | down | 1,234 (7.5%) |
"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    (tmp_path / "x_figures.md").write_text(FIGURES, encoding="utf-8")
    return tmp_path / "page.md"


def fill(page: Path, text: str) -> str:
    filler: Callable[[Path, str], str] = GENERATE["with_figures"]
    return filler(page, text)


@pytest.mark.parametrize(
    ("shown", "title", "expected"),
    [
        (".5", "ours > car recall", ".5"),
        (".99", "ours > car precision", ".91"),
        ("0.9", "the paper > car precision", "1.0"),
        ("9", "a > up > car recall", "12"),
        ("9", "a > down > car recall", "1234"),
        ("9.9", "a > down > share of car recall", "7.5"),
        (".10", "most of * > car precision", ".96"),
        ("1", "least of * > span", "4"),
        ("1", "Streets: all > ours > span", "4"),
        (".10", "ours > car precision / span", ".23"),
    ],
)
def test_a_figure_is_written_from_its_cell(page: Path, shown: str, title: str, expected: str) -> None:
    text = f'It is [{shown}](x_figures.md#streets-all "{title}") of 3.'
    assert fill(page, text) == text.replace(f"[{shown}]", f"[{expected}]")


@pytest.mark.parametrize(
    ("title", "problem"),
    [
        ("nobody > car recall", "no row and column of this name"),
        ("ours > boat recall", "no row and column of this name"),
        ("a > * > car recall", "2 rows of this name"),
    ],
)
def test_a_figure_that_is_not_there_is_named(page: Path, title: str, problem: str) -> None:
    with pytest.raises(ValueError, match=f"page.md: .5 of x_figures.md#streets-all .*{problem}"):
        fill(page, f'[.5](x_figures.md#streets-all "{title}")')
    with pytest.raises(ValueError, match="no table below such a heading"):
        fill(page, '[.5](x_figures.md#lanes "ours > span")')


def test_rows_of_a_table_are_copied(page: Path) -> None:
    text = "<!-- rows of x_figures.md#streets-all -->\n\n| | a |\n|---|---|\n| *the paper* | old |\n"
    assert "| *the paper* | 0.867 | 0.962 | 8 |\n" in fill(page, text)
    with pytest.raises(ValueError, match="no row 'theirs'"):
        fill(page, text.replace("*the paper*", "theirs"))


def test_figures_of_all_pages_are_those_of_the_tables() -> None:
    pages: dict[Path, str] = GENERATE["prose"]()
    assert {path.name for path in pages} >= {"accuracy.md", "sequential_angle.md", "simulation.md", "speed.md"}
    for path, text in pages.items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run python docs/generate.py"
