"""Text in pages."""

from __future__ import annotations

from pathlib import Path

import pytest

from prc_cli.core.pages import render_page


def test_text_is_escaped_and_control_characters_are_blanks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "paged" / "templates").mkdir(parents=True)
    (tmp_path / "paged" / "__init__.py").touch()
    (tmp_path / "paged" / "templates" / "a.html").write_text("{{ a }} {{ b|safe }}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    page = render_page("paged", "a.html", {"a": "<i>\x1b[1m\x00é", "b": "<i>\n</i>"})
    assert page == "&lt;i&gt; [1m é <i>\n</i>\n"
