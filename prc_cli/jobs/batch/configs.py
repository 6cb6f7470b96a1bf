"""The configuration of every file of an archive: tables for some files, trajectories by name."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from prc_cli.config import (
    LoadedConfig,
    RunConfig,
    command_tables,
    from_folder,
    from_layers,
    preset_layer,
    refuse_window,
)
from prc_cli.core.config import read_toml
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import suffix_of
from prc_cli.formats.writing.record import fingerprint
from prc_cli.jobs.batch.discovery import Patterns
from prc_cli.jobs.batch.types import ConfigLayers

TRAJECTORY = "trajectory:"
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")


class BatchConfig:
    """The configuration of every file of an archive.

    The TOML file may contain ``[[override]]`` tables: ``match`` selects files by patterns
    (:class:`~prc_cli.jobs.batch.discovery.Patterns`), ``preset`` replaces the preset of the TOML
    file, and all other keys replace its keys. If several tables match, the last one wins. Options
    of the command line override them all.

    The name of a trajectory may contain placeholders: ``{name}`` and ``{stem}`` of the input, its
    ``{folder}``, and ``{subfolder}``, the folder relative to the archive.
    """

    def __init__(self, layers: ConfigLayers) -> None:
        self._layers = layers
        self._where = str(layers.path)
        table = {} if layers.path is None else read_toml(layers.path)
        commands, self._options, _ = command_tables(table, layers.options, self._where)
        self.batch = commands.batch
        """Values of the table ``[batch]``."""
        overrides = table.pop("override", [])
        self._preset = table.pop("preset", None)
        self._table = self._placed(table)
        if not isinstance(overrides, list) or not all(
            isinstance(table, dict) for table in overrides
        ):
            raise ConfigError(
                self._where, "override: expected tables, each beginning with [[override]]"
            )
        self._overrides = [self._override(number, item) for number, item in enumerate(overrides, 1)]
        self._built: dict[tuple[int, ...], LoadedConfig] = {}
        self._prints: dict[Path, str] = {}
        for number in range(len(self._overrides)):
            self._build((number,))
        self.base = self._build(())
        """The configuration without overrides."""
        self.base_sha256 = config_hash(self.base.config, None)

    def _override(self, number: int, table: dict[str, Any]) -> _Override:
        where = f"{self._where}: override {number}"
        keys = dict(table)
        preset = keys.pop("preset", None)
        match = keys.pop("match", None)
        patterns = [match] if isinstance(match, str) else match
        if (
            not isinstance(patterns, list)
            or not patterns
            or not all(isinstance(pattern, str) for pattern in patterns)
        ):
            problem = "match: expected a pattern or a list of patterns"
            if match is not None:
                problem += f", found {match!r}"
            raise ConfigError(where, problem, 'for example match = "night/*.laz"')
        return _Override(where, Patterns(patterns), preset, self._placed(keys))

    def _placed(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        # a trajectory is relative to the folder of the configuration file, unless {folder} is first
        rule = table["input"].get("range") if isinstance(table.get("input"), Mapping) else None
        if self._layers.path is None or (
            isinstance(rule, str) and rule.startswith(f"{TRAJECTORY}{{folder}}")
        ):
            return table
        return from_folder(table, self._layers.path.parent)

    def _build(self, matching: tuple[int, ...]) -> LoadedConfig:
        if matching not in self._built:
            sources = self._layers
            overrides = [self._overrides[number] for number in matching]
            presets = [self._preset, *(override.preset for override in overrides), sources.preset]
            preset = next((name for name in reversed(presets) if name is not None), None)
            layers: list[tuple[str, Mapping[str, Any]]] = []
            files = sources.files
            if preset is not None:
                layers.append(preset_layer(preset))
            if sources.path is not None:
                layers.append((self._where, self._table))
                files = (sources.path, *files)
            layers.extend((override.where, override.table) for override in overrides)
            if self._options:
                layers.append(("option", self._options))
            self._built[matching] = from_layers(layers, files)
            refuse_window(self._built[matching].config, "prc batch")
        return self._built[matching]

    def of(self, name: str, path: Path) -> tuple[LoadedConfig, str]:
        """Return the configuration of a file and its hash."""
        matching = (i for i, item in enumerate(self._overrides) if item.patterns.match(name))
        loaded = self._build(tuple(matching))
        rule = loaded.config.input.range
        if not rule.startswith(TRAJECTORY):
            is_base = loaded.config is self.base.config
            return loaded, self.base_sha256 if is_base else config_hash(loaded.config, None)
        filled = TRAJECTORY + _fill(rule.removeprefix(TRAJECTORY), name, path)
        if filled != rule:
            inputs = loaded.config.input.model_copy(update={"range": filled})
            loaded = replace(loaded, config=loaded.config.model_copy(update={"input": inputs}))
        assert loaded.trajectory is not None
        return loaded, config_hash(loaded.config, self._trajectory_hash(loaded.trajectory))

    def _trajectory_hash(self, path: Path) -> str:
        if path not in self._prints:
            if path.exists() and not path.is_file():
                raise InputError(
                    str(path), "not a regular file, expected a trajectory", "check [input] range"
                )
            try:
                self._prints[path] = fingerprint(path).sha256 or ""
            except (InputError, OSError) as error:
                why = error.problem if isinstance(error, InputError) else error.strerror
                problem = f"the trajectory cannot be read ({why})"
                raise InputError(
                    str(path), problem, "check [input] range and its placeholders"
                ) from error
        return self._prints[path]


class _Override(NamedTuple):
    where: str
    patterns: Patterns
    preset: Any
    table: Mapping[str, Any]


def _fill(template: str, name: str, path: Path) -> str:
    stem = path.name[: len(path.name) - len(suffix_of(path))]
    subfolder = name.rpartition("/")[0] or "."
    values = {"name": path.name, "stem": stem, "folder": str(path.parent), "subfolder": subfolder}

    def value(placeholder: re.Match[str]) -> str:
        if placeholder[1] not in values:
            known = ", ".join(f"{{{key}}}" for key in values)
            raise ConfigError(
                "input.range", f"unknown placeholder {placeholder[0]!r}, expected one of: {known}"
            )
        return values[placeholder[1]]

    return _PLACEHOLDER.sub(value, template)


def config_hash(config: RunConfig, trajectory_sha256: str | None) -> str:
    """Return the hash of a configuration and its trajectory.

    Folders, the keys of other methods and accepted doubts do not change it.
    """
    table = config.of_run()
    table["input"].pop("accept_doubts", None)
    if trajectory_sha256 is not None:
        table["input"]["range"] = f"{TRAJECTORY}{trajectory_sha256}"
    return sha256(json.dumps(table, sort_keys=True, ensure_ascii=True).encode("ascii")).hexdigest()
