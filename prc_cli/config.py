"""The configuration of a run: the parameters of all stages, and the source of every value.

Layers, later ones win: built-in defaults, the layout beside a dump (:func:`resolve`), a preset, a
TOML file, command-line options.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator
from pydantic.fields import FieldInfo

from prc_cli import methods
from prc_cli.core.brief import Brief
from prc_cli.core.classes import ClassCodes
from prc_cli.core.config import (
    OPTION,
    Params,
    build,
    flatten,
    merge,
    parse_toml,
    read_toml,
    samples_folder,
)
from prc_cli.core.errors import ConfigError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.near import did_you_mean, same_name
from prc_cli.core.stream import Assumption
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.writing.columns import OutputConfig
from prc_cli.methods.base import MethodParams
from prc_cli.methods.methods import METHODS, PRESETS_OF_OTHERS, MethodName, MethodTables, table_of


class _Input(Params):
    """Input and classification method."""

    method: Literal["auto"] | MethodName = Field(
        "auto",
        description="classifier: prc (Lehtola et al. 2019), sequential-angle (Stamos et al. 2012), "
        "fused (our own combination of both), rings (spinning scanners), or auto: the method whose "
        "table is given, else what labels the input best",
    )
    input: InputConfig = Field(
        default_factory=InputConfig, description="how the stream is read from the input"
    )
    layout: Layout | None = Field(None, description="records of a raw dump or a text file")


# pydantic orders fields by base class, the last base first; this is the order in the file
class RunConfig(MethodTables, _Input):
    """All settings of a run except its input file."""

    classes: ClassCodes = Field(default_factory=ClassCodes, description="class codes")
    output: OutputConfig = Field(default_factory=OutputConfig, description="what is written")

    @model_validator(mode="before")
    @classmethod
    def _decided_by_table(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or "method" in values:
            return values
        methods_given = tables_given(values)
        return {**values, "method": methods_given[0]} if len(methods_given) == 1 else values

    @classmethod
    def constants(cls, location: list[str], value: Any) -> dict[str, Any]:
        """Return keys of a method that are constants now (``constants.toml`` of the method)."""
        path = Path(methods.__file__).with_name(location[0]) / "constants.toml"
        if len(location) < 2 or not path.exists():
            return {}
        known = dict(flatten(tomllib.loads(path.read_text("utf-8")), f"{location[0]}."))
        key = ".".join(location)
        keys = (
            [name for name, _ in flatten(value, f"{key}.")] if isinstance(value, Mapping) else [key]
        )
        return {name: known[name] for name in keys if name in known}

    @property
    def is_decided(self) -> bool:
        """Whether a method is named; else :mod:`prc_cli.jobs.choice` chooses one by the input."""
        return self.method != "auto"

    @property
    def classifier(self) -> MethodParams:
        """Parameters of the method.

        Raises
        ------
        ConfigError
            No method is named (``method = "auto"``); see :attr:`is_decided`.
        """
        if self.method == "auto":
            problem = "found auto, expected a method: the input has not chosen one yet"
            raise ConfigError("method", problem, f"give one of: {', '.join(METHODS)}")
        params: MethodParams = getattr(self, table_of(self.method))
        return params

    @property
    def needs_beams(self) -> bool:
        """Whether a method is named that needs beam angles from straight down."""
        return self.is_decided and self.classifier.method().needs.beams

    def to_table(self) -> dict[str, Any]:
        """Return the effective configuration as a nested table of TOML, without unset values."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)

    def of_run(self) -> dict[str, Any]:
        """Return :meth:`to_table` with the parameters that labels depend on: no other method's."""
        table = self.to_table()
        for method in METHODS:
            if method not in (CHOSEN_FROM if self.method == "auto" else (self.method,)):
                del table[table_of(method)]
        return table


