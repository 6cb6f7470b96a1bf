"""How heavy the house is to read: ``python -m tests.measure [FOLDER ...]``.

Lines are not counted, since they can be made fewer by making them denser. Counted is what a
reader has to read: tokens (names, numbers, strings, operators) without comments and docstrings,
and what makes a line dense. Python in golden cases counts, too. ``tests/test_house.py`` holds the
totals.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

from tests.golden.cases import programs

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("prc_cli", "tests", "benchmarks")
LONGEST_LINE = 100

RIDDLES = frozenset(
    "found told own given one some each other at so_far stand stands".split()  # noqa: SIM905
)
"""Identifiers that do not say what they name."""

_LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass
class Weight:
    """Counts of one file, or of the files of a folder."""

    tokens: int = 0
    code_lines: int = 0
    """Lines that hold a token."""
    long_lines: int = 0
    """Lines over 100 characters."""
    assignments: int = 0
    packed: int = 0
    """Assignments of several values to several names, ``a, b = x, y``."""
    named_once: int = 0
    """Private functions that their file names once besides the definition."""
    tuples: int = 0
    """Parameters that are tuples of several kinds of things without names."""
    format_skips: int = 0
    riddles: int = 0

    def add(self, room: Weight) -> None:
        """Add the counts of a file or a room."""
        for field in fields(self):
            total = getattr(self, field.name) + getattr(room, field.name)
            setattr(self, field.name, total)

    @property
    def tokens_per_line(self) -> float:
        """Mean number of tokens of lines that hold any."""
        return self.tokens / max(self.code_lines, 1)

    @property
    def packed_share(self) -> float:
        """Share of packed assignments."""
        return self.packed / max(self.assignments, 1)


def weigh_text(text: str) -> Weight:
    """Weigh the source of one module."""
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    in_docstrings = set(_docstring_lines(nodes))
    tokens = [
        token
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in _LAYOUT and token.start[0] not in in_docstrings
    ]
    names = Counter(token.string for token in tokens if token.type == tokenize.NAME)
    functions = [node for node in nodes if isinstance(node, _FUNCTIONS)]
    assignments = [node for node in nodes if isinstance(node, ast.Assign)]
    return Weight(
        tokens=len(tokens),
        code_lines=len({token.start[0] for token in tokens}),
        long_lines=sum(len(line) > LONGEST_LINE for line in text.splitlines()),
        assignments=len(assignments),
        packed=sum(_is_packed(node) for node in assignments),
        named_once=sum(_is_private(node.name) and names[node.name] == 2 for node in functions),
        tuples=sum(_is_tuple(note) for node in functions for note in _annotations(node)),
        format_skips=text.count("# fmt: " + "skip") + text.count("# fmt: " + "off"),
        riddles=sum(names[name] for name in RIDDLES),
    )


def weigh(folder: Path) -> dict[str, Weight]:
    """Weigh the rooms of a folder: its subfolders, and ``.`` for its own files."""
    rooms: dict[str, Weight] = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).parts
        room = rooms.setdefault(parts[0] if len(parts) > 1 else ".", Weight())
        room.add(weigh_text(path.read_text(encoding="utf-8")))
    if folder == ROOT / "tests":
        for program in programs():
            rooms["golden"].add(weigh_text(program))
    return rooms


def together(rooms: dict[str, Weight]) -> Weight:
    """Add the rooms of a folder."""
    total = Weight()
    for room in rooms.values():
        total.add(room)
    return total


def _docstring_lines(nodes: list[ast.AST]) -> Iterator[int]:
    """Lines of strings that stand alone: docstrings of functions, classes, modules, attributes."""
    for node in nodes:
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _is_packed(node: ast.Assign) -> bool:
    return isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)


def _annotations(node: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[ast.expr | None]:
    arguments = node.args
    for parameter in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        yield parameter.annotation


def _is_tuple(note: ast.expr | None) -> bool:
    """Whether an annotation is a tuple of fixed length, ``tuple[A, B]`` but not ``tuple[A,
    ...]``."""
    if not isinstance(note, ast.Subscript) or getattr(note.value, "id", "") != "tuple":
        return False
    parts = note.slice.elts if isinstance(note.slice, ast.Tuple) else [note.slice]
    return not any(isinstance(part, ast.Constant) and part.value is ... for part in parts)


def _row(name: str, weight: Weight) -> str:
    cells = (
        f"{weight.tokens}",
        f"{weight.tokens_per_line:.1f}",
        f"{weight.long_lines}",
        f"{100 * weight.packed_share:.1f} %",
        f"{weight.named_once}",
        f"{weight.tuples}",
        f"{weight.format_skips}",
        f"{weight.riddles}",
    )
    return f"{name:28s}" + "".join(f"{cell:>10s}" for cell in cells)


def main(folders: list[str]) -> None:
    """Print a row for every room."""
    columns = ("tokens", "a line", "long", "packed", "once", "tuples", "skips", "riddles")
    print(f"{'room':28s}" + "".join(f"{column:>10s}" for column in columns))
    for name in folders or FOLDERS:
        folder = Path(name).resolve() if folders else ROOT / name
        rooms = weigh(folder)
        for room, weight in rooms.items():
            print(_row(f"{folder.name}/{room}", weight))
        print(_row(f"{folder.name} together", together(rooms)))


if __name__ == "__main__":
    main(sys.argv[1:])
