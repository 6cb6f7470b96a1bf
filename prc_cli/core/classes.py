"""The table of classes: names, meanings, colours, and the LAS codes they are written as.

Inside the program a label is a :class:`Label` index (uint8). It becomes a LAS class code only when
it is written, through :meth:`ClassCodes.lookup`, so that a user can choose the codes in
``[classes]``.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.core.types import I64, U8


class Label(IntEnum):
    """Label of a shot, from the classifiers to the writers."""

    MISSING = 0
    UNCLASSIFIED = 1
    NOISE = 2
    GROUND = 3
    BUILDING = 4
    VEGETATION = 5
    STEM = 6
    CAR = 7
    CURB = 8
    VERTICAL = 9
    HORIZONTAL = 10
    POLE = 11


LABEL_BITS = 15
"""``reason & LABEL_BITS`` is the label of a reason."""


class Reason(IntEnum):
    """Rule that gave a shot its label, ``16 k + label`` with k from 1.

    :mod:`prc_cli.methods.reasons` has a sentence for each.
    """

    MISSING = 0
    BEYOND_REACH = 1 << 4 | Label.UNCLASSIFIED
    UNDECIDED = 2 << 4 | Label.UNCLASSIFIED
    SMALL = 3 << 4 | Label.UNCLASSIFIED
    UNSUPPORTED = 1 << 4 | Label.NOISE
    LONELY = 2 << 4 | Label.NOISE
    ISOLATED = 3 << 4 | Label.NOISE
    SPIKE = 4 << 4 | Label.NOISE
    BELOW_GROUND = 5 << 4 | Label.NOISE
    BEHIND_WALL = 6 << 4 | Label.NOISE
    IN_CAR = 7 << 4 | Label.NOISE
    FAR_BELOW = 10 << 4 | Label.NOISE
    ALONE = 11 << 4 | Label.NOISE
    FLAKE = 12 << 4 | Label.NOISE
    MOST_SMOOTH = 1 << 4 | Label.GROUND
    GROUND_COLUMN = 2 << 4 | Label.GROUND
    GROUND_HEIGHT = 3 << 4 | Label.GROUND
    WALKED = 4 << 4 | Label.GROUND
    LEVEL_LOW = 5 << 4 | Label.GROUND
    LOW = 6 << 4 | Label.GROUND
    SOIL = 7 << 4 | Label.GROUND
    FLAT = 8 << 4 | Label.GROUND
    SURFACE = 9 << 4 | Label.GROUND
    OTHER_SEGMENT = 1 << 4 | Label.BUILDING
    SMOOTH = 2 << 4 | Label.BUILDING
    FACADE = 3 << 4 | Label.BUILDING
    THIN_SMOOTH = 4 << 4 | Label.BUILDING
    NON_SMOOTH = 1 << 4 | Label.VEGETATION
    TO_AND_FRO = 2 << 4 | Label.VEGETATION
    LEAF = 3 << 4 | Label.VEGETATION
    FOLIAGE = 4 << 4 | Label.VEGETATION
    CROWN = 5 << 4 | Label.VEGETATION
    TRUNK = 6 << 4 | Label.VEGETATION
    PLANT = 7 << 4 | Label.VEGETATION
    ABOVE_TOP = 8 << 4 | Label.VEGETATION
    ROUGH_PLACE = 9 << 4 | Label.VEGETATION
    LOW_PLANT = 10 << 4 | Label.VEGETATION
    SMOOTH_COLUMN = 1 << 4 | Label.STEM
    ON_STEM = 2 << 4 | Label.STEM
    BESIDE_STEM = 3 << 4 | Label.STEM
    BETWEEN_DIVIDERS = 1 << 4 | Label.CAR
    LEVEL_BODY = 2 << 4 | Label.CAR
    PROFILE = 3 << 4 | Label.CAR
    CAR_BOX = 4 << 4 | Label.CAR
    LARGE_BOX = 5 << 4 | Label.CAR
    CURB_REGION = 1 << 4 | Label.CURB
    CURB_FACE = 2 << 4 | Label.CURB
    VERTICAL = 1 << 4 | Label.VERTICAL
    HORIZONTAL = 1 << 4 | Label.HORIZONTAL
    POST = 1 << 4 | Label.POLE
    ARM = 2 << 4 | Label.POLE
    BOX = 3 << 4 | Label.POLE
    THIN_PLACE = 4 << 4 | Label.POLE


FURTHER_RETURN = 14 << 4
VOTED = 15 << 4
"""Reasons of any label: ``label | VOTED`` is the label of most shots around, ``label |
FURTHER_RETURN`` the label of a shot around at the same range."""


class Surface(IntEnum):
    """Coarse classification of the sequential-angle method (Stamos et al. 2012, sec. 4)."""

    MISSING = 0
    """M, no return."""
    VEGETATION = 1
    """T, or T' in the layer of the car algorithm (sec. 7.1)."""
    HORIZONTAL = 2
    """H."""
    VERTICAL = 3
    """V."""
    UNDECIDED = 4
    """A return on a line with fewer than two returns, or with all at the same place."""


