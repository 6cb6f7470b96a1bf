"""One name for one thing: former names work and are not shown; what a shell offers; what is said of a bare frame."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import pytest

from prc_cli.cli import COMMANDS, cli
from prc_cli.cli.completing import complete_assignment, complete_mapping
from prc_cli.formats.raw_binary.frame import is_frame
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


def test_a_bare_frame_is_told_how_to_be_read(prc: Prc, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.normal(0, 15, (4800, 3)), rng.random(4800)]).astype("<f4")
    points[:, :3] += np.sign(points[:, :3])
    points.tofile(tmp_path / "000000.bin")
    for more in ((), ("-M", "64")):
        result = prc("classify", tmp_path / "000000.bin", tmp_path / "o.npy", *more)
        if more and len(points) * 4 % 64 == 0:
            continue
        assert result.code == 1
        assert "as in a KITTI frame" in result.err
        assert "kitti_frame.toml" in result.err
    ranges = np.abs(points)
    ranges.tofile(tmp_path / "ranges.bin")
    assert not is_frame(tmp_path / "ranges.bin")
    points[:10].tofile(tmp_path / "few.bin")
    assert not is_frame(tmp_path / "few.bin")


def test_a_real_frame(prc: Prc, tmp_path: Path, real_data: Path) -> None:
    result = prc("classify", real_data / "kitti" / "000000.bin", tmp_path / "o.npy")
    assert result.code == 1
    assert "kitti_frame.toml" in result.err
