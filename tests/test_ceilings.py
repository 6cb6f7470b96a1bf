"""The house stays as small as docs/architecture.md says: lines and files of every room, in one table there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROW = re.compile(r"^\| `([\w./]+)` \| ([\d ]+) \| ([\d ]+) \|", re.MULTILINE)
TOGETHER = re.compile(r"^`prc_cli` together: at most ([\d ]+) lines in ([\d ]+) files", re.MULTILINE)
SLACK = 0.03
"""A ceiling that lies higher above its room is lowered, so that what was won stays won."""


def ceilings() -> dict[str, tuple[int, int]]:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").partition("## Ceilings")[2]
    return {room: (number(lines), number(files)) for room, lines, files in ROW.findall(text)}


def together() -> tuple[int, int]:
    found = TOGETHER.search((ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"))
    assert found
    return number(found[1]), number(found[2])


def number(text: str) -> int:
    return int(text.replace(" ", ""))


def measured(room: str, rooms: set[str]) -> tuple[int, int]:
    """Lines and files of a room, without those of rooms inside it that have a row of their own."""
    place = ROOT / room
    inner = [ROOT / other for other in rooms if other != room and (ROOT / other).is_relative_to(place)]
    files = [
        path
        for path in ([place] if place.is_file() else place.rglob("*.py"))
        if not any(path.is_relative_to(other) for other in inner)
    ]
    return sum(len(path.read_bytes().splitlines()) for path in files), len(files)


def test_every_room_is_below_its_ceiling_and_close_to_it() -> None:
    table = ceilings()
    assert {"prc_cli/jobs", "tests", "benchmarks"} <= set(table)
    for room, (most_lines, most_files) in [*table.items(), ("prc_cli", together())]:
        lines, files = measured(room, set(table) if room != "prc_cli" else set())
        place = f"{room}: found {lines} lines in {files} files, expected at most {most_lines} in {most_files}"
        assert lines <= most_lines, f"{place}; which line does the new one replace?"
        assert files <= most_files, place
        assert most_lines <= lines * (1 + SLACK) + 50, f"{place}; lower the ceiling in docs/architecture.md"


def test_no_room_is_left_out() -> None:
    rooms = set(ceilings())
    inside = {f"prc_cli/{path.name}" for path in (ROOT / "prc_cli").iterdir() if (path / "__init__.py").exists()}
    assert inside <= rooms
