"""Rules of ``prc thin``: which share of which class is kept."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import ConfigError
from prc_cli.formats.writing.columns import HIGH_NOISE_CODE

MAX_DENOMINATOR = 1_000_000
"""Largest denominator of a fraction."""
MAX_SPACING_M = 10_000.0


@dataclass(frozen=True, slots=True)
class ThinRule:
    """How much of a class is kept."""

    name: str
    codes: tuple[int, ...]
    """Class codes of the rule."""
    share: Fraction | None = None
    """Share of shots to keep, in a pattern of line and column; 0 = none, 1 = all."""
    spacing_m: float | None = None
    """Least distance between shots of the class in a line [m]."""

    def __str__(self) -> str:
        return f"{self.name}={self.share if self.spacing_m is None else f'{self.spacing_m:g} m'}"


def parse_rules(
    keep: Iterable[str] = (), spacing: Iterable[str] = (), drop: Iterable[str] = (), codes: ClassCodes | None = None
) -> tuple[ThinRule, ...]:
    """Parse options into rules; noise is dropped unless a rule names it.

    >>> [str(rule) for rule in parse_rules(["ground=1/4"], ["building=0.1"], ["car,noise"])]
    ['ground=1/4', 'building=0.1 m', 'car=0', 'noise=0']
    """
    table = codes or ClassCodes()
    keep, spacing, drop = (
        [part.strip() for text in texts for part in text.split(",") if part.strip()] for texts in (keep, spacing, drop)
    )
    rules: list[ThinRule] = []
    for text in keep:
        name, value = _split(text, "--keep", "FRACTION", "ground=1/4")
        rules.append(ThinRule(name, _codes(name, "--keep", table), share=_share(text, value)))
    for text in spacing:
        name, value = _split(text, "--spacing", "METRES", "ground=0.1")
        rules.append(ThinRule(name, _codes(name, "--spacing", table), spacing_m=_metres(text, value)))
    rules.extend(ThinRule(name, _codes(name, "--drop", table), share=Fraction(0)) for name in drop)
    named = {code for rule in rules for code in rule.codes}
    left = tuple(code for code in _codes("noise", "noise", table) if code not in named)
    if left and table.noise not in named:
        rules.append(ThinRule("noise", left, share=Fraction(0)))
    seen: dict[int, str] = {}
    for rule in rules:
        for code in rule.codes:
            if code in seen:
                problem = f"class code {code} is named twice, as {seen[code]} and {rule}"
                raise ConfigError("classes to thin", problem, "give one rule a class")
            seen[code] = str(rule)
    return tuple(rules)


def _split(text: str, option: str, what: str, example: str) -> tuple[str, str]:
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise ConfigError(option, f"found {text!r}, expected CLASS={what}", f"for example {option} {example}")
    return name, value


def _share(text: str, value: str) -> Fraction:
    try:
        share = Fraction(value)
    except (ValueError, ZeroDivisionError):
        share = Fraction(-1)
    if not 0 <= share <= 1 or share.denominator > MAX_DENOMINATOR:
        problem = f"found {text!r}, expected a fraction from 0 to 1 with a denominator up to {MAX_DENOMINATOR}"
        raise ConfigError("--keep", problem, "for example --keep ground=1/4")
    return share


def _metres(text: str, value: str) -> float:
    try:
        metres = float(value)
    except ValueError:
        metres = math.nan
    if not 0 < metres <= MAX_SPACING_M:
        problem = f"found {text!r}, expected a distance above 0, up to {MAX_SPACING_M:g} m"
        raise ConfigError("--spacing", problem, "for example --spacing ground=0.1")
    return metres


def _codes(name: str, option: str, table: ClassCodes) -> tuple[int, ...]:
    """Return the codes of a class name or number."""
    names = {label.name.lower(): table.code(label) for label in Label if label is not Label.MISSING}
    if name.lower() == "noise":
        return tuple(dict.fromkeys((table.noise, HIGH_NOISE_CODE)))
    if name.lower() in names:
        return (names[name.lower()],)
    if name.isdecimal() and int(name) < 2**31:
        return (int(name),)
    near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.4)
    hint = f"did you mean {near[0]!r}?" if near else f"known classes: {', '.join(names)}, or a class code"
    raise ConfigError(option, f"unknown class {name!r}", hint)
