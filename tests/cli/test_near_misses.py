"""What a user types almost right is understood, or answered with what to type."""

import json
import shlex
from pathlib import Path

import click
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.cli.gone import GONE, GONE_OF


@pytest.mark.parametrize(
    "command, expected",
    [
        ("config show --method PRC", 'method = "prc"'),
        ("config show --method sequential_angle", 'method = "sequential-angle"'),
        ("config show --preset urban", "prc-2019-urban"),
        ("config show --preset Fused_Forest", 'environment = "forest"'),
        ("config show --set prc.support.zeta_p=.1", "zeta_p = 0.1"),
    ],
)
def test_another_spelling_is_understood(prc, command, expected):
    result = prc(*shlex.split(command))
    assert result.code == 0
    assert expected in result.out


def test_an_old_preset_has_a_note_and_the_new_name_in_the_sources(prc):
    result = prc("config show --preset forest")
    assert result.err == "note: preset forest is now called prc-2019-forest\n"
    assert "# from: preset prc-2019-forest" in result.out


def test_tables_of_single_commands_are_shown_with_their_sources(prc, tmp_path):
    file = tmp_path / "a.toml"
    file.write_text("[batch]\nstall = 1800\n[render]\nstation = 2\n", encoding="utf-8")
    shown = prc(f"config show --config {file} --set batch.retry=2").out
    assert f"stall = 1800.0  # from: {file}" in shown
    assert "retry = 2  # from: option" in shown
    (tmp_path / "b.toml").write_text(shown, encoding="utf-8")
    again = prc(f"config show --config {tmp_path}/b.toml --json")
    config = json.loads(again.out)["config"]
    assert (config["batch"]["retry"], config["render"]["station"]) == (2, 2)


@pytest.mark.parametrize(
    "command, answer",
    [
        ("clasify a b", "did you mean 'classify'?"),
        ("batch statsu a", "did you mean prc batch status?"),
        ("classify - o.npy", "prc stream < FILE"),
        ("config show --preset fuzed", "did you mean 'fused'?"),
        ("config show --presett fused", "did you mean --preset?"),
        ("config show --set zeta_p=.1", "did you mean 'prc.support.zeta_p'?"),
        ("config show --return first", "type --set input.return="),
        ("evaluate a b --mapping stret", "did you mean 'street'?"),
        ("evaluate a b --by rnge:5", "did you mean 'range'?"),
        ("batch run a b --retry 2", "type --set batch.retry=N"),
        ("batch a b --set batch.stal=2", "did you mean 'batch.stall'?"),
        ("batch runn b", "did you mean prc batch run?"),
        ("batch a b --only-failed", "type prc batch retry OUT"),
    ],
)
def test_a_near_miss_is_answered(prc, tmp_path, monkeypatch, command, answer):
    monkeypatch.chdir(tmp_path)
    Path("a").write_bytes(b"")
    Path("b").write_bytes(b"")
    result = prc(*shlex.split(command))
    assert result.code == 2
    assert answer in result.err


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
