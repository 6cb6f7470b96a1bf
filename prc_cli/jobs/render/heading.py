"""Headlines of pictures: file, what labelled it, lines, day."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

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
    """Return what labelled a file according to the run record beside it; empty where there is none.

    Whatever cannot be read is as good as absent: a headline is no reason to refuse a picture.
    """
    path = record_path(labels)
    with suppress(OSError, ValueError, RecursionError):
        if path.stat().st_size <= LARGEST_RECORD:
            return _of_record(json.loads(path.read_text(encoding="utf-8")))
    return ""


def _of_record(found: Any) -> str:
    if not isinstance(found, Mapping) or found.get("program") != PROGRAM:
        return ""
    for one in found.get("assumptions") or ():
        if isinstance(one, Mapping) and one.get("key") == "method":
            return str(one.get("value", ""))[:80]
    config = found.get("config")
    method = config.get("method") if isinstance(config, Mapping) else None
    return method[:80] if isinstance(method, str) else ""
