"""Write the reference pages from the code, and the figures in prose from the benchmarks.

``--check`` fails when a page on disk differs. Run ``python docs/generate.py`` after changing an
option, a parameter or a class code, and after a benchmark wrote its page of figures.

A figure in prose is followed by a comment that names its cell in a page of ``figures/``. The figure
is written with as many digits as it has, and a reader of the page sees the figure only:
``0.527<!-- sequential_angle.md#readings: car.fourier.window = 0 > car recall -->``.

- The comment holds as many leading cells of the row as are needed, with ``*`` for any text, then
  the column. Tables of two columns need no column.
- Where several headings below the section have such a row, the heading comes first.
- A column "precision" after "car recall" is "car precision". "A / B" is a quotient of two columns,
  "share of A" the figure in brackets.
- "least of" and "most of" before the row take the least and the most of all rows that fit.

A table of prose whose rows are rows of figures has ``<!-- rows of PAGE.md#section -->`` above it:
every row becomes the one with the same first cell in the first table there.
"""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import click

import prc_cli
from prc_cli.cli import cli
from prc_cli.cli.options import ALL_OPTIONS
from prc_cli.config import CommandTables, RunConfig, preset_summaries
from prc_cli.core.classes import LABEL_COLOURS, ClassCodes, Label
from prc_cli.core.config import Params, model_in
from prc_cli.formats.writing.columns import HIGH_NOISE_CODE
from prc_cli.methods.reasons import reason_table
from prc_cli.simulation.scanners import SCANNERS, Scanner
from prc_cli.simulation.settings import KINDS, load_settings
from prc_cli.streams.evidence.table import check_table

ROOT = Path(__file__).resolve().parent.parent
PYTHON = ROOT / "docs/reference/api.md"
"""Written by hand, but for the signatures."""
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
                parts.append(
                    f"### prc {name} "
                    f"{sub_name}\n\n```text\n{_help(sub, f'prc {name} {sub_name}')}\n```\n"
                )
    return "\n".join(parts)


def _help(command: click.Command, name: str) -> str:
    settings = cli.context_settings
    with click.Context(
        command,
        info_name=name,
        terminal_width=80,
        help_option_names=settings["help_option_names"],
        max_content_width=80,
    ) as context:
        context.meta[ALL_OPTIONS] = True
        return command.get_help(context).rstrip()


def configuration_page() -> str:
    """Return the configuration reference: every table, key, default, bound and description."""
    intro = """\
        # Configuration

        A configuration is a TOML file. Layers, each over the one before: the defaults below, a
        preset (`--preset rings`, or `preset = "rings"` as the first line of the file), the file
        (`--config FILE`), options. Unknown keys and values out of bounds are errors. `prc config
        show` prints the effective configuration with the source of every value, `prc config
        presets` lists the presets, `prc config check FILE` checks a file, `prc config schema`
        prints the JSON schema.
        """
    parts = [
        GENERATED,
        textwrap.dedent(intro),
        *_tables(RunConfig, ""),
        *_tables(CommandTables, ""),
    ]
    parts.append("## Presets\n")
    parts.append(
        "Each is a file of `sample_configs/`; what it does not set is a default. `prc "
        "config presets` lists them.\n"
    )
    parts.extend(
        f"### {preset.name}\n\n```toml\n{preset.file.read_text(encoding='utf-8')}```\n"
        for preset in preset_summaries()
    )
    return "\n".join(parts)


def _tables(model: type[Params], prefix: str) -> Iterator[str]:
    rows = []
    inner = []
    for name, info in model.model_fields.items():
        key = info.alias or name
        nested = model_in(info.annotation)
        if nested is not None:
            inner.append((key, nested))
            continue
        schema = model.model_json_schema(by_alias=True)["properties"][key]
        default = info.get_default(call_default_factory=True)
        shown = (
            "required"
            if info.is_required()
            else "not set"
            if default is None
            else f"`{_toml(default)}`"
        )
        rows.append(
            f"| `{key}` | {shown} | {_bounds(schema)} | {info.description or ''} |".replace(
                "  ", " "
            )
        )
    title = f"[{prefix.rstrip('.')}]" if prefix else "Top level"
    documentation = (model.__doc__ or "").strip().splitlines()[0].replace("``", "`")
    if rows:
        table = "\n".join(["| key | default | allowed | meaning |", "|---|---|---|---|", *rows])
        yield f"## {title}\n\n{documentation}\n\n{table}\n"
    for key, nested in inner:
        yield from _tables(nested, f"{prefix}{key}.")


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return (
        f'"{value}"'
        if isinstance(value, str)
        else str(list(value) if isinstance(value, tuple) else value)
    )


