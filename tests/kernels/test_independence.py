"""The slow twins share no code with the kernels that they check."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from prc_cli.kernels import KERNELS
from tests.kernels.twins import twin_module

ROOT = Path(__file__).resolve().parents[2]
TWINS = sorted(path for folder in ("prc_cli/reference", "tests/oracles") for path in (ROOT / folder).rglob("*.py"))
ALLOWED = ("prc_cli.core", "prc_cli.reference", "tests.oracles", "numpy", "scipy", "skimage")
"""Beside the standard library and thresholds. ``prc_cli.core`` imports no kernel either: import-linter sees to it."""


THRESHOLDS = tuple(
    f"prc_cli.{room}.thresholds."
    for room in ("methods.fused", "methods.rings", "methods.sequential_angle", "simulation")
)


def imported(path: Path) -> Iterator[str]:
    """Full names of what a file imports, modules or things within them."""
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            yield from (".".join([*above, *filter(None, [node.module]), alias.name]) for alias in node.names)


def is_allowed(name: str) -> bool:
    within = name.startswith(THRESHOLDS) or any(name == one or name.startswith(one + ".") for one in ALLOWED)
    top = name.partition(".")[0]
    return (
        within or name.startswith(THRESHOLDS) or (top in sys.stdlib_module_names and top not in ("importlib", "runpy"))
    )


@pytest.mark.parametrize("path", TWINS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_twin_imports_neither_kernel_nor_stage(path: Path) -> None:
    assert not [name for name in imported(path) if not is_allowed(name)]
    assert "__import__" not in path.read_text(encoding="utf-8")


def test_the_twin_of_every_kernel_is_looked_at() -> None:
    assert {Path(str(twin_module(name).__file__)) for name in KERNELS} <= set(TWINS)


@pytest.mark.parametrize("module", sorted(set(KERNELS.values())))
def test_a_module_of_kernels_imports_no_other(module: str) -> None:
    """Two processes would compile the other at the same time, and its constants would go stale in the cache."""
    path = ROOT / f"{module.replace('.', '/')}.py"
    assert not [name for name in imported(path) if name.startswith(tuple(f"{other}." for other in KERNELS.values()))]


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("from prc_cli import kernels", "prc_cli.kernels"),
        ("from ...methods.prc import support_loops", "prc_cli.methods.prc.support_loops"),
        ("def f():\n    import prc_cli.methods.prc.support", "prc_cli.methods.prc.support"),
        ("from prc_cli.core_of_kernels import one", "prc_cli.core_of_kernels.one"),
        ("import importlib", "importlib"),
        ("import numba", "numba"),
    ],
)
def test_hidden_imports_are_seen(line: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "prc_cli" / "reference" / "prc" / "one.py"
    path.parent.mkdir(parents=True)
    path.write_text(line)
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    assert list(imported(path)) == [name]
    assert not is_allowed(name)
