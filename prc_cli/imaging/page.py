"""A self-contained HTML page of pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence

from PIL import Image

from prc_cli.core.pages import render_page
from prc_cli.imaging.sheet import Key, Panel, draw_panel


def html_page(title: str, head: str, sections: Iterable[tuple[str, Sequence[Panel]]], key: Key, foot: str) -> str:
    """Return an HTML page of pictures with captions under headings, without external files."""
    values = {"title": title, "head": head, "sections": sections, "key": key, "foot": foot}
    return render_page("prc_cli.imaging", "pictures.html", values, {"png": _png_text})


def _png_text(panel: Panel) -> str:
    return base64.b64encode(png_bytes(draw_panel(panel, with_title=False))).decode("ascii")


def png_bytes(image: Image.Image) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=False)
    return buffer.getvalue()
