"""Makes tables of the configuration from thresholds, so that every key is written once."""

from __future__ import annotations

import ast
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from pydantic import Field, create_model
from pydantic.fields import FieldInfo

from prc_cli.core.config import Params

TupleT = TypeVar("TupleT", bound=tuple[Any, ...])


def key(
    least: float | None = None,
    most: float | None = None,
    *,
    above: float | None = None,
    below: float | None = None,
) -> Any:
    """Mark a field of a ``NamedTuple`` as a key of the configuration, with bounds.

    Its docstring describes it.
    """
    return Field(ge=least, le=most, gt=above, lt=below)


def table_of(defaults: tuple[Any, ...], name: str, base: type[Params] = Params) -> type[Any]:
    """Make the parameter table of a ``NamedTuple`` of thresholds.

    Fields with :func:`key` become keys, thresholds within thresholds become tables, other fields
    are constants. Descriptions are the docstrings of the fields.
    """
    kind = type(defaults)
    fields = dict[str, Any]()
    texts = _docs_of(kind.__module__)
    for field, annotation in get_type_hints(kind, include_extras=True).items():
        value = getattr(defaults, field)
        if hasattr(value, "_fields"):
            inner = table_of(value, field)
            fields[field] = (inner, inner())
        elif any(isinstance(mark, FieldInfo) for mark in getattr(annotation, "__metadata__", ())):
            fields[field] = (annotation, Field(value, description=texts[kind.__name__, field]))
    title = "".join(word.title() for word in name.split("_")) + "Params"
    table = create_model(
        title, __base__=base, __doc__=kind.__doc__, __module__=kind.__module__, **fields
    )
    vars(sys.modules[kind.__module__]).setdefault(title, table)  # where pickle looks for it
    return table


@cache
def _docs_of(module: str) -> dict[tuple[str, str], str]:
    """Docstrings of the fields of all classes of a module, by class and field, as descriptions."""
    source = Path(str(sys.modules[module].__file__)).read_text("utf-8")
    texts = {}
    classes = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    for kind in classes:
        for field, text in pairwise(kind.body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                words = " ".join(ast.literal_eval(text.value).split()).removesuffix(".")
                if words[1:2].islower() or words[1:2] == " ":
                    words = words[:1].lower() + words[1:]
                texts[kind.name, ast.unparse(field.target)] = words
    return texts


def thresholds_of(defaults: TupleT, table: Params) -> TupleT:
    """Return thresholds with the values of their parameter table."""
    values: dict[str, Any] = {}
    for name in type(table).model_fields:
        value = getattr(table, name)
        values[name] = (
            thresholds_of(getattr(defaults, name), value) if isinstance(value, Params) else value
        )
    return defaults._replace(**values)  # type: ignore[attr-defined, no-any-return]  # a NamedTuple
