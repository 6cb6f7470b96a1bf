"""Python blocks of the documentation run, shell examples name what exists, figures come from tables
of benchmarks."""

import re
import runpy
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.config import PRESETS
from tests.street import angles, street

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "design").glob("*.md")]
)


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_python_blocks_run(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    image = np.full((100, 2154), 12.0, np.float32)
    image.tofile("drive.bin")
    (tmp_path / "night.toml").write_text("[prc.surfaces]\ngamma = 1\n")
    for name in ("true.csv", "found.csv"):
        (tmp_path / name).write_text("kind,x,y\ncar,0,0\npole,9,0\ncar,5,0\n")
    import prc_cli

    np.savez("source.npz", range_m=street(), angle_deg=np.rad2deg(angles()))
    prc_cli.classify("source.npz", "drive.laz")
    names = {"ranges": street(), "angles": np.rad2deg(angles()), "range_image": street()}
    for code in blocks(path, "python"):
        exec(compile(code, str(path), "exec"), names)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_shell_examples_name_what_exists(path):
    for text in [*blocks(path, "console"), *blocks(path, "text")]:
        for line in text.replace("\\\n", " ").splitlines():
            # a sentence of a help text: examples have four blanks
            if line.startswith(("  prc ", " " * 6)):
                continue
            command = re.sub(r"^\s*(Example: )?\$? ?", "", line).split(" # ")[0].split(" > ")[0]
            if command.startswith("prc "):
                check_command(shlex.split(command)[1:], line)


def check_command(words: list[str], line: str) -> None:
    if words[0].startswith("-") or words[0].isupper():
        return
    assert words[0] in COMMANDS, line
    context = click.Context(cli)
    command = cli.get_command(context, words[0])
    while isinstance(command, click.Group) and len(words) > 1 and words[1] in command.commands:
        command = command.commands[words[1]]
        words = words[1:]
    assert command is not None
    known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    for word in words[1:]:
        if word.startswith("-") and not re.fullmatch(r"-?[0-9.]+", word):
            assert word.split("=")[0] in known, line


def test_every_parameter_and_class_is_in_the_reference():
    configuration = (ROOT / "docs/reference/configuration.md").read_text(encoding="utf-8")
    for table in (
        "input",
        "layout",
        "prc.support",
        "prc.background",
        "prc.surfaces",
        "classes",
        "output",
    ):
        assert f"## [{table}]" in configuration
    algorithm = (ROOT / "design/prc_2019.md").read_text(encoding="utf-8")
    for table in ("support", "background", "components", "surfaces", "urban", "forest"):
        assert f"`[prc.{table}]`" in algorithm


def test_every_preset_is_in_the_page_that_chooses():
    page = (ROOT / "docs/methods.md").read_text(encoding="utf-8")
    assert all(re.search(rf"(--preset |or )`?{preset}`", page) for preset in PRESETS)


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
def page(tmp_path):
    (tmp_path / "x_figures.md").write_text(FIGURES, encoding="utf-8")
    return tmp_path / "page.md"


def fill(page: Path, text: str) -> str:
    filler: Callable[[Path, str, Path], str] = GENERATE["with_figures"]
    return filler(page, text, page.parent)


@pytest.mark.parametrize(
    "shown, title, expected",
    [
        ("0.5", "ours > car recall", "0.5"),
        ("0.99", "ours > car precision", "0.91"),
        ("0.9", "the paper > car precision", "1.0"),
        ("9", "a > up > car recall", "12"),
        ("9", "a > down > car recall", "1234"),
        ("9.9", "a > down > share of car recall", "7.5"),
        ("0.10", "most of * > car precision", "0.96"),
        ("1", "least of * > span", "4"),
        ("1", "Streets: all > ours > span", "4"),
        ("0.10", "ours > car precision / span", "0.23"),
    ],
)
def test_a_figure_is_written_from_its_cell(
    page,
    shown,
    title,
    expected,
):
    text = f"It is {shown}<!-- x_figures.md#streets-all: {title} --> of 3."
    assert fill(page, text) == text.replace(f" {shown}<", f" {expected}<")


def test_figures_of_all_pages_are_those_of_the_tables():
    pages: dict[Path, str] = GENERATE["prose"]()
    assert {path.name for path in pages} >= {
        "accuracy.md",
        "sequential_angle.md",
        "simulation.md",
        "speed.md",
    }
    for path, text in pages.items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run python docs/generate.py"


@pytest.mark.parametrize("name", ["README.md", "docs/outputs.md"])
def test_the_promise_about_las_names_the_formats_that_are_upgraded(name):
    """tests/formats/las/test_rewrite.py upgrades them."""
    text = " ".join((ROOT / name).read_text(encoding="utf-8").split())
    assert "ormats 0 to 5" in text
    assert "#las-of-point-formats-0-to-5" in text
