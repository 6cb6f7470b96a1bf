"""One name for one thing; what a shell offers."""

from __future__ import annotations

import click
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.cli.completing import complete_assignment, complete_mapping


def command(name: str) -> click.Command:
    found = cli.get_command(click.Context(cli), name)
    assert found is not None
    return found


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_inputs_have_one_name(name: str) -> None:
    names = {argument.metavar for argument in command(name).params if isinstance(argument, click.Argument)}
    assert "INPUT" not in names
    assert "SOURCE" not in names


def test_completion_of_values() -> None:
    context, parameter = click.Context(cli), click.Option(["--x"])
    assert "prc.support.zeta_p=" in complete_assignment(context, parameter, "prc.support.z")
    assert complete_assignment(context, parameter, "prc.environment=f") == ["prc.environment=forest"]
    backdate = "sequential_angle.coarse.surfaces.backdate="
    assert complete_assignment(context, parameter, backdate) == [f"{backdate}true", f"{backdate}false"]
    assert "input.return=" in complete_assignment(context, parameter, "input.re")
    assert complete_assignment(context, parameter, "nonsense=") == []
    assert "street_scan" in complete_mapping(context, parameter, "stre")
    assert complete_mapping(context, parameter, "/no/such/folder/x") == []
