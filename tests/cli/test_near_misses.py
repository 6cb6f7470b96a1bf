"""What a user types almost right is understood, or answered with what to type."""

import click
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.cli.gone import GONE, GONE_OF


@pytest.mark.parametrize("typed", [*GONE_OF, *(f"prc classify {flag}" for flag in GONE)])
def test_every_option_that_went_has_an_answer(prc, typed):
    _, *words, flag = typed.split()
    result = prc(*words, flag)
    assert result.code == 2
    assert f"there is no option {flag} any more" in result.err


def test_no_option_of_today_is_among_those_that_went():
    context = click.Context(cli)
    for name in COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        for parameter in command.params:
            assert GONE.keys().isdisjoint(parameter.opts), name
            assert GONE_OF.keys().isdisjoint(f"prc {name} {flag}" for flag in parameter.opts)


@pytest.mark.parametrize("name", ["classify", "batch", "evaluate", "render"])
def test_help_is_short_and_help_all_is_not(prc, name):
    short = prc(f"{name} --help").out
    whole = prc(f"{name} --help-all").out
    assert f"more options: prc {name} --help-all" in short
    assert sum(line.lstrip().startswith("-") for line in short.splitlines()) <= 14
    assert "--layout" in whole or name == "evaluate"
    assert "--layout FILE" not in short
