"""Options shared by several commands.

One table gives the flags, the sections of the help, the keys and the next steps.

``stream_options``  how a stream is read from an input, and with which parameters it is classified
``input_options``   only how a stream is read
``window_options``  which part of it
``output_options``  ``--json --quiet --verbose``
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args

import click

from prc_cli.cli.paths import READ, READ_TEXT
from prc_cli.config import PRESETS, RENAMED_PRESETS, LoadedConfig, load_config, parse_assignment
from prc_cli.core.config import merge, or_sample, read_toml
from prc_cli.core.errors import ConfigError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.near import did_you_mean, same_name
from prc_cli.core.window import window_key
from prc_cli.methods.methods import METHODS


def complete_mapping(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the presets of class mappings, and TOML files."""
    from prc_cli.evaluation.mapping import preset_names

    return [
        *(name for name in preset_names() if name.startswith(incomplete)),
        *_toml_files(incomplete),
    ]


def complete_assignment(
    ctx: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str]:
    """Complete ``KEY=VALUE``: the keys of the configuration, then the words of a choice."""
    from prc_cli.config import CommandTables, RunConfig

    key, equals, value = incomplete.partition("=")
    kinds = {**dict(_keys_of(RunConfig, "")), **dict(_keys_of(CommandTables, ""))}
    if not equals:
        return [f"{name}=" for name in kinds if name.startswith(key)]
    return [f"{key}={word}" for word in _words(kinds.get(key)) if word.startswith(value)]


def _keys_of(model: Any, prefix: str) -> Any:
    from prc_cli.core.config import model_in

    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        kind = field.annotation
        inner = model_in(kind)
        if inner is None:
            yield key, kind
        else:
            yield from _keys_of(inner, f"{key}.")


def _words(kind: Any) -> list[str]:
    if kind is bool:
        return ["true", "false"]
    words = [word for word in get_args(kind) if isinstance(word, str)]
    return words or [word for inner in get_args(kind) for word in _words(inner)]


def _toml_files(incomplete: str) -> list[str]:
    folder = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
    try:
        paths = [
            path for path in sorted(folder.iterdir()) if path.suffix == ".toml" or path.is_dir()
        ]
    except OSError:
        return []
    shown = [
        f"{path}/" if path.is_dir() else str(path)
        for path in paths
        if not path.name.startswith(".")
    ]
    return [name for name in shown if name.startswith(incomplete)]


CommandT = TypeVar("CommandT", bound=Callable[..., Any])
FormT = TypeVar("FormT")


class Word(click.Choice):  # type: ignore[type-arg]  # not generic before click 8.2
    """One of some words, in any case, with - or _; a misspelt word gets the nearest one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word as it is spelt in the list."""
        word = same_name(value, self.choices)
        if word is None:
            hint = did_you_mean(value, self.choices) or self.all_words()
            self.fail(f"found {value!r}; {hint}", param, ctx)
        return super().convert(word, param, ctx)

    def all_words(self) -> str:
        """Return what to choose from, for the message."""
        return f"choose one of: {', '.join(self.choices)}"


class CheckName(Word):
    """Name of a check; a message does not list all of them."""

    def __init__(self) -> None:
        super().__init__(CHECK_NAMES)

    def all_words(self) -> str:
        """Return what lists the checks."""
        return "prc info FILE --checks lists them"


