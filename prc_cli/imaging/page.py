"""One page of HTML that holds all its pictures."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence

from PIL import Image

from prc_cli.imaging.sheet import Key, Panel, draw_panel

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1rem; color: #1a1a1a; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .3rem; }
p.head { color: #555; margin-top: 0; }
figure { margin: 1.2rem 0 1.8rem; } figure img { width: 100%; height: auto; display: block; }
figcaption { color: #333; } figcaption b { color: #000; }
ul.key { list-style: none; padding: 0; margin: .8rem 0; display: flex; flex-wrap: wrap; gap: .3rem 1.4rem; }
ul.key.top { position: sticky; top: 0; background: #fffffff0; padding: .5rem 0; border-bottom: 1px solid #ddd; }
ul.key span { display: inline-block; width: 1.5em; height: 1em; margin-right: .5em; }
ul.key span { border: 1px solid #777; vertical-align: -.1em; }
footer { color: #777; font-size: .85rem; margin-top: 3rem; }
""".strip()


def html_page(title: str, head: str, sections: Iterable[tuple[str, Sequence[Panel]]], key: Key, foot: str) -> str:
    """Return a page of HTML: pictures with captions under headings, nothing outside the file.

    Parameters
    ----------
    title, head : str
        Heading of the page and the line below it.
    sections : iterable of (heading, panels)
        An empty heading is left out.
    key : sequence of (text, colour)
        Shown at the top, where it stays in sight.
    foot : str
        Last line.
    """
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(title)}</h1><p class='head'>{html.escape(head)}</p>",
        _key(key, "key top"),
    ]
    for heading, panels in sections:
        if heading:
            parts.append(f"<h2>{html.escape(heading)}</h2>")
        parts.extend(_figure(panel) for panel in panels)
    parts.append(f"<footer>{html.escape(foot)}</footer></body></html>\n")
    return "\n".join(part for part in parts if part)


def _figure(panel: Panel) -> str:
    picture = png_bytes(draw_panel(panel, with_title=False))
    data = base64.b64encode(picture).decode("ascii")
    note = f" ({html.escape(panel.note)})" if panel.note else ""
    alt = html.escape(panel.title, quote=True)
    return (
        f'<figure><img alt="{alt}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>{html.escape(panel.title)}</b>{note}. {html.escape(panel.caption)}</figcaption>"
        f"{_key(panel.key, 'key')}</figure>"
    )


def _key(key: Key, kind: str) -> str:
    if not key:
        return ""
    items = "".join(f'<li><span style="background:rgb{colour}"></span>{html.escape(text)}</li>' for text, colour in key)
    return f'<ul class="{kind}">{items}</ul>'


def png_bytes(image: Image.Image) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=False)
    return buffer.getvalue()
