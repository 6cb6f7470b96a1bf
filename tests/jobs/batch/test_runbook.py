"""The runbook has an entry for everything that a run may report."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import prc_cli.core.errors
import prc_cli.jobs.batch
from prc_cli.jobs.batch.report import EXIT_CODES
from prc_cli.jobs.batch.types import Problem

ROOT = Path(__file__).resolve().parents[3]
RUNBOOK = (ROOT / "docs" / "runbook.md").read_text(encoding="utf-8")
OPERATIONS = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")


def headings() -> set[str]:
    return set(re.findall(r"^#+ (.+)$", RUNBOOK, re.MULTILINE))


def subclasses(kind: type[BaseException]) -> set[str]:
    return {kind.__name__}.union(*(subclasses(item) for item in kind.__subclasses__()))


def kinds_in_code() -> set[str]:
    """First arguments of ``Problem(...)``: literals, and names of constants of the module."""
    found = set()
    for path in Path(prc_cli.jobs.batch.__path__[0]).glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants: dict[str, str] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign):
                target, value = node.targets[0], node.value
                pairs = zip(target.elts, value.elts, strict=False) if (
                    isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
                ) else [(target, value)]  # fmt: skip
                for name, item in pairs:
                    if isinstance(name, ast.Name) and isinstance(item, ast.Constant) and isinstance(item.value, str):
                        constants[name.id] = item.value
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == Problem.__name__ and node.args:
                kind = node.args[0]
                if isinstance(kind, ast.Constant):
                    found.add(str(kind.value))
                elif isinstance(kind, ast.Name) and kind.id in constants:
                    found.add(constants[kind.id])
    return found


def test_every_error_of_the_package_has_its_entry() -> None:
    missing = subclasses(prc_cli.core.errors.PrcError) - headings()
    # classes that tests define are none of ours
    ours = {name for name in missing if hasattr(prc_cli.core.errors, name)}
    assert not ours


def test_every_kind_of_problem_has_its_entry() -> None:
    kinds = kinds_in_code()
    assert {"killed", "timeout", "memory", "NoReference"} <= kinds
    assert not (kinds | {"interrupted", "OSError", "PermissionError"}) - headings()


def test_every_exit_code_is_in_the_page_on_operations() -> None:
    for code in EXIT_CODES:
        assert re.search(rf"^\| {code} \|", OPERATIONS, re.MULTILINE), code
