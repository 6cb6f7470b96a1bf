"""Fixtures for tests of commands."""

from __future__ import annotations

import pytest

from prc_cli.cli import report
from tests.patience import HANGS_S


@pytest.fixture(autouse=True)
def no_word_about_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether a command in this process says that loading takes long depends on the machine."""
    monkeypatch.setattr(report, "COMPILING_S", HANGS_S)