class PresetName(Word):
    """Name of a preset; a name before 2.0 is still known, and a note gives the new one."""

    def __init__(self) -> None:
        super().__init__(list(PRESETS))

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the name of today."""
        renamed = RENAMED_PRESETS.get(value)
        if renamed is not None:
            with suppress(OSError):  # nobody reads it any more: the run goes on
                click.echo(f"note: preset {value} is now called {renamed}", err=True)
        return super().convert(renamed or value, param, ctx)


class SharedOption(NamedTuple):
    """An option of several commands."""

    group: str
    section: str
    """Of the help."""
    flag: str
    """As next steps write it."""
    key: str
    """Of the configuration; empty = none. A flag has its value, too: ``KEY=VALUE``."""
    declared: tuple[str, ...]
    attributes: dict[str, Any]

    @property
    def parameter(self) -> str:
        """Name of its value."""
        named = [name for name in self.declared if not name.startswith("-")]
        return named[0] if named else max(self.declared, key=len).strip("-").replace("-", "_")


def _option(
    group: str, section: str, flag: str, *declared: str, key: str = "", **attributes: Any
) -> SharedOption:
    return SharedOption(group, section, flag, key, (flag, *declared), attributes)


SHARED = (
    _option(
        "method",
        "Method",
        "--method",
        key="method",
        type=Word(METHODS),
        help="Classifier. Default: the method of the preset or of the configuration, "
        "else prc chooses one.",
    ),
    _option(
        "method",
        "Method",
        "--preset",
        type=PresetName(),
        help="Parameters. fused, fused-forest: our method for profilers. rings: spinning scanners. "
        "prc-2019-urban, prc-2019-forest: PRC as published. street-scan: sequential-angle, for "
        "static scans. Default: prc chooses one.",
    ),
    _option(
        "input",
        "Method",
        "--config",
        "config_file",
        type=READ,
        metavar="FILE.toml",
        help="Configuration file, or the name of a sample (prc config presets lists them).",
    ),
    _option(
        "input",
        "Method",
        "--set",
        "assignments",
        type=READ_TEXT,
        multiple=True,
        metavar="KEY=VALUE",
        shell_complete=complete_assignment,
        help="Set a key of the configuration, e.g. prc.support.zeta_p=0.1. Can be repeated.",
    ),
    _option(
        "input",
        "Input",
        "--layout",
        "layout_file",
        type=READ,
        metavar="FILE.toml",
        help="Record layout of a raw dump or a text file.",
    ),
    _option(
        "input",
        "Input",
        "--lines",
        key="input.lines",
        help="How lines are found: dimension:NAME, fixed, angle-wrap, time:HZ, "
        "elevation:DEG or rings.",
    ),
    _option(
        "input",
        "Input",
        "--columns",
        key="input.columns",
        help="How columns are found: dimension:NAME, angle, time:HZ or order.",
    ),
    _option(
        "input",
        "Input",
        "--range",
        "range_",
        key="input.range",
        type=READ_TEXT,
        help="How ranges are found: dimension:NAME, points (a registered cloud with times), "
        "trajectory:FILE, origin:X,Y,Z or sensor-xyz.",
    ),
    _option(
        "input",
        "Input",
        "--scanner",
        key="input.scanner",
        help="How scanners are separated: none, scanner_channel, point_source_id or user_data.",
    ),
    _option(
        "input",
        "Input",
        "-M",
        "--points-per-line",
        "points_per_line",
        key="input.points_per_line",
        type=click.IntRange(min=1),
        help="Shots per scan line.",
    ),
    _option(
        "input",
        "Input",
        "--accept-doubt",
        "accept_doubts",
        key="input.accept_doubts",
        multiple=True,
        metavar="NAME",
        type=CheckName(),
        help="Accept the warning or refusal of the check NAME. Can be repeated.",
    ),
    _option(
        "input",
        "Input",
        "--trust-order",
        key="input.order=trust",
        is_flag=True,
        help="Do not check the order of the records.",
    ),
    _option(
        "sort",
        "Input",
        "--sort-by-time",
        key="input.order=sort-time",
        is_flag=True,
        help="Sort the records by time first.",
    ),
    _option(
        "window",
        "Input",
        "--only",
        metavar="A:B|LENGTH",
        help="Use only lines A to B - 1 (200:300), the time from A to B (512.5s:542.5s, or "
        "+10s:+40s from the first line), or the first 30s, 2min or 500lines.",
    ),
    _option(
        "output",
        "Run",
        "--json",
        "as_json",
        is_flag=True,
        help="Print the result as JSON on stdout.",
    ),
    _option(
        "output",
        "Run",
        "-q",
        "--quiet",
        is_flag=True,
        help="Print only errors and warnings (and --json).",
    ),
    _option(
        "output", "Run", "-v", "--verbose", is_flag=True, help="Print every assumption and count."
    ),
)

_OWN_SECTIONS = {
    "engine": "Method",
    "deep": "Input",
    "output": "Output",
    "outputs": "Output",
    "overwrite": "Output",
    "segment_ids": "Output",
    "confidence": "Output",
    "reason": "Output",
    "labels": "Output",
    "threads": "Run",
    "profile": "Run",
}
"""Sections of the options of a single command.

