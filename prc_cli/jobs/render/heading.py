"""Headlines of pictures: file, what labelled it, lines, day."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from prc_cli import __version__
from prc_cli.config import LoadedConfig, preset_of
from prc_cli.core.dates import today
from prc_cli.formats.writing.record import PROGRAM, record_path

LARGEST_RECORD = 4 << 20
"""Records beyond are not looked at [bytes]."""


def heading(*parts: str) -> str:
    """Return a headline that ends with the day; empty parts are left out."""
    return " · ".join(filter(None, (*parts, today())))


def made_with(loaded: LoadedConfig) -> str:
    """Return the preset, or the method where there is none, that a file is classified with.

    >>> from prc_cli.config import load_config
    >>> made_with(load_config(preset="forest")), made_with(load_config(options={"method": "prc"}))
    ('preset forest', 'prc, urban')
    """
    preset, config = preset_of(loaded), loaded.config
    if preset is not None:
        return f"preset {preset}"
    return f"prc, {config.prc.environment}" if config.method == "prc" else str(config.method)


def made_by(labels: Path) -> str:
    """Return what labelled a file according to the run record beside it; empty where there is none."""
    return _method_of(_record_of(labels))


def origin(labels: Sequence[Path]) -> tuple[str, ...]:
    """Return what made a page about label files: day and version, method and input as far as run records name them."""
    found = [_record_of(path) for path in labels]
    methods = dict.fromkeys(filter(None, (_method_of(record) for record in found)))
    inputs = dict.fromkeys(filter(None, (_input_of(record) for record in found)))
    source = f"{len(inputs):,} inputs" if len(inputs) > 1 else "".join(f"input {name}" for name in inputs)
    return tuple(filter(None, (today(), f"prc {__version__}", ", ".join(methods), source)))


def _record_of(labels: Path) -> Mapping[str, Any]:
    """Return a run record; empty where it is absent or cannot be read, which is no reason to refuse a picture."""
    with suppress(OSError, ValueError, RecursionError):
        path = record_path(labels)
        if path.stat().st_size <= LARGEST_RECORD:
            found = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(found, Mapping) and found.get("program") == PROGRAM:
                return found
    return {}


def _method_of(record: Mapping[str, Any]) -> str:
    for one in record.get("assumptions") or ():
        if isinstance(one, Mapping) and one.get("key") == "method":
            return str(one.get("value", ""))[:80]
    config = record.get("config")
    method = config.get("method") if isinstance(config, Mapping) else None
    return method[:80] if isinstance(method, str) else ""


def _input_of(record: Mapping[str, Any]) -> str:
    source = record.get("input")
    name = source.get("name") if isinstance(source, Mapping) else None
    return name[:200] if isinstance(name, str) else ""
