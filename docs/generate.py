"""Write the reference pages from the code; ``--check`` fails when a page on disk differs.

Run ``python docs/generate.py`` after changing an option, a parameter or a class code.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from prc_cli.cli import cli
from prc_cli.config import RunConfig, preset_summaries
from prc_cli.core.classes import LABEL_COLOURS, ClassCodes, Label
from prc_cli.core.config import Params
from prc_cli.simulation.scanners import SCANNERS, Scanner
from prc_cli.simulation.settings import KINDS, load_settings
from prc_cli.streams.evidence.checks import CHECKS

ROOT = Path(__file__).resolve().parent.parent
GENERATED = "<!-- written by docs/generate.py from the code; do not edit -->\n"


def cli_page() -> str:
    """Return the command reference: every command's own ``--help``."""
    parts = [GENERATED, "# Commands\n", f"```text\n{_help(cli, 'prc')}\n```\n"]
    context = click.Context(cli, info_name="prc")
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        parts.append(f"## prc {name}\n\n```text\n{_help(command, f'prc {name}')}\n```\n")
        if isinstance(command, click.Group):
            for sub_name, sub in command.commands.items():
                parts.append(f"### prc {name} {sub_name}\n\n```text\n{_help(sub, f'prc {name} {sub_name}')}\n```\n")
    return "\n".join(parts)


def _help(command: click.Command, name: str) -> str:
    settings = cli.context_settings
    with click.Context(
        command, info_name=name, terminal_width=100, help_option_names=settings["help_option_names"],
        max_content_width=settings["max_content_width"],
    ) as context:  # fmt: skip
        return command.get_help(context).rstrip()


def configuration_page() -> str:
    """Return the configuration reference: every table, key, default, bound and description."""
    intro = """\
        # Configuration

        A configuration is a TOML file. Layers, each over the one before: the defaults below, a preset
        (`--preset urban`, or `preset = "urban"` as the first line of the file), the file (`--config FILE`), options.
        Unknown keys and values out of bounds are errors. `prc config show` prints the effective configuration with the
        source of every value, `prc config presets` lists the presets, `prc config check FILE` checks a file,
        `prc config schema` prints the JSON schema.
        """
    parts = [GENERATED, textwrap.dedent(intro), *_tables(RunConfig, "")]
    parts.append("## Presets\n")
    parts.append(
        "Each is a file of `sample_configs/`; what it does not set is a default. `prc config presets` lists them.\n"
    )
    parts.extend(
        f"### {preset.name}\n\n```toml\n{preset.file.read_text(encoding='utf-8')}```\n" for preset in preset_summaries()
    )
    return "\n".join(parts)


def _tables(model: type[Params], prefix: str) -> Iterator[str]:
    rows, inner = [], []
    for name, info in model.model_fields.items():
        key = info.alias or name
        nested = _model_of(info.annotation)
        if nested is not None:
            inner.append((key, nested))
            continue
        schema = model.model_json_schema(by_alias=True)["properties"][key]
        default = info.get_default(call_default_factory=True)
        shown = "required" if info.is_required() else "not set" if default is None else f"`{_toml(default)}`"
        rows.append(f"| `{key}` | {shown} | {_bounds(schema)} | {info.description or ''} |".replace("  ", " "))
    title = f"[{prefix.rstrip('.')}]" if prefix else "Top level"
    documentation = (model.__doc__ or "").strip().splitlines()[0].replace("``", "`")
    if rows:
        table = "\n".join(["| key | default | allowed | meaning |", "|---|---|---|---|", *rows])
        yield f"## {title}\n\n{documentation}\n\n{table}\n"
    for key, nested in inner:
        yield from _tables(nested, f"{prefix}{key}.")


def _model_of(annotation: Any) -> type[Params] | None:
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, Params):
            return candidate
        for argument in getattr(candidate, "__args__", ()):
            if isinstance(argument, type) and issubclass(argument, Params):
                return argument
    return None


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(list(value) if isinstance(value, tuple) else value)


