from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from prc_cli.evaluation.latex import as_latex, escape
from tests import patience
from tests.evaluation import samples

NASTY = '50%_a&b {x} $y$ #1 ^~\\end{table} <|>"\n%.npy'


def test_every_row_has_as_many_cells_as_its_table_columns() -> None:
    text = as_latex(samples.evaluation(part=NASTY))
    for columns, body in re.findall(r"\\begin\{tabular\}\{(\w+)\}\n(.*?)\\end\{tabular\}", text, re.DOTALL):
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert rows
        assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(columns)}


def test_nothing_of_a_user_is_a_command() -> None:
    shown = escape(NASTY)
    assert "\n" not in shown
    assert r"\end{table}" not in shown
    assert not re.search(r"(?<!\\)[%$&#_^~]", shown.replace("{}", ""))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex here")
def test_latex_takes_the_tables(tmp_path: Path) -> None:
    found = samples.evaluation(predicted=NASTY, mapping="a_b#%.toml", part=NASTY)
    document = (
        "\\documentclass{article}\n\\usepackage[T1]{fontenc}\n\\usepackage{booktabs}\n\\begin{document}\n"
        f"{as_latex(found)}\\end{{document}}\n"
    )
    (tmp_path / "page.tex").write_text(document, encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape", "page.tex"]
    result = patience.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout[-2000:]
