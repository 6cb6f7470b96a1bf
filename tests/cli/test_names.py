"""One name for one thing: former names work and are not shown; what a shell offers."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.cli.completing import complete_assignment, complete_mapping
from tests.cli.test_commands import Prc


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def command(name: str) -> click.Command:
    found = cli.get_command(click.Context(cli), name)
    assert found is not None
    return found


@pytest.mark.parametrize(("former", "now"), [("--by", "--match"), ("--min-match", "--min-matched")])
def test_former_names_are_taken_and_not_shown(former: str, now: str) -> None:
    transfer = command("transfer")
    value = "order" if now == "--match" else "0.25"
    given = [transfer.make_context("transfer", ["a", "b", "c", name, value]).params for name in (former, now)]
    assert given[0] == given[1]
    shown = transfer.get_help(click.Context(transfer))
    assert f"{now} " in shown
    assert f"{former} " not in shown


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_inputs_have_one_name(name: str) -> None:
    names = {argument.metavar for argument in command(name).params if isinstance(argument, click.Argument)}
    assert "INPUT" not in names
    assert "SOURCE" not in names


@pytest.mark.parametrize(
    "words", [("{}", "-o", "o.npy"), ("-o", "o.npy", "{}"), ("{}", "--output=o.npy"), ("--output", "o.npy", "{}")]
)
def test_the_output_may_be_named(prc: Prc, tmp_path: Path, words: tuple[str, ...]) -> None:
    source, output = tmp_path / "d.npy", tmp_path / "o.npy"
    np.save(source, np.full((6, 9), 20.0, np.float32))
    given = [word.format(source).replace("o.npy", str(output)) for word in words]
    result = prc("classify", *given, "--preset", "urban", "-q")
    assert result.code == 0, result.err
    assert len(np.load(output)) == 54
    assert prc("classify", source, "--preset", "urban").code == 2


def test_completion_of_values() -> None:
    context, parameter = click.Context(cli), click.Option(["--x"])
    assert "prc.support.zeta_p=" in complete_assignment(context, parameter, "prc.support.z")
    assert complete_assignment(context, parameter, "prc.environment=f") == ["prc.environment=forest"]
    assert complete_assignment(context, parameter, "fused.cars.named=") == [
        "fused.cars.named=true", "fused.cars.named=false",
    ]  # fmt: skip
    assert "input.return=" in complete_assignment(context, parameter, "input.re")
    assert complete_assignment(context, parameter, "nonsense=") == []
    assert "street_scan" in complete_mapping(context, parameter, "stre")
    assert complete_mapping(context, parameter, "/no/such/folder/x") == []
