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


class Reason(IntEnum):
    """Rule that gave a shot its label.

    :data:`REASONS_OF_LABELS` has the label of each, :mod:`prc_cli.methods.reasons` a sentence. A
    new reason gets the next number: those in files keep their meaning.
    """

    MISSING = 0
    BEYOND_REACH = 1
    UNDECIDED = 2
    SMALL = 3
    UNSUPPORTED = 4
    LONELY = 5
    ISOLATED = 6
    SPIKE = 7
    BELOW_GROUND = 8
    BEHIND_WALL = 9
    IN_CAR = 10
    FAR_BELOW = 11
    ALONE = 12
    FLAKE = 13
    MOST_SMOOTH = 14
    GROUND_COLUMN = 15
    GROUND_HEIGHT = 16
    WALKED = 17
    LEVEL_LOW = 18
    LOW = 19
    SOIL = 20
    FLAT = 21
    SURFACE = 22
    OTHER_SEGMENT = 23
    SMOOTH = 24
    FACADE = 25
    THIN_SMOOTH = 26
    NON_SMOOTH = 27
    TO_AND_FRO = 28
    LEAF = 29
    FOLIAGE = 30
    CROWN = 31
    TRUNK = 32
    PLANT = 33
    ABOVE_TOP = 34
    ROUGH_PLACE = 35
    LOW_PLANT = 36
    SMOOTH_COLUMN = 37
    ON_STEM = 38
    BESIDE_STEM = 39
    BETWEEN_DIVIDERS = 40
    LEVEL_BODY = 41
    PROFILE = 42
    CAR_BOX = 43
    LARGE_BOX = 44
    CURB_REGION = 45
    CURB_FACE = 46
    VERTICAL = 47
    HORIZONTAL = 48
    POST = 49
    ARM = 50
    BOX = 51
    THIN_PLACE = 52


REASONS_OF_LABELS: dict[Label, tuple[Reason, ...]] = {
    Label.MISSING: (Reason.MISSING,),
    Label.UNCLASSIFIED: (
        Reason.BEYOND_REACH,
        Reason.UNDECIDED,
        Reason.SMALL,
    ),
    Label.NOISE: (
        Reason.UNSUPPORTED,
        Reason.LONELY,
        Reason.ISOLATED,
        Reason.SPIKE,
        Reason.BELOW_GROUND,
        Reason.BEHIND_WALL,
        Reason.IN_CAR,
        Reason.FAR_BELOW,
        Reason.ALONE,
        Reason.FLAKE,
    ),
    Label.GROUND: (
        Reason.MOST_SMOOTH,
        Reason.GROUND_COLUMN,
        Reason.GROUND_HEIGHT,
        Reason.WALKED,
        Reason.LEVEL_LOW,
        Reason.LOW,
        Reason.SOIL,
        Reason.FLAT,
        Reason.SURFACE,
    ),
    Label.BUILDING: (
        Reason.OTHER_SEGMENT,
        Reason.SMOOTH,
        Reason.FACADE,
        Reason.THIN_SMOOTH,
    ),
    Label.VEGETATION: (
        Reason.NON_SMOOTH,
        Reason.TO_AND_FRO,
        Reason.LEAF,
        Reason.FOLIAGE,
        Reason.CROWN,
        Reason.TRUNK,
        Reason.PLANT,
        Reason.ABOVE_TOP,
        Reason.ROUGH_PLACE,
        Reason.LOW_PLANT,
    ),
    Label.STEM: (
        Reason.SMOOTH_COLUMN,
        Reason.ON_STEM,
        Reason.BESIDE_STEM,
    ),
    Label.CAR: (
        Reason.BETWEEN_DIVIDERS,
        Reason.LEVEL_BODY,
        Reason.PROFILE,
        Reason.CAR_BOX,
        Reason.LARGE_BOX,
    ),
    Label.CURB: (
        Reason.CURB_REGION,
        Reason.CURB_FACE,
    ),
    Label.VERTICAL: (Reason.VERTICAL,),
    Label.HORIZONTAL: (Reason.HORIZONTAL,),
    Label.POLE: (
        Reason.POST,
        Reason.ARM,
        Reason.BOX,
        Reason.THIN_PLACE,
    ),
}
"""Every reason, by the label that it gives."""
FURTHER_RETURN = 224
VOTED = 240
"""Reasons of any label: ``VOTED + label`` is the label of most shots around, ``FURTHER_RETURN +
label`` the label of a shot around at the same range."""


def _labels_by_reason() -> U8:
    labels = np.full(256, Label.UNCLASSIFIED, np.uint8)
    for label in Label:
        labels[[VOTED + label, FURTHER_RETURN + label, *REASONS_OF_LABELS.get(label, ())]] = label
    return labels


LABELS_BY_REASON: U8 = _labels_by_reason()
"""Label of every reason by its number, (256,) uint8; loops read it."""


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
