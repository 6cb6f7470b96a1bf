"""What mkdocs adds to the pages: the version, captions, and the rank of pages in the search."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
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


def on_page_content(html: str, *, page: Any, **_: Any) -> str:
    """Give pictures their captions, and mark the tables of the reference for narrow screens."""
    html = _PICTURE.sub(r"<figure>\1<figcaption>\2</figcaption></figure>", html)
    if page.file.src_uri.startswith(("reference/", "troubleshooting")):
        html = html.replace("<table>", '<div class="cards"><table>')
        html = html.replace("</table>", "</table></div>")
    return html
