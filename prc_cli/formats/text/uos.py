"""Scans of 3DTK (``.3d``, its format "uos"): one point per row, columns x, y, z in centimetres."""

from __future__ import annotations

from pathlib import Path

from prc_cli.formats.options import Layout, LayoutField
from prc_cli.formats.text.read import TextSource

_CENTIMETRE = 0.01

UOS = Layout(
    delimiter=" ",
    # left-handed, y up, z forward: swap y and z for a right-handed frame with z up
    fields=(
        LayoutField(name="x", source=0, scale=_CENTIMETRE),
        LayoutField(name="z", source=1, scale=_CENTIMETRE),
        LayoutField(name="y", source=2, scale=_CENTIMETRE),
    ),
)
"""Points relative to the scanner in metres, z up."""


def open_uos(path: Path, layout: Layout | None) -> TextSource:
    """Open a ``.3d`` file."""
    return TextSource(path, uos_layout(layout))


def uos_layout(layout: Layout | None) -> Layout:
    """Return the layout of a ``.3d`` file, with line length and frequency of a layout without fields."""
    if layout is None:
        return UOS
    return layout if layout.fields else layout.model_copy(update={"fields": UOS.fields, "delimiter": UOS.delimiter})
