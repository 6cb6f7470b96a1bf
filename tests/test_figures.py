"""Pages of figures say what they were measured with, and are not older than the labels."""

import re

from packaging.version import Version

from benchmarks.pages import FIGURES, ROOT, measured
from prc_cli.core.version import __version__

TO_BE_MADE_ANEW = frozenset({"odometry", "trust"})
"""Pages that are older than the labels. None may be left at a release."""


def last_change_of_labels(changelog: str) -> Version:
    """Return the last version with an entry **Codes changed**."""
    versions = re.split(r"^## (?=\d)", changelog, flags=re.MULTILINE)[1:]
    changed = [text.split()[0] for text in versions if "**Codes changed**" in text]
    return max(map(Version, changed))


def is_old(page: str, changelog: str) -> bool:
    """Whether a page was measured before the last change of labels; a page without a head is."""
    head = measured(page)
    return head is None or Version(Version(head.version).base_version) < last_change_of_labels(
        changelog
    )


def test_every_page_begins_with_its_head():
    for path in FIGURES.glob("*.md"):
        text = path.read_text(encoding="utf-8")
        assert text.startswith("<!-- written by python -m benchmarks."), path
        assert measured(text) is not None, path
        assert not re.search(r"^\[\d+\]", text, re.MULTILINE), f"{path}: a library printed into it"


def test_no_page_is_older_than_the_labels():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    pages = {path.stem: path.read_text(encoding="utf-8") for path in FIGURES.glob("*.md")}
    assert {name for name, text in pages.items() if is_old(text, changelog)} == TO_BE_MADE_ANEW


def test_a_release_has_no_old_page():
    assert Version(__version__).is_devrelease or not TO_BE_MADE_ANEW


def test_the_head_decides_what_is_old():
    changelog = "## 2.0.0\n\n- x\n\n## 1.2.0\n\n- **Codes changed**, `fused`: x\n\n## 1.0.0\n"
    assert last_change_of_labels(changelog) == Version("1.2.0")
    head = "# Figures\n\nprc {}, commit abc, 2026-11-26, machine not recorded.\n"
    assert is_old(head.format("1.1.0"), changelog)
    assert not is_old(head.format("1.2.0"), changelog)
    assert not is_old(head.format("2.0.0.dev0"), changelog)
    assert is_old("# Figures\n\nOf today.\n", changelog)
    assert is_old("# Figures\n\n## prc 1.2.0, commit abc, 2026-11-26, here.\n", changelog)
