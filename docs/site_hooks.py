"""What mkdocs adds to the pages: the version, captions, and the rank of pages in the search."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
_SHORT = re.compile(r"(?<!</span>)(?<!<pre>)<code>([^<\n]{1,20})</code>")
"""Code in a sentence that fits on the rest of a line; blocks are behind ``<pre>``."""
_PICTURE = re.compile(r'<p>(<img alt="([^"]*)"[^>]*>)</p>')


def on_config(config: Any) -> Any:
    """Print the version at the foot of every page."""
    text = (ROOT / "prc_cli" / "core" / "version.py").read_text(encoding="utf-8")
    version = re.search(r'__version__ = "([^"]+)"', text)
    config.copyright = f"prc {version[1]}" if version else "prc"
    return config


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Rank pages for looking up behind the pages to read."""
    if page.file.src_uri.startswith("reference/") or page.file.src_uri == "changelog.md":
        page.meta["search"] = {"boost": 0.2}
    return markdown


def _figure(found: re.Match[str]) -> str:
    """Return a picture with its caption; if it was drawn for dark pages too, with its twin."""
    picture, caption = found.groups()
    picture = picture.replace("<img", '<img loading="lazy"')
    name = re.search(r'src="[^"]*/(\w+)\.(\w+)"', picture)
    if name and (ROOT / "docs" / "images" / f"{name[1]}_dark.{name[2]}").exists():
        light, dark = (
            picture.replace(f"{name[1]}.{name[2]}", f"{name[1]}{end}.{name[2]}#only-{scheme}")
            for end, scheme in (("", "light"), ("_dark", "dark"))
        )
        picture = light + dark
    return f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"


def on_page_content(html: str, *, page: Any, **_: Any) -> str:
    """Give pictures their captions, and mark the tables of the reference for narrow screens."""
    html = _PICTURE.sub(_figure, html)
    html = _SHORT.sub(r'<code class="short">\1</code>', html)
    if page.file.src_uri.startswith(("reference/", "troubleshooting", "changelog", "formats")):
        html = html.replace("<table>", '<div class="cards"><table>')
        html = html.replace("</table>", "</table></div>")
    return html