Options without a section are listed first, under "Options".
"""
_SECTIONS = {option.parameter: option.section for option in SHARED} | _OWN_SECTIONS


ALL_OPTIONS = "prc_cli.help.all"


def _print_all(ctx: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if wanted:
        ctx.meta[ALL_OPTIONS] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


class Sectioned(click.Command):
    """A command whose options are listed by what they are for.

    Parameters
    ----------
    brief : sequence of str
        Options that ``--help`` lists; ``--help-all`` lists all. Empty: ``--help`` lists all.
    """

    def __init__(self, *args: Any, brief: Sequence[str] = (), **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self._brief = frozenset(brief)
        if brief:
            all_options = click.Option(
                ["--help-all"],
                is_flag=True,
                is_eager=True,
                expose_value=False,
                callback=_print_all,
                help="Show all options and exit.",
            )
            self.params.append(all_options)

    def _is_listed(self, ctx: click.Context, parameter: click.Parameter) -> bool:
        is_brief = bool(self._brief) and not ctx.meta.get(ALL_OPTIONS)
        always = {"--help", "--help-all"}
        return not is_brief or not (self._brief | always).isdisjoint(parameter.opts)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, section by section.

        A command without options of a method keeps one list.
        """
        rows: dict[str, list[tuple[str, str]]] = {
            name: [] for name in ("Options", "Method", "Input", "Output", "Run")
        }
        n_hidden = 0
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None and not self._is_listed(ctx, parameter):
                n_hidden += 1
                continue
            if record is not None:
                is_help = not {"--help", "--help-all"}.isdisjoint(parameter.opts)
                rows["Run" if is_help else _SECTIONS.get(parameter.name or "", "Options")].append(
                    record
                )
        if not rows["Method"]:
            joined = [record for records in rows.values() for record in records]
            rows = {"Options": joined}
        for name, records in rows.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)
        if n_hidden:
            formatter.write_paragraph()
            formatter.write_text(f"{n_hidden} more options: {ctx.command_path} --help-all")


def add_options(*options: Callable[[Any], Any]) -> Callable[[CommandT], CommandT]:
    """Return a decorator that adds options in the order in which help shows them."""

    def add(command: CommandT) -> CommandT:
        return reduce(lambda decorated, option: option(decorated), reversed(options), command)

    return add


def _groups(*groups: str) -> Callable[[CommandT], CommandT]:
    return _flags(*(option.flag for group in groups for option in SHARED if option.group == group))


def _flags(*flags: str) -> Callable[[CommandT], CommandT]:
    chosen = [option for flag in flags for option in SHARED if option.flag == flag]
    return add_options(*(click.option(*option.declared, **option.attributes) for option in chosen))


live_options = _groups("method", "input")
"""Adds the options for classifying a stream as it arrives, which cannot be sorted."""
stream_options = _groups("method", "input", "sort")
"""Adds the options for reading and classifying a stream."""
PICTURE_FLAGS = ("--preset", "--config", "--set", "--layout", "--range", "-M", "--accept-doubt")
"""Those of :data:`stream_options` that ``prc render`` has; the others are keys there."""
picture_options = _flags(*PICTURE_FLAGS)
"""Adds these options."""
input_options = _groups("input", "sort")
"""Adds the options for reading a stream, for commands that do not classify."""
window_options = _groups("window")
"""Adds the options for reading a part of a stream, to try settings."""
output_options = _groups("output")
"""Adds ``--json``, ``--quiet`` and ``--verbose``."""


MAPPING = click.option(
    "--mapping",
    type=READ_TEXT,
    metavar="NAME|FILE.toml",
    shell_complete=complete_mapping,
    help="Classes of the codes, as for prc evaluate.",
)
QUIET = click.option("-q", "--quiet", is_flag=True, help="Print only errors (and --json).")
JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")


def by_side(texts: Iterable[str], flag: str, side: str, *others: str) -> dict[str, str]:
    """Return the values of an option for the sides of a comparison, ``VALUE`` or ``SIDE=VALUE``.

    Parameters
    ----------
    texts : iterable of str
        As typed.
    flag : str
        For the message.
    side : str
        Side of a value without a name.
    *others : str
        Sides that a value can name.

    Raises
    ------
    ConfigError
        A side has two values.

    Examples
    --------
    >>> by_side(["label", "reference=class"], "--dimension", "predicted", "reference")
    {'predicted': 'label', 'reference': 'class'}
    """
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        is_named = bool(equals) and name in others
        key = name if is_named else side
        value = value if is_named else text
        if key in values:
            problem = f"found {values[key]} and {value} for one side, expected one"
            raise ConfigError(flag, problem, f"for another side: {others[0]}=VALUE")
        values[key] = value
    return values


def form_of_output(path: Path, forms: Mapping[str, FormT], where: str = "") -> FormT:
    """Return the form of a file to write by its suffix; refuse other suffixes than of ``forms``."""
    form = forms.get(path.suffix.lower())
    if form is None:
        problem = f"found the suffix {path.suffix!r}, expected one of: {' '.join(forms)}"
        raise ConfigError(where or str(path), problem, "choose a name with one of these suffixes")
    return form


POSES = (
    click.option(
        "--trajectory",
        type=READ,
        metavar="FILE",
        help="For nearest: poses of the vehicle. prc computes coordinates of the raw shots with "
        "them. "
        "CSV with roll, pitch, yaw, or TUM, SBET, a bag.",
    ),
    click.option(
        "--mount",
        metavar="ROLL,PITCH,YAW[,X,Y,Z]",
        help="How the scanner is mounted on the vehicle of --trajectory [degrees; metres forward, "
        "left, "
        "up]. If the lower part of the scan plane points back, the pitch is above 0.  [default: "
        "0,0,0]",
    ),
)
"""Options that give raw shots coordinates."""