def _bounds(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(
            _bounds(option) for option in schema["anyOf"] if option.get("type") != "null"
        )
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
    table = "\n".join(
        ["| class | code | colour in pictures | meaning |", "|---|---|---|---|", *rows]
    )
    text = """\
        # Class codes

        Codes follow ASPRS LAS 1.4 where it has the class; the others take user codes from 64 up.
        All of them can be changed in `[classes]`. Point formats 0 to 5 hold codes up to 31: when a
        run needs a larger one, the file is upgraded to the matching format 6 to 10 and the command
        says so; with `output.codes = "below-32"` such a code is refused instead.
        """
    return "\n".join([GENERATED, textwrap.dedent(text), table, ""])


def _description(label: Label) -> str:
    return ClassCodes.model_fields[label.name.lower()].description or ""


def checks_page() -> str:
    """Return the reference of the checks.

    What each asks, its limit, the reason for it, and its blind spots.
    """
    intro = """\
        # Checks

        Every check asks one question of an input or of its labels; [How prc knows](../evidence.md)
        says when. The names are those of `--accept-doubt NAME`. Doubtful: labels are written, exit
        code 4. Refused: nothing is written, exit code 1.
        """
    parts = [GENERATED, textwrap.dedent(intro)]
    for check in check_table():
        facts = (("Limit", check.limit), ("Why", check.reason), ("Not seen", check.blind))
        told = "\n".join(
            textwrap.fill(f"- {name}: {text.rstrip('.')}.", 120, subsequent_indent="  ")
            for name, text in facts
        )
        parts.append(f"## {check.name}\n\n{check.asks}\n\n{told}\n")
    return "\n".join(parts)


def reasons_page() -> str:
    """Return the rules that give labels, with their numbers."""
    intro = """\
        # Reasons

        The rule that gave a shot its class, as `--set output.reason=true` writes it beside the
        class: uint8 extra bytes `reason`, or a column. Version 2.0 numbered the rules anew.
        `prc explain` and the viewer say the sentence of a shot; [Why this class?](../explain.md).

        | number | class | rule | the shot is |
        |---:|---|---|---|
        """
    rows = [
        f"| {number}{' + class' if label == 'any' else ''} | {label} | `{name}` | {text} |"
        for number, label, name, text in reason_table()
    ]
    return GENERATED + textwrap.dedent(intro) + "\n".join(rows) + "\n"


def simulation_page() -> str:
    """Return the reference of simulations.

    Scanners side by side, then every parameter of every kind.
    """
    intro = """\
        # Simulation

        `prc simulate KIND --config FILE.toml --set TABLE.KEY=VALUE` takes the parameters below; in
        a table that has presets, `name = "…"` chooses the one that its other keys are laid over.
        `prc simulate parameters KIND` prints them as a file. What they mean is told in
        [Simulate](../simulation.md).

        ## Scanners
        """
    names = list(SCANNERS)
    fields = [
        key for key, info in Scanner.model_fields.items() if model_in(info.annotation) is None
    ]
    rows = [_row("", (f"`{name}`" for name in names)), "|---|" + "---|" * len(names)]
    for key in fields:
        values = [getattr(SCANNERS[name], key) for name in names]
        rows.append(
            _row(f"`{key}`", ("not set" if value is None else _plain(value) for value in values))
        )
    parts = [GENERATED, textwrap.dedent(intro), "\n".join(rows) + "\n"]
    seen: set[str] = set()
    for kind in KINDS:
        model = type(load_settings(kind))
        parts.append(f"## prc simulate {kind}\n")
        shown = [table for table in _tables(model, "") if not table.startswith("## [classes]")]
        parts += [table.replace("## ", "### ", 1) for table in shown if table not in seen]
        seen |= set(shown)
    return "\n".join(parts)


_SIGNATURES = re.compile(r"(?<=<!-- signatures -->\n).*?(?=<!-- end of signatures -->)", re.DOTALL)
_ROLE = re.compile(r":\w+:`~?([\w.]+)`")
_SHOWN = ("Parameters", "Returns", "Yields", "Raises")
"""Sections of a docstring that the page of the Python interface has."""
_LONGEST_LINE = 88


def python_page(text: str) -> str:
    """Return the page of the Python interface with the signatures of all public functions.

    Every function has its signature, its first paragraph, its parameters, results and errors.
    """
    functions = [
        (name, found)
        for name in prc_cli.__all__
        if inspect.isfunction(found := getattr(prc_cli, name))
    ]
    parts = "\n".join(_function(name, found) for name, found in functions)
    return _SIGNATURES.sub(lambda _: f"\n{parts}\n", text)


def _function(name: str, function: Callable[..., Any]) -> str:
    documentation = inspect.getdoc(function) or ""
    blocks = re.split(r"^(\w[\w ]*)\n-{3,}\n", documentation, flags=re.MULTILINE)
    sections = dict(zip(blocks[1::2], blocks[2::2], strict=True))
    summary = _markdown(blocks[0].strip().split("\n\n")[0])
    parts = [f"### {name}\n", f"```text\n{_signature(name, function)}\n```\n", f"{summary}\n"]
    parts += [
        f"**{title}**\n\n{_entries(sections[title])}\n" for title in _SHOWN if title in sections
    ]
    return "\n".join(parts)


def _signature(name: str, function: Callable[..., Any]) -> str:
    """Write a signature on one line, or a parameter a line; functions as defaults are dots."""
    shown = []
    signature = inspect.signature(function)
    is_keyword_only = False
    for parameter in signature.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not is_keyword_only:
            is_keyword_only = True
            shown.append("*")
        default = parameter.default
        words = f"{parameter.name}: {parameter.annotation}"
        if default is not parameter.empty:
            words += f" = {'...' if callable(default) else repr(default)}"
        shown.append(words)
    line = f"{name}({', '.join(shown)}) -> {signature.return_annotation}"
    if len(line) <= _LONGEST_LINE:
        return line
    rows = "".join(f"    {words},\n" for words in shown)
    return f"{name}(\n{rows}) -> {signature.return_annotation}"


def _entries(section: str) -> str:
    """Write the entries of a section of a docstring as a list."""
    rows = []
    for line in section.strip().splitlines():
        if line and not line.startswith(" "):
            name, _, kind = line.partition(" : ")
            rows.append(f"- `{name}`{f' ({_markdown(kind)})' if kind else ''}:")
        elif line.strip():
            rows[-1] += f" {_markdown(line.strip())}"
    return "\n".join(textwrap.fill(row.rstrip(":"), 120, subsequent_indent="  ") for row in rows)


def _markdown(text: str) -> str:
    """Return text of a docstring as Markdown."""
    return _ROLE.sub(r"`\1`", text.replace("``", "`"))


def _row(title: str, cells: Iterable[str]) -> str:
    return f"| {title} | {' | '.join(cells)} |"


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


Table = tuple[str, list[str], list[list[str]], list[str]]
"""Heading above it, names of columns, cells of rows, rows as they are written."""
_QUOTED = re.compile(r"(\d[\d.,]*)<!-- ([\w.]+\.md)#([\w-]+): (.*?) -->", re.DOTALL)
_ROWS = re.compile(r"<!-- rows of ([\w/.]+\.md)#([\w-]+) -->\n\n((?:\|.*\n)+)")
_NUMBER = re.compile(r"-?\d[\d,]*\.?\d*|-?\.\d+")


def with_figures(path: Path, text: str, figures: Path = ROOT / "figures") -> str:
    """Return a page of prose with its figures written anew from the tables that they name.

    Raises
    ------
    ValueError
        When a figure names a table, row or column that is not there, or a row that several fit.
    """

    def number(found: re.Match[str]) -> str:
        shown, page, section, title = found.groups()
        told = " ".join(title.split())
        try:
            value = _looked_up(tables(figures / page, section), told)
        except (LookupError, ValueError, OSError) as error:
            raise ValueError(
                f"{path.name}: {shown} of {page}#{section} {told!r}: {error}"
            ) from None
        return found.group().replace(shown, _like(shown, value), 1)

    def rows(found: re.Match[str]) -> str:
        page, section, table = found.groups()
        _, _, all_cells, lines = tables(figures / page, section)[0]
        known = {cells[0]: row for cells, row in zip(all_cells, lines, strict=True)}
        kept = []
        for row in table.splitlines()[2:]:
            if (name := _cells(row)[0]) not in known:
                raise ValueError(f"{path.name}: no row {name!r} in {page}#{section}")
            kept.append(known[name])
        return found.group().replace(table, "\n".join([*table.splitlines()[:2], *kept]) + "\n")

    return _ROWS.sub(rows, _QUOTED.sub(number, text))


@cache
def tables(page: Path, section: str) -> tuple[Table, ...]:
    """Return the tables below a heading, up to the next one that is not below it.

    Raises
    ------
    LookupError
        When there is no such heading.
    """
    level = 0
    heading = ""
    blocks: list[tuple[str, list[str]]] = [("", [])]
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            depth = len(line) - len(line.lstrip("#"))
            level = depth if _anchor(line) == section else level if depth > level else 0
            heading = line.lstrip("# ")
        elif level and line.startswith("|"):
            blocks[-1][1].append(line)
        elif (level and blocks[-1][1]) or heading != blocks[-1][0]:
            blocks.append((heading, []))
    found = [
        (name, _columns(_cells(rows[0])), [_cells(row) for row in rows[2:]], rows[2:])
        for name, rows in blocks
        if rows
    ]
    if not found:
        raise LookupError("there is no table below such a heading")
    return tuple(found)


def _anchor(heading: str) -> str:
    """Return the anchor of a heading, as mkdocs and GitHub make it.

    >>> _anchor("## Forest: Table II")
    'forest-table-ii'
    """
    return re.sub(
        r"[\s-]+",
        "-",
        re.sub(r"[^\w\s-]", "", heading.lstrip("# ").strip().lower(), flags=re.ASCII),
    )


def _cells(row: str) -> list[str]:
    return [cell.strip().strip("*`") for cell in row.strip().strip("|").split("|")]


def _columns(cells: list[str]) -> list[str]:
    """Return names of columns; those after "car recall" that say no class are of the car too."""
    names = []
    of = ""
    for cell in cells:
        if cell.endswith(" recall"):
            of = cell.removesuffix("recall")
        names.append(of + cell if cell in ("precision", "accuracy") else cell)
    return names


def _looked_up(found: tuple[Table, ...], title: str) -> float:
    """Return the figure that a title names."""
    parts = title.split(" > ")
    if any(heading == parts[0] for heading, *_ in found):
        found = tuple(table for table in found if table[0] == parts[0])
        parts = parts[1:]
    which = re.match(r"(least|most) of (.*)", parts[0])
    if which:
        parts[0] = which.group(2)
    leading, column = (parts[:-1], parts[-1]) if len(parts) > 1 else (parts, None)
    values = []
    for _, columns, rows, _ in found:
        places = [1] if column is None else _places(columns, column)
        for cells in rows:
            if places and len(cells) > max(places) and all(map(fnmatchcase, cells, leading)):
                is_share = column is not None and column.startswith("share of ")
                one, *other = (_number(cells[place], is_share=is_share) for place in places)
                values.append(one / other[0] if other else one)
    if not values:
        raise LookupError("no row and column of this name")
    if which:
        return min(values) if which.group(1) == "least" else max(values)
    if len(values) > 1:
        raise LookupError(f"{len(values)} rows of this name")
    return values[0]


def _places(columns: list[str], column: str) -> list[int]:
    """Return the place of a column, or of the two of a quotient.

    None where the table has none of that name.
    """
    names = [column] if column in columns else column.removeprefix("share of ").split(" / ")
    return [columns.index(name) for name in names] if set(names) <= set(columns) else []


def _number(cell: str, *, is_share: bool) -> float:
    """Return the first figure of a cell, or the first one in brackets."""
    found = _NUMBER.search(cell.partition("(")[2] if is_share else cell)
    if found is None:
        raise LookupError(f"no figure in {cell!r}")
    return float(found.group().replace(",", ""))


def _like(shown: str, value: float) -> str:
    """Write a value with the digits of another.

    >>> _like("0.53", 0.527), _like("1,200", 34567.8), _like("3", 2.9)
    ('0.53', '34,568', '3')
    """
    digits = len(shown.partition(".")[2])
    return f"{value:,.{digits}f}" if "," in shown or value >= 10_000 else f"{value:.{digits}f}"


def prose() -> dict[Path, str]:
    """Return every page that is written by hand, with its figures from the tables."""
    found = {}
    for path in sorted(
        [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "design").glob("*.md")]
    ):
        text = path.read_text(encoding="utf-8")
        if not text.startswith("<!-- ") and (_QUOTED.search(text) or _ROWS.search(text)):
            found[path] = with_figures(path, text)
    return found