class BatchParams(Params):
    """How prc batch works; other commands ignore this table."""

    retry: int = Field(
        0, ge=0, description="try a file so many times more if the problem may be temporary"
    )
    fail_fast: bool = Field(False, description="stop after the first failure")
    stall: float = Field(
        600.0, gt=0, description="give up a file that makes no progress for this time [s]"
    )
    memory_limit: int | None = Field(None, ge=1, description="memory of each worker [MiB]")
    threads: int | None = Field(
        None,
        ge=1,
        description="threads per file; default: cores / jobs; labels do not depend on it",
    )
    mapping: str | None = Field(
        None, description="with --reference: classes of the codes, as prc evaluate --mapping"
    )
    match: str = Field(
        "order",
        description="with --reference: how records are matched: order, time, dimension:NAME or "
        "nearest",
    )
    drift: bool = Field(
        True, description="exit code 4 if the class shares of a file differ from earlier files"
    )
    time_stamps: bool = Field(False, description="start log lines with the time (UTC)")


class RenderParams(Params):
    """What prc render draws; other commands ignore this table."""

    station: int | None = Field(
        None, description="number of the scanner or of the scan; default: the first"
    )
    dimension: str | None = Field(None, description="column or dimension of the classes")


class CommandTables(Params):
    """Tables of single commands in a configuration; the other commands ignore them."""

    batch: BatchParams = Field(default_factory=BatchParams)
    render: RenderParams = Field(default_factory=RenderParams)


def command_tables(
    table: dict[str, Any], options: Mapping[str, Any], where: str
) -> tuple[CommandTables, dict[str, Any], dict[str, str]]:
    """Take the tables of single commands out of a file's table and out of the options, which win.

    Returns
    -------
    CommandTables
        The values.
    dict
        The options without these tables; ``table`` loses them, too.
    dict
        Layer by dotted key, of the values that are set.

    Raises
    ------
    ConfigError
        Unknown key, or a value of the wrong kind or out of bounds.

    Examples
    --------
    >>> of_file = {"batch": {"retry": 1}}
    >>> _, *rest = command_tables(of_file, {"batch": {"stall": 9}, "method": "prc"}, "a.toml")
    >>> rest
    [{'method': 'prc'}, {'batch.retry': 'a.toml', 'batch.stall': 'option'}]
    """
    others = dict(options)
    merged: dict[str, Any] = {}
    commands = CommandTables()
    sources: dict[str, str] = {}
    for name, layer in ((where, table), (OPTION, others)):
        tables = {key: layer.pop(key) for key in CommandTables.model_fields if key in layer}
        merged = merge(merged, tables)
        commands = build(CommandTables, merged, name)
        sources |= dict.fromkeys(dict(flatten(tables)), name)
    return commands, others, sources


CHOSEN_FROM: tuple[MethodName, ...] = ("prc", "fused", "rings")
"""Methods that prc may choose for an input."""


def tables_given(table: Mapping[str, Any]) -> list[MethodName]:
    """Return the methods that have a table in a configuration.

    >>> tables_given({"sequential_angle": {}, "input": {}})
    ['sequential-angle']
    """
    return [method for method in METHODS if table_of(method) in table]


PRESETS = (
    "prc-2019-urban",
    "prc-2019-forest",
    "fused",
    "fused-forest",
    "rings",
    "street-scan",
    "street-scan-published",
    *PRESETS_OF_OTHERS,
)
"""Names of the presets; each is a file of the sample configurations (:func:`preset_file`)."""


RENAMED_PRESETS = {"urban": "prc-2019-urban", "forest": "prc-2019-forest"}
"""Current names of presets by their names before 2.0."""


ChosenPreset = Literal["prc-2019-urban", "fused", "fused-forest", "rings"]
"""Presets that prc may choose for an input."""


