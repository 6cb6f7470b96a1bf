"""Every Python block of the documentation runs; every shell example names commands and options that exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import numpy as np
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.config import PRESETS
from tests.street import angles, street

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


WORDS = 35_000
"""What the manual may have; to raise it is a decision with a reason in its commit."""


def is_written_by_hand(path: Path) -> bool:
    generated = path.parent.name == "figures" or path.read_text(encoding="utf-8").startswith("<!-- written by")
    return not generated and path.parent != ROOT


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_python_blocks_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    image = np.full((100, 2154), 12.0, np.float32)
    image.tofile("drive.bin")
    (tmp_path / "night.toml").write_text("[prc.surfaces]\ngamma = 1\n")
    import prc_cli

    np.savez("source.npz", range_m=street(), angle_deg=np.rad2deg(angles()))
    prc_cli.classify("source.npz", "drive.laz")
    names = {"ranges": street(), "angles": np.rad2deg(angles()), "range_image": street()}
    for code in blocks(path, "python"):
        exec(compile(code, str(path), "exec"), names)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_shell_examples_name_what_exists(path: Path) -> None:
    for text in [*blocks(path, "console"), *blocks(path, "text")]:
        for line in text.replace("\\\n", " ").splitlines():
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
        command, words = command.commands[words[1]], words[1:]
    assert command is not None
    known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    for word in words[1:]:
        if word.startswith("-") and not re.fullmatch(r"-?[0-9.]+", word):
            assert word.split("=")[0] in known, line


def test_every_parameter_and_class_is_in_the_reference() -> None:
    configuration = (ROOT / "docs/reference/configuration.md").read_text(encoding="utf-8")
    for table in ("input", "layout", "prc.support", "prc.background", "prc.surfaces", "classes", "output"):
        assert f"## [{table}]" in configuration
    algorithm = (ROOT / "docs/algorithm.md").read_text(encoding="utf-8")
    for table in ("support", "background", "components", "surfaces", "urban", "forest"):
        assert f"`[prc.{table}]`" in algorithm


def test_every_preset_is_in_the_page_that_chooses() -> None:
    page = (ROOT / "docs/getting_started.md").read_text(encoding="utf-8")
    assert all(re.search(rf"(--preset |or )`?{preset}`", page) for preset in PRESETS)


def test_the_manual_stays_as_long_as_one_reads() -> None:
    words = {path.name: len(path.read_text(encoding="utf-8").split()) for path in PAGES if is_written_by_hand(path)}
    assert sum(words.values()) <= WORDS, words