def shown_classes() -> list[tuple[int, str, tuple[int, int, int]]]:
    """Return code, name and colour of every class that other programs may show."""
    codes = ClassCodes()
    found = {codes.code(label): (label.name.lower(), LABEL_COLOURS[label]) for label in Label}
    found[0] = ("never classified", LABEL_COLOURS[Label.UNCLASSIFIED])
    found[HIGH_NOISE_CODE] = ("high noise", LABEL_COLOURS[Label.NOISE])
    return [(code, *found[code]) for code in sorted(found)]


def qgis_style() -> str:
    """Return a style for point cloud layers of QGIS: every class code with its name and colour."""
    rows = "\n".join(
        f'      <category render="true" value="{code}" label="{code} {name}" '
        f'color="{r},{g},{b},255"/>'
        for code, name, (r, g, b) in shown_classes()
    )
    return f"""<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- written by docs/generate.py from the class codes; do not edit -->
<qgis styleCategories="Symbology" version="3.22">
  <renderer type="classified" attribute="Classification" pointSymbol="0" pointSize="1" \
pointSizeUnit="MM" maximumScreenError="0.3" maximumScreenErrorUnit="MM">
    <categories>
{rows}
    </categories>
  </renderer>
</qgis>
"""


def potree_classes() -> str:
    """Return a script that names and colours the class codes in a Potree viewer."""
    rows = "\n".join(
        f'    {code}: {{visible: true, name: "{name}", color: [{r / 255:.3f}, '
        f"{g / 255:.3f}, {b / 255:.3f}, 1]}},"
        for code, name, (r, g, b) in shown_classes()
    )
    return f"""// written by docs/generate.py from the class codes; do not edit
viewer.setClassifications({{
{rows}
    DEFAULT: {{visible: true, name: "other", color: [0.5, 0.5, 0.5, 1]}},
}});
"""


