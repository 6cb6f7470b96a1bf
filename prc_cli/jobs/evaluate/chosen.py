"""The class mapping that fits predicted files, by the run records beside them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prc_cli.formats.labels import KITTI_SUFFIX
from prc_cli.formats.writing.record import PROGRAM, read_record

DEFAULT_MAPPING = "prc"
"""Where no run record says otherwise."""

MAPPINGS = {"sequential-angle": "street_scan", "fused": "street", "rings": "street"}
"""Preset by method; forests have the classes of PRC, whatever the method."""
KITTI_MAPPINGS = {"street_scan": "street_scan_kitti", "street": "street_kitti", DEFAULT_MAPPING: "semantic_kitti"}
"""The same for labels of SemanticKITTI."""


def mapping_of_runs(predicted: Sequence[Path], reference: Sequence[Path] = ()) -> tuple[str, str]:
    """Choose the preset with the classes of the method that wrote the predicted files, and the reference's codes."""
    asked = {_asked_by(path) for path in predicted}
    name, method = asked.pop() if len(asked) == 1 else (DEFAULT_MAPPING, "")
    why = [f"the run record says {method}"] if method else []
    if reference and all(path.suffix == KITTI_SUFFIX for path in reference):
        name = KITTI_MAPPINGS[name]
        why.append("the reference holds labels of SemanticKITTI")
    return name, ", ".join(why)


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
