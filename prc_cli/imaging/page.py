"""What the pages with a script share: their frame, packed values, labels by hand."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.pages import render_page


@dataclass(frozen=True, slots=True)
class PaintedClass:
    """A class that can be painted."""

    code: int
    """Code in the saved file, as on the reference side of the mapping."""
    name: str
    colour: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class HandLabels:
    """What labels by hand are about, and how they are saved."""

    classes: Sequence[PaintedClass]
    scan: str
    """Digest of the scan; the browser keeps the labels under it."""
    name: str
    """Name of the file that is labelled."""
    records: int | None
    """Its number of records; None = not known."""
    file: str
    """Name of the saved file."""
    command: str
    """The command that evaluates with it."""


def interactive_page(
    template: str, about: Mapping[str, Any], texts: Mapping[str, str], values: Mapping[str, Any]
) -> str:
    """Return a page with a script.

    Parameters
    ----------
    template : str
        Its name without suffix, which is the name of its style and its script, too.
    about : mapping
        The description that the script reads.
    texts : mapping
        Packed values by the id of their element.
    values : mapping
        Further values of the template.
    """
    files = resources.files("prc_cli.imaging")
    styles = dict.fromkeys(("viewer", "paint", template))
    style = "".join((files / f"{name}.css").read_text(encoding="utf-8") for name in styles)
    script = "".join(
        (files / f"{name}.js").read_text(encoding="utf-8") for name in ("paint", template)
    )
    shared = {
        "style": style,
        "style_hash": _hash(style),
        "script": script,
        "script_hash": _hash(script),
        # "<" is escaped, so that user text cannot end the element
        "about": json.dumps(about, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "texts": texts.items(),
    }
    return render_page("prc_cli.imaging", f"{template}.html", {**values, **shared})


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


def pack(integers: NDArray[np.uint32], n_bytes: int) -> str:
    """Return integers below 256 ** n_bytes, (n,) uint32, as text."""
    steps = np.diff(integers, prepend=np.uint32(0)).astype("<u4")
    planes = steps.view(np.uint8).reshape(-1, 4).T[:n_bytes]
    compressed = zlib.compress(np.ascontiguousarray(planes).tobytes(), 6)
    return base64.b64encode(compressed).decode("ascii")
