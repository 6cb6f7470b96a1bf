"""``docs/sequential_angle.md`` names every key of the method, with its default."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from prc_cli.core.config import flatten
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "sequential_angle.md").read_text(encoding="utf-8")
VALUES = dict(flatten(SequentialAngleParams().model_dump()))


def documented() -> dict[str, str]:
    """Keys and defaults of the table of constants: a row a table, cells of "`key` default (note)"."""
    section = PAGE[PAGE.index("## Constants") : PAGE.index("## The published constants")]
    found = {}
    for table, cells in re.findall(r"^\| (?:`([a-z_.]+)`)? ?\|(.*)\|$", section, re.MULTILINE):
        for key, default in re.findall(r"`([a-z0-9_]+)`,? ([^;|(`]*)", cells):
            found[f"{table}.{key}".lstrip(".")] = default.strip().replace("−", "-")
    return found


@pytest.mark.parametrize("key", VALUES)
def test_defaults_in_the_table(key: str) -> None:
    value, written = VALUES[key], documented()[key]
    if isinstance(value, tuple) and isinstance(value[0], float):
        assert written == ", ".join(f"{number:g}" for number in value)
    elif isinstance(value, bool):
        assert written == str(value).lower()
    elif isinstance(value, int | float):
        assert float(written) == value


def test_the_table_names_no_other_key() -> None:
    assert not documented().keys() - VALUES.keys()
