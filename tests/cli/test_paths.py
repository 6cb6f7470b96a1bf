"""Every path that a command names is read or written, never both."""

import os
from collections.abc import Iterator

import click
import pytest

from prc_cli.cli import cli
from prc_cli.cli.batch_report import JsonLog
from prc_cli.cli.paths import ReadPath, ReadText, WritePath, WriteText
from prc_cli.core import paths
from prc_cli.core.errors import OutputError, PrcError
from prc_cli.core.files import prepare_outputs

READERS = (ReadPath, ReadText)
WRITERS = (WritePath, WriteText)
PLAIN = (
    click.Choice,
    click.IntRange,
    click.FloatRange,
    click.types.IntParamType,
    click.types.FloatParamType,
    click.types.BoolParamType,
)
NO_PATHS = {
    "--lines",
    "--columns",
    "--scanner",
    "--only",
    "--steps",
    "--at",
    "--match",
    "--height",
    "--mount",
    "--by",
    "--fail-under",
    "--include",
    "--exclude",
    "--drive",
    "--shard",
    "--scheduler",
    "--to",
    "--keep",
    "--spacing",
    "--keep-only",
    "--dimension",
    "--carry",
}
"""Texts that never name a file."""


def walk(
    command: click.Command, names: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield names, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from walk(inner, (*names, name))


def paths_of(command: click.Command, kinds: tuple[type, ...]) -> list[click.Parameter]:
    return [parameter for parameter in command.params if isinstance(parameter.type, kinds)]


ALL = {" ".join(names): command for names, command in walk(cli)}
PAIRS = [
    (name, reader, writer)
    for name, command in ALL.items()
    for reader in paths_of(command, READERS)
    for writer in paths_of(command, WRITERS)
]


@pytest.mark.parametrize("name", ALL)
def test_every_option_says_whether_it_reads_or_writes_a_file(name):
    for parameter in ALL[name].params:
        if not isinstance(parameter.type, (*READERS, *WRITERS, *PLAIN)):
            assert isinstance(parameter.type, click.types.StringParamType), (name, parameter.name)
            assert NO_PATHS.intersection(parameter.opts), (name, parameter.name)


def test_there_are_pairs_to_try():
    tried = {(name, writer.name) for name, _, writer in PAIRS}
    assert {
        ("classify", "output"),
        ("batch", "log_json"),
        ("calibrate", "outputs"),
        ("evaluate", "outputs"),
    } <= tried
    assert len(PAIRS) > 100


@pytest.mark.parametrize(
    "name, reader, writer",
    [pytest.param(*pair, id=f"{pair[0]} {pair[1].name} {pair[2].name}") for pair in PAIRS],
)
@pytest.mark.parametrize("linked", [False, True])
def test_no_path_is_both_read_and_written(
    tmp_path,
    name,
    reader,
    writer,
    linked,
):
    source = tmp_path / "a.npz"
    output = tmp_path / "sub" / ".." / "a.npz"
    source.write_bytes(b"input")
    (tmp_path / "sub").mkdir()
    if linked:
        output = tmp_path / "b.npz"
        os.link(source, output)
    words: list[str] = []
    for parameter in ALL[name].params:
        values = {reader: str(source), writer: str(output)}
        if parameter in values:
            value = values[parameter]
        elif isinstance(parameter, click.Argument) and parameter.required:
            value = str(tmp_path / f"other_{parameter.name}.npz")
        else:
            continue
        flag = [] if isinstance(parameter, click.Argument) else [max(parameter.opts, key=len)]
        words += [*flag, *[value] * max(parameter.nargs, 1)]
    paths.begin_command(name)
    try:
        with pytest.raises(PrcError, match="never modified|output twice"):
            ALL[name].make_context(name, words)
    finally:
        paths.begin_command("")
    assert source.read_bytes() == b"input"


@pytest.mark.parametrize(
    "text", ["trajectory:{}", "input.range=trajectory:{}", "Title={}", 'input.metadata="{}"']
)
def test_files_named_within_texts_are_inputs(tmp_path, text):
    source = tmp_path / "a.csv"
    source.touch()
    paths.begin_command("x")
    try:
        ReadText().convert(text.format(source), None, None)
        with pytest.raises(PrcError, match="never modified"):
            WritePath().convert(str(source), None, None)
        with pytest.raises(PrcError, match="never modified"):  # also names that are made of others
            prepare_outputs(source, overwrite=True)
    finally:
        paths.begin_command("")


def test_a_file_of_a_folder_that_is_read_is_an_input(tmp_path):
    (tmp_path / "labels").mkdir()
    (tmp_path / "labels" / "a.npy").touch()
    (tmp_path / "labels" / "report.html").touch()
    paths.begin_command("x")
    try:
        ReadPath().convert(str(tmp_path / "labels"), None, None)
        WritePath().convert(str(tmp_path / "labels" / "report.html"), None, None)
        with pytest.raises(PrcError, match="is a file of .*labels, which is read"):
            WritePath().convert(str(tmp_path / "labels" / "a.npy"), None, None)
    finally:
        paths.begin_command("")


def test_a_command_that_has_ended_protects_nothing(tmp_path, prc):
    source = tmp_path / "a.npy"
    source.write_bytes(b"no array")
    assert prc(f"info {source}").code == 1
    prepare_outputs(source, overwrite=True)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("kind", ["npz", "pipe", "link"])
def test_a_log_is_added_to_no_other_file(tmp_path, kind):
    path = tmp_path / "log"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(b"PK" if kind == "npz" else b'{"event": "run_end"}\n')
    if kind == "link":
        os.link(path, tmp_path / "second")
    with pytest.raises(OutputError, match="is not a log of prc batch"):
        JsonLog(str(path))
