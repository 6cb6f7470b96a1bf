"""What a shell offers for values of options; loaded by the completion alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    import click


def complete_mapping(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the presets of class mappings, and TOML files."""
    from prc_cli.evaluation.mapping import preset_names

    return [*(name for name in preset_names() if name.startswith(incomplete)), *_toml_files(incomplete)]


def complete_assignment(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return ``KEY=`` of every key of the configuration; behind the ``=`` the words that it may be."""
    key, equals, value = incomplete.partition("=")
    kinds = dict(_keys())
    if not equals:
        return [f"{name}=" for name in kinds if name.startswith(key)]
    return [f"{key}={word}" for word in _words(kinds.get(key)) if word.startswith(value)]


def _keys() -> list[tuple[str, Any]]:
    """Return every key of the configuration with its type."""
    from prc_cli.config import RunConfig

    return list(_keys_of(RunConfig, ""))


def _keys_of(model: Any, prefix: str) -> Any:
    from prc_cli.core.config import model_in

    for name, field in model.model_fields.items():
        key, kind = f"{prefix}{field.alias or name}", field.annotation
        inner = model_in(kind)
        if inner is None:
            yield key, kind
        else:
            yield from _keys_of(inner, f"{key}.")


def _words(kind: Any) -> list[str]:
    """Return the words of a choice."""
    if kind is bool:
        return ["true", "false"]
    found = [word for word in get_args(kind) if isinstance(word, str)]
    return found or [word for inner in get_args(kind) for word in _words(inner)]


def _toml_files(incomplete: str) -> list[str]:
    """Return folders and TOML files that begin so."""
    folder = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
    try:
        found = [path for path in sorted(folder.iterdir()) if path.suffix == ".toml" or path.is_dir()]
    except OSError:
        return []
    shown = [f"{path}/" if path.is_dir() else str(path) for path in found if not path.name.startswith(".")]
    return [name for name in shown if name.startswith(incomplete)]
