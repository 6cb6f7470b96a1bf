"""``docs/sequential_angle.md`` names every parameter of the stages, with its default."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from prc_cli.core.config import Params
from prc_cli.methods.sequential_angle.pipeline import SequentialAngleParams

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "sequential_angle.md").read_text(encoding="utf-8")


def values(prefix: str, params: Params) -> Iterator[tuple[str, Any]]:
    for name in type(params).model_fields:
        value = getattr(params, name)
        if isinstance(value, Params):
            yield from values(f"{prefix}{name}.", value)
        else:
            yield f"{prefix}{name}", value


VALUES = dict(values("", SequentialAngleParams()))


def documented() -> dict[str, str]:
    """Keys and defaults of the table of constants: a row a table, cells of "`key` default (note)"."""
    section = PAGE[PAGE.index("## Constants") : PAGE.index("## Checks")]
    found = {}
    for table, cells in re.findall(r"^\| (?:`([a-z_.]+)`)? ?\|(.*)\|$", section, re.MULTILINE):
        for key, default in re.findall(r"`([a-z0-9_]+)` ([^;|(]*)", cells):
            found[f"{table}.{key}".lstrip(".")] = default.strip().replace("−", "-")
    return found


def test_every_table_has_its_section() -> None:
    tables = {key.rpartition(".")[0] for key in VALUES} - {"", "coarse.vegetation", "coarse.surfaces"}
    for table in tables:
        assert f"`[sequential_angle.{table}]`" in PAGE


@pytest.mark.parametrize("key", documented())
def test_defaults_in_the_table(key: str) -> None:
    value, written = VALUES[key], documented()[key]
    if isinstance(value, tuple) and isinstance(value[0], float) and "/" not in written:
        assert written == ", ".join(f"{number:g}" for number in value)
    elif isinstance(value, bool):
        assert written == str(value).lower()
    elif isinstance(value, int | float):
        assert float(written) == value


@pytest.mark.parametrize("key", VALUES)
def test_every_parameter_is_on_the_page(key: str) -> None:
    assert key in documented() or f"`{key.split('.')[-1]}" in PAGE