class TriggerSide(IntEnum):
    """Place of a shot relative to the trigger of its half-line (Stamos et al. 2012, sec. 7.2)."""

    NONE = 0
    """The half-line has no trigger."""
    BEFORE = 1
    AT = 2
    """The trigger, on the shot that sets it off; that shot may be missing."""
    AFTER = 3


class CarTest(IntEnum):
    """Result of the car search for a return between dividers (Stamos et al. 2012, sec. 7.3-8)."""

    OUTSIDE = 0
    """In no interval."""
    VERTICAL = 1
    """Cut out of its interval as a tall vertical run (sec. 7.3)."""
    VEGETATION = 2
    """Its piece of the interval failed the Fourier test (sec. 7.5)."""
    BEHIND_WALL = 3
    """Behind a high vertical (sec. 7.4)."""
    ON_GROUND = 4
    """Horizontal and next to the ground."""
    BEHIND_CURB = 5
    """On or behind a verified curb (sec. 8)."""
    CAR = 6


LABEL_OF_SURFACE: tuple[Label, ...] = tuple(
    {
        Surface.MISSING: Label.MISSING,
        Surface.VEGETATION: Label.VEGETATION,
        Surface.HORIZONTAL: Label.HORIZONTAL,
        Surface.VERTICAL: Label.VERTICAL,
        Surface.UNDECIDED: Label.UNCLASSIFIED,
    }[surface]
    for surface in Surface
)
"""Label of every coarse class, unless a later stage changes it."""

LABEL_NAMES: tuple[str, ...] = tuple(label.name.lower() for label in Label)
"""Lower-case name of every label, by index."""

LABEL_COLOURS: dict[Label, tuple[int, int, int]] = {
    Label.MISSING: (255, 255, 255),
    Label.UNCLASSIFIED: (180, 180, 180),
    Label.NOISE: (38, 38, 38),
    Label.GROUND: (143, 69, 18),
    Label.BUILDING: (245, 80, 30),
    Label.VEGETATION: (42, 157, 104),
    Label.STEM: (232, 196, 24),
    Label.CAR: (42, 76, 194),
    Label.CURB: (252, 229, 34),
    Label.VERTICAL: (247, 70, 19),
    Label.HORIZONTAL: (173, 228, 187),
    Label.POLE: (166, 111, 208),
}
"""Colour of every label in pictures, charts, reports and the viewer [sRGB].

The hues of QGIS and most programs for LAS files (ground brown, vegetation green, buildings red),
shifted in lightness until the classes of a method differ for colour-blind readers too
(``tests/core/test_classes.py``)."""

FIRST_USER_CODE = 64
"""LAS 1.4 table 17: codes from here on are defined by their users."""
MISSING_CODE = 0
"""Code of a shot without return in label files (LAS: created, never classified)."""