def _bounds(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_bounds(option) for option in schema["anyOf"] if option.get("type") != "null")
    if "enum" in schema:
        return ", ".join(f"`{_toml(value)}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{_toml(schema['const'])}`"
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    limits = [f"{sign} {schema[key]:.15g}" for key, sign in signs.items() if key in schema]
    return ", ".join([schema.get("type", ""), *limits]).strip(", ")


def classes_page() -> str:
    """Return the class codes page."""
    codes = ClassCodes()
    rows = [
        f"| {label.name.lower()} | {codes.code(label)} | rgb{LABEL_COLOURS[label]} | "
        f"{'no return; label files only' if label is Label.MISSING else _description(label)} |"
        for label in Label
    ]
    table = "\n".join(["| class | code | colour in pictures | meaning |", "|---|---|---|---|", *rows])
    text = """\
        # Class codes

        Codes follow ASPRS LAS 1.4 where it has the class; the others take user codes from 64 up. All of them can be
        changed in `[classes]`. Point formats 0 to 5 hold codes up to 31: when a run needs a larger one, the file is
        upgraded to the matching format 6 to 10 and the command says so; with `output.codes = "below-32"` such a code
        is refused instead.
        """
    return "\n".join([GENERATED, textwrap.dedent(text), table, ""])


def _description(label: Label) -> str:
    return ClassCodes.model_fields[label.name.lower()].description or ""


def checks_page() -> str:
    """Return the reference of the checks: what each asks, its limit, the reason for it, and its blind spots."""
    intro = """\
        # Checks

        Every check asks one question of an input or of its labels; [How prc knows](../evidence.md) says when. The names
        are those of `--accept-doubt NAME`. Doubtful: labels are written, exit code 4. Refused: nothing is written, exit
        code 1.
        """
    parts = [GENERATED, textwrap.dedent(intro)]
    for check in CHECKS:
        facts = (("Limit", check.limit), ("Why", check.reason), ("Not seen", check.blind))
        told = "\n".join(
            textwrap.fill(f"- {name}: {text.rstrip('.')}.", 120, subsequent_indent="  ") for name, text in facts
        )
        parts.append(f"## {check.name}\n\n{check.asks}\n\n{told}\n")
    return "\n".join(parts)


def simulation_page() -> str:
    """Return the reference of simulations: scanners side by side, then every parameter of every kind."""
    intro = """\
        # Simulation

        `prc simulate KIND --config FILE.toml --set TABLE.KEY=VALUE` takes the parameters below; in a table that has
        presets, `name = "…"` chooses the one that its other keys are laid over. `prc simulate parameters KIND` prints
        them as a file. What they mean is told in [Simulate](../simulation.md).

        ## Scanners
        """
    names = list(SCANNERS)
    fields = [key for key, info in Scanner.model_fields.items() if _model_of(info.annotation) is None]
    rows = [f"| | {' | '.join(f'`{name}`' for name in names)} |", "|---|" + "---|" * len(names)]
    for key in fields:
        values = [getattr(SCANNERS[name], key) for name in names]
        rows.append(f"| `{key}` | {' | '.join('not set' if value is None else _plain(value) for value in values)} |")
    parts = [GENERATED, textwrap.dedent(intro), "\n".join(rows) + "\n"]
    seen: set[str] = set()
    for kind in KINDS:
        model = type(load_settings(kind))
        parts.append(f"## prc simulate {kind}\n")
        shown = [table for table in _tables(model, "") if not table.startswith("## [classes]")]
        parts += [table.replace("## ", "### ", 1) for table in shown if table not in seen]
        seen |= set(shown)
    return "\n".join(parts)


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def accuracy_page() -> str:
    """Return the page of accuracy: a few rows of the figures of the contest, and what they do not say."""
    figures = (ROOT / "docs/contest_figures.md").read_text(encoding="utf-8")
    shown = (
        ("Oakland 2, 3: F1 of the classes", ("ground", "building", "vegetation")),
        ("KITTI frame: F1 of the classes", ("ground", "building", "vegetation")),
        ("forests: F1 of the classes", ("ground", "stem", "vegetation")),
    )
    table = [
        "| F1, mean of the scans (worst) | real street: ground | building | vegetation "
        "| real 64-ring frame: ground | building | vegetation | simulated forest: ground | stem | vegetation |",
        "|---|" + "---:|" * 9,
    ]
    found = [(_table_of(figures, title), classes) for title, classes in shown]
    for method in dict.fromkeys(name for rows, _ in found for name in rows):
        cells = [rows.get(method, {}).get(one, "") for rows, classes in found for one in classes]
        table.append(f"| {method} | {' | '.join(cells)} |")
    text = """\
        # How accurate is it?

        What `prc classify` takes by itself is `fused` in streets and `fused-forest` in forests. The other rows are the
        papers' methods. Oakland strip 1 is left out, because parameters were chosen on it.

        {table}

        - **Real street**: Oakland strips 2 and 3, a push-broom scanner with 0.5° steps. **Real frame**: one of KITTI.
          **Forest**: three simulated walks, because no labelled raw forest scan is at hand.
        - Two real places are few, and their references hold next to no noise. Expect less elsewhere.
        - Cars, curbs and poles are not in this table: [every class](fused.md#figures). Poles are weak.
        - Where it fails: [a list](contest.md#where-fused-fails) and [pictures](contest_figures.md#where-it-fails).
        - The figure that counts is yours: label a short stretch of your drive by hand, then `prc evaluate labels.npy
          reference.npy` ([how](evaluation.md)).

        All scans, all methods and the commands: [the contest](contest.md), [its figures](contest_figures.md),
        [real scans](real_scans.md).
        """
    return "\n".join([GENERATED, textwrap.dedent(text).format(table="\n".join(table))])


def _table_of(page: str, title: str) -> dict[str, dict[str, str]]:
    """Return the table under a heading: cells by column, by the name of the row."""
    lines = page.split(f"### {title}\n", 1)[1].split("\n#", 1)[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[2:]}


def pages() -> dict[Path, str]:
    """Return every generated file and its content."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    return {
        ROOT / "docs/reference/cli.md": cli_page(),
        ROOT / "docs/reference/configuration.md": configuration_page(),
        ROOT / "docs/reference/classes.md": classes_page(),
        ROOT / "docs/reference/checks.md": checks_page(),
        ROOT / "docs/reference/simulation.md": simulation_page(),
        ROOT / "docs/accuracy.md": accuracy_page(),
        ROOT / "docs/changelog.md": GENERATED + changelog,
    }


def main() -> int:
    """Write the pages, or with ``--check`` report the ones that differ."""
    stale = []
    for path, text in pages().items():
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(str(path.relative_to(ROOT)))
        if "--check" not in sys.argv:
            path.write_text(text, encoding="utf-8")
    if stale:
        verb = "differ from the code; run python docs/generate.py" if "--check" in sys.argv else "written"
        sys.stderr.write(f"{', '.join(stale)}: {verb}\n")
    return 1 if stale and "--check" in sys.argv else 0


if __name__ == "__main__":
    sys.exit(main())