@dataclass(frozen=True, slots=True)
class MethodChoice:
    """The method that prc chose for an input."""

    preset: ChosenPreset
    """Preset with the same labels."""
    why: str
    lacks: str = ""
    """What is missing for a better method; empty if nothing is."""
    give: str = ""
    """Option that gives it."""
    doubt: str = ""
    """Why the kind of place may be wrong; empty if it is clear."""

    @property
    def method(self) -> MethodName:
        """Name of the method."""
        if self.preset == "prc-2019-urban":
            return "prc"
        return "rings" if self.preset == "rings" else "fused"

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A doubt if a better method lacks data, or if the kind of place is not clear."""
        if self.doubt:
            expected = "a place that is clearly a street or a forest"
            give = "for a forest: --preset fused-forest; for a street: --preset fused"
            return (Finding("method", Verdict.DOUBTFUL, self.doubt, expected, give),)
        if not self.lacks:
            return ()
        # figures of `python -m benchmarks.contest`, photon-80
        problem = f"{self.lacks}, so prc chose PRC 2019 (F1 in streets 0.59, fused 0.96)"
        return (Finding("method", Verdict.DOUBTFUL, problem, "", self.give),)

    @property
    def assumption(self) -> Assumption:
        """The choice, for the run record.

        >>> MethodChoice("prc-2019-urban", "as an example").assumption.value
        'prc (--preset prc-2019-urban)'
        """
        return Assumption("method", f"{self.method} (--preset {self.preset})", self.why)


def refuse_window(config: RunConfig, command: str) -> None:
    """Raise :class:`ConfigError` if a part of a stream is given where all of it is needed."""
    if config.input.window is not None:
        problem = f"found {config.input.window.option}, but {command} takes files whole"
        raise ConfigError(
            "[input]",
            problem,
            "leave it out; prc classify, convert, calibrate and objects take a part",
        )


@dataclass(frozen=True, slots=True, repr=False)
class LoadedConfig(Brief):
    """A configuration and the source of each of its values."""

    config: RunConfig
    sources: dict[str, str] = field(default_factory=dict)
    """Layer by dotted key; other keys hold their default."""
    files: tuple[Path, ...] = ()
    """Files it was read from; a run never overwrites them."""
    notes: tuple[str, ...] = ()
    """Choices that prc made by itself, one sentence each."""
    choice: MethodChoice | None = None
    """The method that prc chose, and why; None = the user named it."""
    commands: CommandTables = field(default_factory=CommandTables)
    """Settings of single commands."""

    @classmethod
    def of(cls, config: LoadedConfig | RunConfig | None) -> LoadedConfig:
        """Return a configuration with its sources; None = the defaults."""
        return config if isinstance(config, LoadedConfig) else cls(config or RunConfig())

    def inputs(self, *more: Path | None) -> tuple[Path, ...]:
        """Return all files that a run reads; it never overwrites them."""
        return tuple(path for path in (*more, *self.files, self.trajectory) if path is not None)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Doubts about the method that prc chose."""
        return () if self.choice is None else self.choice.findings

    @property
    def trajectory(self) -> Path | None:
        """The trajectory file that ranges are computed from, if any."""
        kind, _, name = self.config.input.range.partition(":")
        return Path(name) if kind == "trajectory" else None


