"""Print every dependency of pyproject.toml at its lower bound, as pip constraints."""

import tomllib
from pathlib import Path

project = tomllib.loads(
    (Path(__file__).resolve().parent.parent / "pyproject.toml").read_text(encoding="utf-8")
)["project"]
# linters and type checkers are not needed at their oldest: only what runs with the program or its
# tests
skipped = ("mypy", "ruff")
for requirement in [*project["dependencies"], *project["optional-dependencies"]["test"]]:
    if not requirement.startswith(skipped):
        print(requirement.replace(">=", "=="))
