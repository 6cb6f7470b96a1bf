"""Fixtures for tests of commands."""

import json
from typing import Any, NamedTuple

import pytest

from prc_cli.cli import main, report
from tests.messages import check_messages, folded
from tests.patience import HANGS_S


@pytest.fixture(autouse=True)
def no_word_about_compiling(monkeypatch):
    """Whether a command in this process says that loading takes long depends on the machine."""
    monkeypatch.setattr(report, "COMPILING_S", HANGS_S)


class Result(NamedTuple):
    """Exit code and what was printed; a message on stderr is one line, as in logs."""

    code: int
    out: str
    err: str


class Prc:
    """Runs ``prc`` in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, line: object, *arguments: object) -> Result:
        """Run a command line, its words followed by further arguments as they are."""
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([*str(line).split(), *(str(argument) for argument in arguments)])
        captured = self._capsys.readouterr()
        check_messages(captured.err)
        code = stop.value.code
        return Result(int(code) if code is not None else 0, captured.out, folded(captured.err))

    def json(self, line: object, *arguments: object) -> Any:
        """Run a command line with ``--json``; return what it prints."""
        return json.loads(self(line, *arguments, "--json").out)


@pytest.fixture
def prc(capsys):
    return Prc(capsys)
