"""The ``[output]`` table: values written beside the class codes, and the handling of codes above 31."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import Field

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.config import Params
from prc_cli.core.errors import ConfigError
from prc_cli.core.facts import ClassContexts
from prc_cli.formats.writing.coordinates import Placement

HIGH_NOISE_CODE = 18
"""LAS 1.4 table 17: high noise."""

FIVE_BIT_LIMIT = 32
"""Point formats 0-5 keep the class in five bits: codes 0 to 31."""


class OutputConfig(Params):
    """What outputs hold (``[output]``)."""

    segment_ids: bool = Field(
        False,
        description="add the segment id R_b of every shot: extra bytes uint32 `segment_id`, or a column `segment`",
    )
    range: bool = Field(False, description="add the range of every shot [m]: extra bytes float32 `range` (LAS, LAZ)")
    stages: bool = Field(
        False,
        description="add what the classifier found on the way, as extra bytes or columns: float32 "
        "`height_above_ground` [m; NaN unknown] (fused, sequential-angle); of sequential-angle also uint8 `surface` "
        "(coarse class: 1 vegetation, 2 horizontal, 3 vertical, 4 undecided), uint8 `dense_vegetation` (T'), "
        "float32 `ground_height` [m, relative to the scanner; NaN unknown], uint8 `trigger` (of a suspicious "
        "half-line: 1 before the trigger, 2 the trigger, 3 after it), uint16 `car_interval` (number of the interval "
        "between dividers; 0 none) and uint8 `car_test` (what became of a return in an interval: 1 cut out as a tall "
        "vertical run, 2 vegetation by the Fourier test, 3 behind a high vertical, 4 next to the ground, 5 on or "
        "behind a curb, 6 car); of prc float32 `critical_zeta_p` and `critical_zeta_s` (a shot is supported if they "
        "are below zeta_p and zeta_s [m]; infinite = never)",
    )
    confidence: bool = Field(
        False,
        description="add how sure every label is: extra bytes uint8 `confidence`, or a column, 0 to 100 = per cent of "
        "such shots whose label is right on simulated scans; 0 = not known (fused)",
    )
    codes: Literal["upgrade", "below-32"] = Field(
        "upgrade",
        description="codes above 31 in LAS point formats 0-5: upgrade = write the matching format 6-10 when such a "
        "code occurs; below-32 = refuse to start unless every code in [classes] is below 32",
    )
    high_noise_beyond: float | None = Field(
        None, gt=0.0, description="noise farther than this gets code 18 (high noise) [m]; default: never"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelOutput:
    """A classified file that is to be written."""

    path: Path
    """Its suffix decides the format."""
    source: Path
    """Input; LAS, PLY and PCD outputs of an input of the same kind read it again."""
    n_records: int | None
    """Records of the input; None if unknown before reading."""
    points_per_line: int
    """M, shots in a scan line."""
    codes: ClassCodes
    options: OutputConfig = field(default_factory=OutputConfig)
    laz_contexts: ClassContexts | None = None
    """Kept from reading a LAZ input, to rewrite it faster; the output is the same without."""
    user_names: Mapping[int, str] = field(default_factory=dict)
    """Name of every user code that may be written; LAS and LAZ hold them."""
    is_part: bool = False
    """Only a window of the input is classified: the output holds its records alone."""
    place: Placement | None = None
    """Where returns lie in a new point cloud; None = relative to the scanner."""


def check_codes(codes: ClassCodes, options: OutputConfig) -> None:
    """Refuse a class table with codes that the output may not hold.

    >>> check_codes(ClassCodes(), OutputConfig())
    >>> check_codes(ClassCodes(), OutputConfig(codes="below-32"))
    Traceback (most recent call last):
    ...
    prc_cli.core.errors.ConfigError: classes.stem: found code 64, expected a code below 32 because [output] codes = \
"below-32"; set stem to a code from 19 to 31 in [classes], or codes = "upgrade"
    """
    if options.codes != "below-32":
        return
    for label in Label:
        code = codes.code(label)
        if code >= FIVE_BIT_LIMIT:
            name = label.name.lower()
            problem = f'found code {code}, expected a code below {FIVE_BIT_LIMIT} because [output] codes = "below-32"'
            hint = f'set {name} to a code from 19 to 31 in [classes], or codes = "upgrade"'
            raise ConfigError(f"classes.{name}", problem, hint)


def class_names(codes: ClassCodes, options: OutputConfig) -> dict[int, str]:
    """Return the class name of every code that an output may hold, high noise included.

    >>> class_names(ClassCodes(), OutputConfig(high_noise_beyond=80))[18]
    'high_noise'
    """
    names = codes.names()
    if options.high_noise_beyond is not None:
        shared = names.get(HIGH_NOISE_CODE)
        names[HIGH_NOISE_CODE] = f"{shared}/high_noise" if shared else "high_noise"
    return names