def pages() -> dict[Path, str]:
    """Return every generated file and its content."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    return {
        ROOT / "docs/reference/cli.md": cli_page(),
        ROOT / "docs/reference/configuration.md": configuration_page(),
        ROOT / "docs/reference/classes.md": classes_page(),
        ROOT / "docs/reference/checks.md": checks_page(),
        ROOT / "docs/reference/reasons.md": reasons_page(),
        ROOT / "docs/reference/simulation.md": simulation_page(),
        ROOT / "sample_configs/viewers/prc_classes.qml": qgis_style(),
        ROOT / "sample_configs/viewers/prc_classes_potree.js": potree_classes(),
        PYTHON: python_page(PYTHON.read_text(encoding="utf-8")),
        ROOT / "docs/changelog.md": GENERATED + changelog.replace("](docs/", "]("),
        **prose(),
    }


def main() -> int:
    """Write the pages, or with ``--check`` report the ones that differ."""
    stale = []
    for path, text in pages().items():
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(str(path.relative_to(ROOT)))
        if "--check" not in sys.argv:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    if stale:
        verb = (
            "differ from the code or the figures; run python docs/generate.py"
            if "--check" in sys.argv
            else "written"
        )
        sys.stderr.write(f"{', '.join(stale)}: {verb}\n")
    return 1 if stale and "--check" in sys.argv else 0


if __name__ == "__main__":
    sys.exit(main())