def given_words(
    options: Mapping[str, Any],
    leave_out: Collection[str] = (),
    flags: Collection[str] | None = None,
) -> list[str]:
    """Return the options of :data:`stream_options` as they were typed, for the next command.

    Parameters
    ----------
    options : dict
        Values by parameter.
    leave_out : collection of str
        Flags that are left out.
    flags : collection of str, optional
        Flags that the next command has; the others become keys. None = it has all.

    Examples
    --------
    >>> given_words({"preset": "urban", "points_per_line": 2154, "trust_order": False})
    ['--preset', 'urban', '-M', '2154']
    >>> given_words({"lines": "fixed", "trust_order": True}, flags=())
    ['--set', 'input.lines=fixed', '--set', 'input.order=trust']
    """
    words: list[str] = []
    for option in SHARED:
        value = options.get(option.parameter)
        if value and option.flag not in leave_out and option.group in ("method", "input", "sort"):
            is_key = flags is not None and option.flag not in flags
            for part in value if isinstance(value, tuple) else (value,):
                texts = [] if part is True else [str(part)]
                words += (
                    ["--set", "=".join([option.key, *texts])] if is_key else [option.flag, *texts]
                )
    return words


@dataclass(frozen=True, slots=True)
class Layers:
    """Layers of the configuration; later ones win."""

    path: Path | None
    """``--config``."""
    preset: str | None
    """``--preset``; the file may also name one."""
    table: dict[str, Any]
    """All other options, nested."""
    files: tuple[Path, ...]
    """Other files that were read."""


def config_from(options: Mapping[str, Any]) -> LoadedConfig:
    """Build the configuration from the values of :data:`stream_options`."""
    layers = layers_from(options)
    loaded = load_config(layers.path, layers.preset, layers.table)
    return replace(loaded, files=(*loaded.files, *layers.files))


def layers_from(options: Mapping[str, Any]) -> Layers:
    """Read the values of :data:`stream_options` as separate layers, without merging them."""
    if options.get("sort_by_time") and options.get("trust_order"):
        message = "--sort-by-time and --trust-order contradict each other"
        raise click.UsageError(message)
    layout_file: Path | None = options["layout_file"]
    table: dict[str, Any] = {}
    if layout_file is not None:
        table = layout_in(layout_file := or_sample(layout_file))
    method = options.get("method")
    preset = options.get("preset")
    if (
        method is not None
        and preset is not None
        and (preset_method := load_config(preset=preset).config.method) != method
    ):
        message = f"--preset {preset} is for --method {preset_method}, not {method}"
        raise click.UsageError(message)
    keys = {
        option.parameter: option.key for option in SHARED if option.key and "=" not in option.key
    }
    table = merge(table, table_from(options["assignments"], options, keys))
    for option in SHARED:
        if "=" in option.key and options.get(option.parameter):
            table = merge(table, parse_assignment(option.key))
    only = options.get("only")
    if only is not None:
        table = merge(table, {"input": {window_key(only): only}})
    path: Path | None = options["config_file"]
    return Layers(
        path and or_sample(path), preset, table, () if layout_file is None else (layout_file,)
    )


def layout_in(path: Path) -> dict[str, Any]:
    """Return the configuration of a layout file: its table ``[layout]``, else all of it."""
    content = read_toml(path)
    return {"layout": content.get("layout", content)}


def table_from(
    assignments: Iterable[str], options: Mapping[str, Any], keys: Mapping[str, str]
) -> dict[str, Any]:
    """Return the nested table of ``--set`` and of the options of keys; an option wins.

    Examples
    --------
    >>> table_from(["input.lines=fixed"], {"points_per_line": 8}, {"points_per_line": "input.M"})
    {'input': {'lines': 'fixed', 'M': 8}}
    """
    tables = [parse_assignment(assignment) for assignment in assignments]
    for name, key in keys.items():
        value = options.get(name)
        if value is not None and value != ():
            *outer, last = key.split(".")
            table = {last: list(value) if isinstance(value, tuple) else value}
            tables.append(reduce(lambda inner, part: {part: inner}, reversed(outer), table))
    return reduce(merge, tables, {})


def numbers(text: str | None, option: str) -> tuple[float, ...]:
    """Read numbers with commas between them."""
    try:
        return tuple(float(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError(
            option, f"found {text!r}, expected numbers separated by commas, such as 0,25,0"
        ) from None
