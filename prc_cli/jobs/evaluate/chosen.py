"""The class mapping that fits predicted files, by the run records beside them and the reference's codes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from prc_cli.core.errors import PrcError
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.formats.labels import open_codes
from prc_cli.formats.writing.record import PROGRAM, read_record

DEFAULT_MAPPING = "prc"
"""Where no run record says otherwise."""

MAPPINGS = {"sequential-angle": "street_scan", "fused": "street", "rings": "street"}
"""Preset by method; forests have the classes of PRC, whatever the method."""


def mapping_of_runs(
    predicted: Sequence[Path], reference: Sequence[Path] = (), dimension: str | None = None
) -> tuple[str, str]:
    """Choose the preset with the classes of the method that wrote the predicted files, and the reference's codes."""
    asked = {_asked_by(path) for path in predicted}
    name, method = asked.pop() if len(asked) == 1 else (DEFAULT_MAPPING, "")
    why = [f"the run record says {method}"] if method else []
    if reference and (other := _listing(load_mapping(name), reference[0], dimension)):
        name = other
        why.append("it lists the reference's codes")
    return name, ", ".join(why)


def _listing(mapping: ClassMapping, reference: Path, dimension: str | None) -> str:
    """Return the likest preset that lists the first codes of a reference, where a mapping does not; else empty."""
    try:
        codes = np.unique(next(iter(open_codes(reference, dimension).chunks()), ()))
    except (PrcError, OSError):  # whoever compares the files says so
        return ""
    names = mapping.fitting(codes, "reference") if mapping.is_unlisted(codes, "reference").any() else []
    # codes of one kind of data alone leave no doubt
    kinds = {load_mapping(name).is_unlisted(np.arange(1 << 16), "reference").tobytes() for name in names}
    return names[0] if len(kinds) == 1 else ""


def _asked_by(path: Path) -> tuple[str, str]:
    """Return the preset for one file and its method; a record that is missing or damaged asks for nothing."""
    try:
        record = read_record(path)
        config = record["config"]
        method = config["method"]
        forest = method == "fused" and config["fused"]["environment"] == "forest"
        name = DEFAULT_MAPPING if forest or record["program"] != PROGRAM else MAPPINGS.get(method, DEFAULT_MAPPING)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return DEFAULT_MAPPING, ""
    return (DEFAULT_MAPPING, "") if name == DEFAULT_MAPPING else (name, method)
