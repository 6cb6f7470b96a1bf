"""The manual is written in plain English: short sentences, short pages, and no riddles."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LONGEST_SENTENCE = 25
LONGEST_PAGE = 1200
MANUAL = 20_000
"""Words of all pages by hand."""
WRITTEN = "<!-- written by"
PAGES = [
    path
    for path in sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    if not path.read_text(encoding="utf-8").startswith(WRITTEN)
]
RIDDLES = {
    "semicolon": r";",
    "that of": r"\b(that|those) of\b",
    "Where": r"^Where\b(?! they differ| down is)",
    "word": r"\b(told|rightly|anew|amid|alone)\b",
    "what is": r"\bwhat (is|was|stands|returns)\b",
    "zero": r"(?<![\w.])\.\d\d",
}


def prose(text: str) -> Iterator[str]:
    """Yield paragraphs, items of lists and cells of tables, without code, comments and links."""
    text = re.sub(r"^( *)```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"``?[^`]+``?", "code", text)
    text = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", text)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\.) ?)", text):
        cells = block.split("|") if block.lstrip().startswith("|") else [block]
        for cell in cells:
            words = " ".join(re.sub(r"^\s*(?:[-*#]+|\d+\.)\s", "", cell).split())
            if re.search(r"\w", words):
                yield words


def problems(text: str) -> list[str]:
    """Return sentences that are too long and riddles, each with its place."""
    found = []
    for paragraph in prose(text):
        for sentence in re.split(r"(?<=[.!?:])\s+", paragraph):
            if len(sentence.split()) > LONGEST_SENTENCE:
                found.append(f"{len(sentence.split())} words: {sentence}")
            found += [
                f"{name}: {sentence}" for name, rule in RIDDLES.items() if re.search(rule, sentence)
            ]
    return found


def count_of(path: Path) -> int:
    text = re.sub(r"<!--.*?-->", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return len(text.split())


LONG: dict[str, int] = {}
"""Words of pages that are too long: counted down, never up."""


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_page_is_plain_english(path):
    found = problems(path.read_text(encoding="utf-8"))
    assert not found, "\n".join(found)


def test_pages_and_the_manual_are_short():
    words = {path.name: count_of(path) for path in PAGES}
    assert words.pop("README.md") <= 600  # commands, tables and links included
    assert sum(words.values()) <= MANUAL
    long = {name: n for name, n in words.items() if n > LONG.get(name, LONGEST_PAGE)}
    assert long == {}


def pages_to_do() -> list[str]:
    """Return the names of the pages that say how something is done."""
    parts = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("  - Do:\n")[2]
    return re.findall(r"[\w]+\.md", parts.partition("  - Know:\n")[0])


@pytest.mark.parametrize("name", pages_to_do())
def test_a_page_to_do_says_for_whom_shows_its_result_and_a_way_out(name):
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    first = text.split("\n\n")[1]
    assert first.startswith(("You need this page if", "For "))
    assert re.search(r"^```(console|bash)\n", text, re.MULTILINE)
    assert "](images/" in text or "```text\n" in text
    assert "\n## If it fails\n" in text
