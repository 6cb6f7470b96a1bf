"""The input and layout tables refuse invalid options."""

from __future__ import annotations

from typing import Any

import pytest

from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError
from prc_cli.formats.options import (
    MAX_RECORD_BYTES,
    InputConfig,
    Layout,
)


def refused(model: Any, **table: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        build(model, table, "prc.toml")
    return str(caught.value)


@pytest.mark.parametrize("size", [MAX_RECORD_BYTES + 1, 9_000_000_000_000_000_000, 10**30])
def test_records_larger_than_any_scanner_writes(size: int) -> None:
    message = refused(Layout, record_bytes=size)
    assert message.startswith(f"prc.toml: record_bytes: found {size}, expected: ")
    assert "less than or equal to 1048576" in message


@pytest.mark.parametrize("rule", ["time:1e999", "time:-1", "time:0", "time:e"])
@pytest.mark.parametrize("key", ["lines", "columns"])
def test_a_rate_is_a_positive_finite_number(key: str, rule: str) -> None:
    message = refused(InputConfig, **{key: rule})
    assert f"{key} = time:HZ with 1e-06 to 1e+12 Hz, found {rule!r}" in message


@pytest.mark.parametrize("kind", ["f4,(", "i4,,", "3f4", "(1,)f4", "O", "S4", "", "nonsense"])
def test_types_that_are_no_number(kind: str) -> None:
    message = refused(Layout, fields=[{"name": "range", "type": kind}])
    assert f"found {kind!r}, expected: a numpy number type such as f4" in message


@pytest.mark.parametrize("gap", [0, -1.0, float("nan"), float("inf")])
def test_a_trajectory_gap_is_a_positive_time(gap: float) -> None:
    assert refused(InputConfig, trajectory_max_gap=gap).startswith(f"prc.toml: trajectory_max_gap: found {gap}, ")