NO_CODE = -1
"""Class code of a record without one, such as an empty cell."""
ASPRS_NAMES = {
    1: "unclassified",
    2: "ground",
    3: "low vegetation",
    4: "medium vegetation",
    5: "high vegetation",
    6: "building",
    7: "low noise",
    8: "model key-point",
    9: "water",
    10: "rail",
    11: "road surface",
    12: "overlap",
    17: "bridge deck",
    18: "high noise",
    20: "ignored ground",
}
"""Names of ASPRS LAS 1.4, table 17."""


class ClassCodes(Params):
    """LAS class codes: ASPRS LAS 1.4 table 17, else user codes from 64 (``[classes]``)."""

    unclassified: int = Field(1, ge=0, le=255, description="shots that no rule decided")
    noise: int = Field(7, ge=0, le=255, description="unsupported shots")
    ground: int = Field(2, ge=0, le=255, description="ground")
    building: int = Field(6, ge=0, le=255, description="other smooth surfaces in towns")
    vegetation: int = Field(
        5, ge=0, le=255, description="non-smooth surfaces; other vegetation in forest"
    )
    stem: int = Field(64, ge=0, le=255, description="smooth surfaces in forest")
    car: int = Field(65, ge=0, le=255, description="cars (sequential-angle, fused)")
    curb: int = Field(66, ge=0, le=255, description="curbs (sequential-angle, fused)")
    vertical: int = Field(67, ge=0, le=255, description="vertical surfaces (sequential-angle)")
    horizontal: int = Field(68, ge=0, le=255, description="horizontal surfaces (sequential-angle)")
    pole: int = Field(
        69, ge=0, le=255, description="poles, lamps, signs and other street furniture (fused)"
    )

    def code(self, label: Label) -> int:
        """Return the class code of one label.

        >>> ClassCodes().code(Label.STEM)
        64
        """
        return MISSING_CODE if label is Label.MISSING else int(getattr(self, label.name.lower()))

    def lookup(self) -> U8:
        """Return the table from label to code, (number of labels,) uint8.

        >>> ClassCodes().lookup()[Label.GROUND]
        np.uint8(2)
        """
        return np.array([self.code(label) for label in Label], dtype=np.uint8)

    def user_names(self) -> dict[int, str]:
        """Return the class name of every user code.

        >>> ClassCodes(stem=20).user_names()[65]
        'car'
        """
        return {code: name for code, name in self.names().items() if code >= FIRST_USER_CODE}

    def names(self) -> dict[int, str]:
        """Return the class name of every code; names that share a code are joined by ``/``.

        >>> ClassCodes().names()[64]
        'stem'
        """
        names: dict[int, str] = {}
        for label in Label:
            code = self.code(label)
            names[code] = (
                f"{names[code]}/{label.name.lower()}" if code in names else label.name.lower()
            )
        return names


_FEW = 4096
"""Shorter arrays are counted with bincount: the set-up would cost more."""
_SMALL = 16
"""Values below this are counted by comparison, which vector instructions do 32 at a time."""


def count_bytes(values: U8) -> I64:
    """Return the counts of values, faster than :func:`numpy.bincount` if most are below 16."""
    flat = values.ravel()
    if len(flat) < _FEW:
        return np.bincount(flat, minlength=256)
    counts = np.zeros(256, np.int64)
    top = int(flat.max())
    for value in range(min(top + 1, _SMALL)):
        counts[value] = np.count_nonzero(flat == value)
    if top >= _SMALL:
        counts += np.bincount(flat[flat >= _SMALL], minlength=256)
    return counts


def recode(values: U8, table: U8) -> U8:
    """Look up every value in a table: ``table[values]`` in half the time."""
    if not values.size:
        return np.empty(values.shape, np.uint8)
    return np.frombuffer(bytearray(values.tobytes()).translate(table.tobytes()), np.uint8).reshape(
        values.shape
    )
