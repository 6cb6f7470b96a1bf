"""List the benchmarks: ``python -m benchmarks``."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from benchmarks.pages import FIGURES, TOOK, WRITTEN_BY

FOLDER = Path(__file__).resolve().parent


def minutes_by_module() -> dict[str, str]:
    """Return how long the benchmarks took that wrote the pages in ``figures``."""
    minutes = {}
    for path in FIGURES.glob("*.md"):
        written = rf"{re.escape(WRITTEN_BY)}(\w+).*{re.escape(TOOK)}(\d+) min"
        minutes.update(re.findall(written, path.read_text(encoding="utf-8"), re.DOTALL))
    return minutes


def main() -> None:
    """Print a line for every module that is a program."""
    minutes = minutes_by_module()
    print(f"{'python -m benchmarks.':24} {'minutes':>7}  what")
    for path in sorted(FOLDER.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if path.stem == "__main__" or '__name__ == "__main__"' not in text:
            continue
        summary = (ast.get_docstring(ast.parse(text)) or "").partition("\n\n")[0]
        print(f"{path.stem:24} {minutes.get(path.stem, '?'):>7}  {' '.join(summary.split())}")


if __name__ == "__main__":
    main()
