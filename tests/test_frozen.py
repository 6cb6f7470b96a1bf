"""What 2.0 promises to keep: every name of ``frozen.txt`` is still there.

``python -m tests.test_frozen`` writes the file anew. A line that goes breaks a script; a new line
is a promise."""

import contextlib
import dataclasses
import inspect
import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import pytest
from click.testing import CliRunner

import prc_cli
from prc_cli.cli import cli
from prc_cli.config import RunConfig, preset_summaries
from prc_cli.core import errors
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.config import Params, model_in
from prc_cli.methods.reasons import reason_table
from prc_cli.simulation.settings import KINDS, load_settings
from prc_cli.streams.evidence.table import check_table

FROZEN = Path(__file__).with_name("frozen.txt")
COMMANDS = (
    "simulate street tree/in.laz --set lines=300 --set scanner.points_per_line=600 --set seed=3",
    "classify tree/in.laz labels.npy",
    "info tree/in.laz --checks --json",
    "classify tree/in.laz out.laz --json",
    "evaluate out.laz tree/in.laz --json",
    "objects out.laz --json",
    "calibrate tree/in.laz --json",
    "explain tree/in.laz --at 40,30 --json",
    "render out.laz picture.png --json",
    "transfer labels.npy out.laz moved.laz --match order --json",
    "thin out.laz thin.laz --keep-only ground --json",
    "convert tree/in.laz in.ply --json",
    "batch tree results --json",
    "batch-status results --json",
)


def names() -> Iterator[str]:
    """Yield all names that scripts may use, with their codes."""
    yield from _options(cli, "prc")
    yield from _keys(RunConfig, "key")
    for kind in KINDS:
        yield from _keys(type(load_settings(kind)), f"prc simulate {kind}")
    yield from (f"preset {preset.name}" for preset in preset_summaries())
    yield from (f"class {label.name.lower()} {ClassCodes().code(label)}" for label in Label)
    yield from (f"check {check.name}" for check in check_table())
    yield from (f"reason {number} {label} {name}" for number, label, name, _ in reason_table())
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, errors.PrcError):
            yield f"error {name} {kind.exit_code}"
    for name in prc_cli.__all__:
        thing = getattr(prc_cli, name)
        if inspect.isfunction(thing):
            yield from (
                f"python {name}({parameter})" for parameter in inspect.signature(thing).parameters
            )
        elif dataclasses.is_dataclass(thing):
            yield from (f"python {name}.{field.name}" for field in dataclasses.fields(thing))
    yield from _json()


def _options(command: click.Command, name: str) -> Iterator[str]:
    yield name
    for parameter in command.params:
        yield from (f"{name} {option}" for option in (*parameter.opts, *parameter.secondary_opts))
        if isinstance(parameter.type, click.Choice):
            yield from (
                f"{name} {parameter.opts[-1]} {choice}" for choice in parameter.type.choices
            )
    if isinstance(command, click.Group):
        for inner in command.list_commands(click.Context(command)):
            subcommand = command.get_command(click.Context(command), inner)
            assert subcommand is not None
            yield from _options(subcommand, f"{name} {inner}")


def _keys(model: type[Params], prefix: str) -> Iterator[str]:
    for name, info in model.model_fields.items():
        inner = model_in(info.annotation)
        path = (
            f"{prefix} {info.alias or name}"
            if " " not in prefix
            else f"{prefix}.{info.alias or name}"
        )
        yield from _keys(inner, path) if inner else [path]


def _json() -> Iterator[str]:
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("tree").mkdir()
        for line in COMMANDS:
            command, *words = line.split()
            outcome = CliRunner().invoke(cli, [*command.split("-"), *words])
            assert outcome.exit_code in (0, 4), (line, outcome.stderr)
            if "--json" in words:
                texts = outcome.stdout.splitlines() if command == "objects" else [outcome.stdout]
                yield from (
                    f"json {command} {path}" for text in texts for path in _paths(json.loads(text))
                )


def _paths(document: Any, prefix: str = "") -> Iterator[str]:
    if isinstance(document, dict):
        for key, value in document.items():
            name = "CODE" if key.isdigit() else key
            yield f"{prefix}{name}"
            yield from [] if name == "config" else _paths(value, f"{prefix}{name}.")
    elif isinstance(document, list):
        for value in document:
            yield from _paths(value, prefix)


@pytest.mark.slow
def test_what_was_promised_is_there():
    promised = set(FROZEN.read_text(encoding="utf-8").splitlines())
    present = set(names())
    assert not promised - present, "gone"
    assert not present - promised, "new: python -m tests.test_frozen"


if __name__ == "__main__":
    FROZEN.write_text("\n".join(sorted(set(names()))) + "\n", encoding="utf-8")