def load_config(
    path: Path | str | None = None,
    preset: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> LoadedConfig:
    """Build the effective configuration.

    Parameters
    ----------
    path : path, optional
        TOML file; it may name a preset itself (``preset = "fused-forest"``). Relative names
        inside it start at its folder.
    preset : str, optional
        One of :data:`PRESETS`; wins over the preset that the file names.
    options : mapping, optional
        Nested table that wins over everything else, for example ``{"prc": {"support": {"zeta_p":
        0.1}}}``.

    Raises
    ------
    ConfigError
        Unknown preset or key (the nearest known one is named), value of the wrong kind or out of
        bounds.
    InputError
        When the file cannot be read.

    Examples
    --------
    >>> loaded = load_config(preset="prc-2019-urban", options={"prc": {"support": {"zeta_p": 0.1}}})
    >>> loaded.config.prc.support.zeta_p, loaded.sources["prc.support.zeta_p"]
    (0.1, 'option')
    """
    file_path = None if path is None else Path(path)
    table = {} if file_path is None else read_toml(file_path)
    if "override" in table:
        problem = "[[override]] tables choose among the files of an archive, here there is one"
        raise ConfigError(str(path), problem, "they are for prc batch; make a file without them")
    named = table.pop("preset", None)
    commands, options, sources = command_tables(table, options or {}, str(path))
    chosen = preset if preset is not None else named
    layers: list[tuple[str, Mapping[str, Any]]] = []
    if chosen is not None:
        layers.append(preset_layer(chosen))
    if file_path is not None:
        layers.append((str(file_path), from_folder(table, file_path.parent)))
    if options:
        layers.append((OPTION, options))
    loaded = from_layers(layers, () if file_path is None else (file_path,))
    return replace(loaded, commands=commands, sources=loaded.sources | sources)


def from_layers(
    layers: Sequence[tuple[str, Mapping[str, Any]]], files: tuple[Path, ...] = ()
) -> LoadedConfig:
    """Build a configuration from named nested tables; later ones win."""
    merged: dict[str, Any] = {}
    sources: dict[str, str] = {}
    config = RunConfig()
    for name, layer in layers:
        if layer.get("method") == "auto" and sources.get("method", "").startswith(_PRESET):
            # a file that leaves the method open leaves it to the preset beside it
            layer = {key: value for key, value in layer.items() if key != "method"}
        merged = merge(merged, layer)
        # validated after every layer, so that the message names the right source
        config = build(RunConfig, merged, name)
        sources.update(dict.fromkeys(dict(flatten(layer)), name))
    if "method" not in merged and (methods_given := tables_given(merged)):
        tables = " and ".join(f"[{table_of(method)}]" for method in methods_given)
        if len(methods_given) > 1:
            problem = f"found the tables {tables} and no method, expected one method"
            raise ConfigError(
                layers[-1][0], problem, 'name it: method = "auto" is what labels the input best'
            )
        sources["method"] = f"the table {tables}"
    return LoadedConfig(config, sources, files)


_PRESET = "preset "
"""Beginning of the source of values that a preset sets."""


def preset_of(loaded: LoadedConfig) -> str | None:
    """Return the preset that named the method, or equals the chosen one; None = no preset.

    >>> preset_of(load_config(preset="street-scan")), preset_of(load_config())
    ('street-scan', None)
    """
    if loaded.choice is not None:
        return loaded.choice.preset
    source = loaded.sources.get("method", "")
    return source.removeprefix(_PRESET) if source.startswith(_PRESET) else None


def from_folder(table: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Return a table whose relative path of a trajectory starts at the folder of its file."""
    inputs = table.get("input")
    rule = inputs.get("range") if isinstance(inputs, Mapping) else None
    if not isinstance(rule, str) or not rule.startswith("trajectory:"):
        return table
    try:
        name = (folder / Path(rule.partition(":")[2]).expanduser()).absolute()
    except RuntimeError:
        raise ConfigError(
            "input.range", f"found {rule!r}, whose home folder is not known", "write it out"
        ) from None
    return merge(table, {"input": {"range": f"trajectory:{name}"}})


def preset_file(name: str) -> Path:
    """Return the file of a preset."""
    if name in PRESETS_OF_OTHERS:
        return PRESETS_OF_OTHERS[name]
    return samples_folder() / f"{name.replace('-', '_')}.toml"


def current_preset(name: Any) -> str:
    """Return the name of a preset, also for a name before 2.0 or in another spelling.

    >>> current_preset("urban"), current_preset("Street_Scan")
    ('prc-2019-urban', 'street-scan')

    Raises
    ------
    ConfigError
        There is no such preset; the message names the nearest one, or all.
    """
    if isinstance(name, str):
        known = same_name(name, (*PRESETS, *RENAMED_PRESETS))
        if known is not None:
            return RENAMED_PRESETS.get(known, known)
    problem = f"found {name!r}, expected one of: {', '.join(PRESETS)}"
    raise ConfigError("preset", problem, did_you_mean(str(name), PRESETS))


def preset_table(name: Any) -> dict[str, Any]:
    """Return the table of a preset, or raise :class:`ConfigError` with the names of all presets."""
    return read_toml(preset_file(current_preset(name)))


def preset_layer(name: Any) -> tuple[str, dict[str, Any]]:
    """Return a preset as a layer of :func:`from_layers`."""
    return f"{_PRESET}{current_preset(name)}", preset_table(name)


@dataclass(frozen=True, slots=True)
class PresetSummary:
    """Summary of a preset for ``prc config presets``."""

    name: str
    purpose: str
    """First line of the file: environment, method, source."""
    method: str
    n_changed: int
    """Number of values that differ from the defaults."""
    values: dict[str, Any]
    """Every value that the file sets, by dotted key, including those equal to the defaults."""
    file: Path


def preset_summaries() -> list[PresetSummary]:
    """Read every preset.

    >>> [(preset.name, preset.n_changed) for preset in preset_summaries()][:3]
    [('prc-2019-urban', 1), ('prc-2019-forest', 6), ('fused', 1)]
    """
    defaults = dict(flatten(RunConfig().to_table()))
    summaries = []
    for name in PRESETS:
        file = preset_file(name)
        with file.open(encoding="utf-8") as lines:
            purpose = lines.readline().removeprefix("#").strip()
        values = dict(flatten(preset_table(name)))
        effective = load_config(preset=name).config
        changed = [
            key for key, value in flatten(effective.to_table()) if value != defaults.get(key)
        ]
        summaries.append(PresetSummary(name, purpose, effective.method, len(changed), values, file))
    return summaries


def sample_summaries() -> list[tuple[Path, str]]:
    """Return the sample configurations that are no presets, each with its first line.

    >>> [file.name for file, _ in sample_summaries()]
    ['archive.toml', 'kitti_frame.toml', 'sick_push_broom.toml']
    """
    presets = {preset_file(name) for name in PRESETS}
    files = sorted(file for file in samples_folder().glob("*.toml") if file not in presets)
    return [
        (file, file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("#").strip())
        for file in files
    ]


def resolve(
    source: Path | str, config: LoadedConfig | RunConfig | None = None
) -> tuple[Input, LoadedConfig]:
    """Return an input and its configuration, with the layout beside the input as a layer.

    Raises
    ------
    ConfigError
        If the layout beside the input is damaged, or an option gives a layout that does nothing.
    """
    scan = Input.of(source)
    loaded = with_layout_beside(scan, LoadedConfig.of(config))
    return replace(scan, layout=loaded.config.layout), loaded


def with_layout_beside(scan: Input, loaded: LoadedConfig) -> LoadedConfig:
    """Add the layout beside a dump (``drive.bin.toml`` or ``drive.toml``), if none is given."""
    layout = loaded.config.layout
    if layout is not None and layout.fields and not scan.has_layout:
        reason = f"{scan.suffix or 'these'} files describe their records themselves"
        if loaded.sources.get("layout.fields") == OPTION and scan.path.is_file():
            problem = f"does nothing: {reason}"
            raise ConfigError(
                "layout.fields",
                problem,
                "leave it out; ranges in mm: --set input.range_scale=0.001",
            )
        note = f"the layout is not used: {reason}"
        return loaded if note in loaded.notes else replace(loaded, notes=(*loaded.notes, note))
    if layout is not None or not scan.has_layout:
        return loaded
    path = scan.path
    for beside in dict.fromkeys((path.with_name(f"{path.name}.toml"), path.with_suffix(".toml"))):
        if beside in loaded.files or not beside.is_file():
            continue
        table = read_toml(beside)
        if not isinstance(table.get("layout"), dict):
            continue
        sections: dict[str, Any] = {key: table[key] for key in ("input", "layout") if key in table}
        note = f"the layout is that of {beside.name} beside the dump; --layout gives another"
        layer = from_folder(sections, beside.parent)
        with_layout = _with_lowest_layer(loaded, str(beside), layer, note)
        return replace(with_layout, files=(*loaded.files, beside))
    return _with_layout_of_frame(scan, loaded)


def _with_layout_of_frame(scan: Input, loaded: LoadedConfig) -> LoadedConfig:
    """Add the layout of a KITTI frame, if a dump has its records and no rule is given."""
    inputs = loaded.config.input
    has_rules = (
        inputs.points_per_line is not None
        or (inputs.lines, inputs.columns, inputs.range) != ("auto",) * 3
    )
    if has_rules or not scan.is_dump or not scan.path.is_file():
        return loaded
    # imported here: only dumps need it
    from prc_cli.formats.frame import frame_fields

    names = frame_fields(scan.path)
    if names is None:
        return loaded
    sample = read_toml(samples_folder() / FRAME_SAMPLE)
    del (
        sample["method"],
        sample["input"]["points_per_line"],
    )  # frames of other scanners have other rings
    known = len(sample["layout"]["fields"])
    sample["layout"]["fields"] += [{"name": name, "type": "f4"} for name in names[known:]]
    shown = f"{', '.join(names[:-1])} and {names[-1]}"
    note = (
        f"the records look like {shown} of a frame: read as {FRAME_SAMPLE} says; "
        "--layout says otherwise"
    )
    return _with_lowest_layer(loaded, FRAME_SAMPLE, sample, note)


FRAME_SAMPLE = "kitti_frame.toml"
"""Sample configuration that reads a frame of x, y, z and intensity."""


def _with_lowest_layer(
    loaded: LoadedConfig, name: str, layer: Mapping[str, Any], note: str
) -> LoadedConfig:
    # the values that were set are the layers above: pydantic knows them
    above = loaded.config.model_dump(
        mode="json", by_alias=True, exclude_unset=True, exclude_none=True
    )
    # a table of a method in this layer does not choose the method
    above = {"method": loaded.config.method, **above}
    config = build(RunConfig, merge(layer, above), name)
    sources = {**{key: name for key, _ in flatten(layer)}, **loaded.sources}
    return replace(loaded, config=config, sources=sources, notes=(*loaded.notes, note))


def _nested(key: str, value: Any) -> dict[str, Any]:
    nested: Any = value
    for part in reversed(key.split(".")):
        nested = {part: nested}
    return dict(nested)


def parse_assignment(text: str) -> dict[str, Any]:
    """Turn ``prc.support.zeta_p=0.1`` into a nested table.

    The value is TOML, a bare word is a string.

    >>> parse_assignment("prc.surfaces.area=auto")
    {'prc': {'surfaces': {'area': 'auto'}}}
    """
    key, equals, value = text.partition("=")
    if not equals or not all(key.split(".")):
        raise ConfigError(
            "--set", f"found {text!r}, expected KEY=VALUE such as prc.support.zeta_p=0.1"
        )
    return _nested(key.strip(), _parse_value(value.strip()))


def _parse_value(text: str) -> Any:
    try:
        # .1 is a number for everybody but TOML
        value = f"0{text}" if text.startswith(".") and text[1:].isdecimal() else text
        return parse_toml(f"value = {value}", "--set")["value"]
    except ConfigError:
        return text


def options_of(loaded: LoadedConfig) -> list[str]:
    """Return the command-line options that give these settings again, files without folders.

    Presets and settings of the output are left out.

    >>> inputs = {"points_per_line": 2154, "lines": "fixed"}
    >>> options_of(load_config(options={"method": "prc", "input": inputs}))
    ['--method', 'prc', '--set', 'input.points_per_line=2154', '--set', 'input.lines=fixed']
    """
    values = dict(flatten(loaded.config.to_table()))
    words = list[str]()
    layered = set(loaded.sources.values())
    # a layout is laid into the options: no value has the name of its file
    has_layout = any(
        key.startswith("layout.") and source == OPTION for key, source in loaded.sources.items()
    )
    layouts = [file for file in loaded.files if has_layout and str(file) not in layered]
    for file in loaded.files:
        words += ["--layout" if file in layouts else "--config", file.name]
    for key, source in loaded.sources.items():
        is_other = key.startswith("output.") or (bool(layouts) and key.startswith("layout."))
        if source != OPTION or is_other or key not in values:
            continue
        value = values[key]
        text = (
            value if isinstance(value, str) and _parse_value(value) == value else _toml_value(value)
        )
        words += ["--method", text] if key == "method" else ["--set", f"{key}={text}"]
    return words


def to_toml(loaded: LoadedConfig, *, comments: bool = True) -> str:
    """Write an effective configuration as TOML that :func:`load_config` reads back."""
    return params_to_toml(loaded.config, loaded.sources, comments=comments)


def params_to_toml(
    params: Params, sources: Mapping[str, str] | None = None, *, comments: bool = True
) -> str:
    """Write any parameter table as TOML.

    >>> print(params_to_toml(ClassCodes(noise=18), comments=False).splitlines()[1])
    noise = 18
    """
    return "\n".join(_toml_lines(params, "", sources or {}, comments)).strip() + "\n"


def _toml_lines(
    table: Params,
    prefix: str,
    sources: Mapping[str, str],
    comments: bool,
) -> Iterator[str]:
    tables: list[tuple[str, Params]] = []
    for name, info in type(table).model_fields.items():
        key = info.alias or name
        value = getattr(table, name)
        if isinstance(value, Params):
            tables.append((key, value))
        else:
            yield from _toml_key(key, value, info, sources.get(f"{prefix}{key}"), comments)
    for key, value in tables:
        yield ""
        if comments and (documentation := type(value).__doc__):
            yield f"# {documentation.strip().splitlines()[0]}"
        source = sources.get(f"{prefix}{key}")
        yield f"[{prefix}{key}]" + (_origin(source) if comments and source else "")
        yield from _toml_lines(value, f"{prefix}{key}.", sources, comments)


def _toml_key(
    key: str,
    value: Any,
    info: FieldInfo,
    source: str | None,
    comments: bool,
) -> Iterator[str]:
    origin = _origin(source) if comments and source else ""
    if comments and info.description:
        yield f"# {info.description}"
    if value is None:
        if comments:
            yield f"# {key} ="
    elif isinstance(value, tuple) and value and isinstance(value[0], Params):
        rows = (row.model_dump(mode="json", by_alias=True, exclude_defaults=True) for row in value)
        yield f"{key} = [{origin}"
        yield from (
            f"    {{ {', '.join(f'{k} = {_toml_value(v)}' for k, v in row.items())} }},"
            for row in rows
        )
        yield "]"
    else:
        yield f"{key} = {_toml_value(value)}{origin}"


def _origin(source: str) -> str:
    # control characters in names of files are escaped: they could end the comment
    shown = "".join(
        character if character.isprintable() else ascii(character)[1:-1] for character in source
    )
    return f"  # from: {shown}"


def _toml_value(value: Any) -> str:
    # JSON is valid TOML once some characters are escaped
    text = json.dumps(value, ensure_ascii=False)
    return "".join(c if c.isascii() and c.isprintable() else f"\\U{ord(c):08x}" for c in text)


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of the configuration file, for editors and for the reference page."""
    schema = RunConfig.model_json_schema(by_alias=True)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "prc configuration"
    preset = {"type": "string", "enum": list(PRESETS), "description": "parameters to start from"}
    schema["properties"] = {"preset": preset, **schema["properties"]}
    for name, params in CommandTables():
        schema["properties"][name] = params.model_json_schema(by_alias=True)
    return schema
