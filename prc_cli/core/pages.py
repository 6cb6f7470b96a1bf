"""HTML pages from templates; text is escaped unless a template marks it safe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


def render_page(
    package: str,
    name: str,
    values: Mapping[str, object],
    filters: Mapping[str, Callable[..., Any]] | None = None,
    tests: Mapping[str, Callable[..., bool]] | None = None,
) -> str:
    """Return a page."""
    # imported here, so that only commands that write a page load it
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package, "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_printable,
    )
    environment.filters.update(filters or {})
    environment.tests.update(tests or {})
    return environment.get_template(name).render(values)


def _printable(value: object) -> object:
    # text marked safe is a subclass of str, and stays as it is
    if type(value) is str and not value.isprintable():
        return "".join(character if character.isprintable() else " " for character in value)
    return value
