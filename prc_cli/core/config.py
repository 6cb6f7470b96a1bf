"""Base of the configuration: strict parameter models, TOML tables, errors that name the key.

The stages declare their keys; :mod:`prc_cli.config` combines their models. Presets and class
mappings are sample configurations, in the folder of :func:`samples_folder`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from prc_cli.core.brief import LONGEST
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import read_small
from prc_cli.core.near import nearest


class Params(BaseModel):
    """Base of every parameter table.

    Immutable, unknown keys and values out of bounds are errors.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )

    @classmethod
    def constants(cls, location: list[str], value: Any) -> dict[str, Any]:
        """Return keys that are constants now, dotted, with their values, for the error message."""
        return {}

    def __repr__(self) -> str:
        """Return the values that are not the defaults, in a line."""
        changed = ", ".join(
            f"{key}={value!r}" for key, value in flatten(self.model_dump(exclude_defaults=True))
        )
        shown = changed if len(changed) <= LONGEST else f"{changed[:LONGEST]}..."
        return f"{type(self).__name__}({shown})"


_EXPECTED = {"model_type": "a table", "missing": "a value, this key is required"}
"""Error types of the validation library, reworded for configuration files."""

OPTION = "option"
"""Source of the values that options of the command line give, for messages."""
ParamsT = TypeVar("ParamsT", bound=Params)

MAX_TOML_BYTES = 1 << 20
"""Largest configuration file; with every key set it takes a few kilobytes."""
MAX_DEPTH = 64
"""Most parts of a dotted key; the parser's time and memory grow with the square of it."""
_DEEP_KEY = re.compile(
    r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){%d}""" % MAX_DEPTH,  # noqa: UP031
)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        raw = read_small(path, MAX_TOML_BYTES)
        text = raw.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")  # any line end
    except OSError as error:
        raise ConfigError(
            str(path), f"cannot be read ({error.strerror})", "check the name of the file"
        ) from error
    except UnicodeDecodeError as error:
        problem = f"byte {error.start} is not UTF-8, expected a TOML text file"
        raise ConfigError(str(path), problem) from error
    return parse_toml(text, str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Parse TOML from an untrusted source."""
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise ConfigError(
            where, f"line {line}: a key of more than {MAX_DEPTH} parts, expected a few"
        )
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ConfigError(where, "not valid TOML: values inside one another too deep") from None
    except ValueError as error:  # TOMLDecodeError, and what int() refuses
        raise ConfigError(where, f"not valid TOML: {error}") from error


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two nested tables; the second wins, tables are merged recursively.

    >>> merge({"a": {"x": 1, "y": 2}}, {"a": {"y": 3}})
    {'a': {'x': 1, 'y': 3}}
    """
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        both_tables = isinstance(below, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(below, value) if both_tables else value  # type: ignore[arg-type]
    return merged


def flatten(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield a nested table as (dotted key, value).

    >>> dict(flatten({"prc": {"support": {"zeta_s": 1.0}}}))
    {'prc.support.zeta_s': 1.0}
    """
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def build(model: type[ParamsT], table: Mapping[str, Any], where: str) -> ParamsT:
    """Validate a nested table against a parameter model."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise _translate(error, model, where) from None


def _translate(error: ValidationError, model: type[Params], where: str) -> ConfigError:
    issues = error.errors(include_url=False)
    unknown = [issue for issue in issues if issue["type"] == "extra_forbidden"]
    issue = (unknown or issues)[0]
    location = [str(part) for part in issue["loc"]]
    key = ".".join(location)
    place = f"--set {key}" if where == OPTION else where
    if issue["type"] == "extra_forbidden":
        if constants := model.constants(location, issue["input"]):
            values = ", ".join(
                f"{name} = {str(value).lower()}" for name, value in constants.items()
            )
            hint = (
                f"leave it out; it is {values}"
                if len(constants) == 1
                else f"leave them out: {values}"
            )
            return ConfigError(place, f"{key} is a constant now", hint)
        problem = "unknown key" if where == OPTION else f"unknown key {key!r}"
        return ConfigError(place, problem, _nearest_hint(model, location))
    expected = (
        _EXPECTED.get(issue["type"], issue["msg"])
        .removeprefix("Value error, ")
        .removeprefix("Input should be ")
    )
    # the input of a check over several keys is a whole table: its own message says what was found
    says_value = (
        issue["type"] == "missing"
        or isinstance(issue["input"], Mapping | BaseModel)
        or "found " in expected
    )
    value = "" if says_value else f"found {issue['input']!r}, "
    more = f" (and {len(issues) - 1} more)" if len(issues) > 1 else ""
    hint = "prc config schema prints every key with its limits"
    what = "" if where == OPTION and key else f"{key or 'configuration'}: "
    return ConfigError(place.rstrip(), f"{what}{value}expected: {expected}{more}", hint)


def _nearest_hint(model: type[BaseModel], location: list[str]) -> str:
    known = sorted(_keys_at(model, location[:-1]))
    # the key may belong to another table
    keys = list(_dotted_keys(model))
    elsewhere = [key for key in keys if key.endswith("." + ".".join(location))]
    elsewhere = elsewhere or [key for key in keys if key.rpartition(".")[2] == location[-1]]
    near = nearest(location[-1], known, cutoff=0.5)
    if near is not None and not elsewhere:
        # dotted, as it is typed
        return f"did you mean {'.'.join([*location[:-1], near])!r}?"
    if elsewhere:
        return f"did you mean {' or '.join(repr(key) for key in elsewhere[:3])}?"
    if len(location) == 1 and (
        far := nearest(location[0], [key.rpartition(".")[2] for key in keys])
    ):
        return f"did you mean {next(key for key in keys if key.endswith(f'.{far}'))!r}?"
    return f"known keys here: {', '.join(known)}"


def _dotted_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        yield key
        if (inner := model_in(field.annotation)) is not None:
            yield from _dotted_keys(inner, f"{key}.")


def _keys_at(model: type[BaseModel], location: list[str]) -> set[str]:
    current: type[BaseModel] | None = model
    for part in location:
        if current is None:
            break
        fields = {(field.alias or name): field for name, field in current.model_fields.items()}
        current = model_in(fields[part].annotation) if part in fields else current
    if current is None:
        return set()
    return {field.alias or name for name, field in current.model_fields.items()}


def model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the first parameter model in an annotation such as ``Layout | None``, or None."""
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
        for inner in get_args(candidate):
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                return inner
    return None


_PACKAGE = Path(__file__).resolve().parent.parent


def samples_folder(package: Path = _PACKAGE) -> Path:
    """Return the folder of the sample configurations, in an installed package or a checkout."""
    installed = package / "sample_configs"
    return installed if installed.is_dir() else package.parent / "sample_configs"


def or_sample(path: Path) -> Path:
    """Return a file; if it does not exist, the sample configuration of this name.

    >>> or_sample(Path("kitti_frame.toml")).is_file(), or_sample(Path("no_sample.toml")).is_file()
    (True, False)
    """
    if path.exists() or path.is_absolute() or ".." in path.parts:
        return path
    name = path.relative_to("sample_configs") if path.parts[:1] == ("sample_configs",) else path
    sample = samples_folder() / name
    return sample if sample.is_file() else path
