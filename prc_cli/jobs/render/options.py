"""Options and result of ``prc render``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prc_cli.core.brief import Brief
from prc_cli.core.errors import ConfigError

SUFFIX = ".png"
WIDEST = 2200
"""Widest picture without frame [pixels]."""

PRC_STEPS = (
    "support",
    "critical",
    "background",
    "components",
    "segments",
    "surfaces",
    "segmentation",
)
FIGURE_1 = ("range", *(step for step in PRC_STEPS if step != "critical"), "classes")
"""The paper's Fig. 1 (Lehtola et al. 2019), for one block; default: the second, or the only one."""

TITLES = {
    "range": "range",
    "intensity": "intensity",
    "support": "supported S (white)",
    "background": "extended background G (white)",
    "critical": "critical zeta (black: never)",
    "components": "components before filling",
    "segments": "smooth segments H",
    "surfaces": "non-smooth surfaces V",
    "segmentation": "segmentation R",
    "classes": "classes",
    "confidence": "confidence",
    "reference": "reference",
    "difference": "differences, in the colour of the predicted class",
}
"""Title of every step."""

ON_REQUEST = ("intensity", "confidence", "critical")
"""Steps that are drawn only where they are named."""
REFERENCE_STEPS = ("reference", "difference")


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Contents and size of a picture."""

    steps: tuple[str, ...] | None = None
    """Pictures from top to bottom; None = chosen by the part drawn.

    ``figure1`` is the sequence of the paper's Fig. 1, ``top`` the points from above; both stand by
    themselves.
    """
    lines: tuple[int, int] | None = None
    """First line, and last line + 1, from 0."""
    station: int | None = None
    """Scanner, or scan of the file; None = the first one."""
    labels: Path | None = None
    """Class codes of an existing result, instead of classifying."""
    labels_dimension: str | None = None
    reference: Path | None = None
    """Class codes to compare with."""
    mapping: str | Path | None = None
    """Classes of the codes on either side; None = the codes of ``[classes]`` on both."""
    shots: int = 1_500_000
    """Most shots of a viewer page; of longer scans every n-th line and column is kept."""
    trajectory: Path | None = None
    """Poses that place the shots of a viewer page.

    None = coordinates of the input, else lines one behind the other.
    """
    mount: tuple[float, ...] = ()
    """Scanner on the vehicle: roll, pitch, yaw [deg]; x, y, z from the trajectory's point [m]."""

    def __post_init__(self) -> None:
        alone = {"figure1", "top"}.intersection(self.steps or ())
        if alone and len(self.steps or ()) > 1:
            problem = f"found {','.join(self.steps or ())!r}, expected {alone.pop()} by itself"
            raise ConfigError("--steps", problem, "draw two pictures")

    @property
    def is_figure1(self) -> bool:
        """Whether the paper's Fig. 1 is drawn."""
        return self.steps == ("figure1",)

    @property
    def is_from_above(self) -> bool:
        """Whether the points from above are drawn, not lines and columns."""
        return self.steps == ("top",)


@dataclass(frozen=True, slots=True, repr=False)
class RenderResult(Brief):
    """Summary of a picture."""

    files: tuple[Path, ...]
    size: tuple[int, int]
    """Width and height of the picture [pixels]."""
    drawn: str
    """Headline of the picture."""
    steps: tuple[str, ...] = ()
    lines: tuple[int, int] | None = None
    thinned_by: tuple[int, int] = (1, 1)
    """Every n-th line and column is drawn."""
    counts: dict[str, int] | None = None
    """Shots by class, over all lines read for the picture, before thinning."""
    n_compared: int = 0
    """Shots with a class on both sides."""
    n_differing: int = 0
    """Shots whose classes differ."""
    n_points: int = 0
    """Points of a cloud inside the picture."""
    notes: tuple[str, ...] = ()
    """Remarks for the reader of the picture."""


def choose_steps(method: str, options: RenderOptions) -> tuple[str, ...]:
    """Return the steps to draw; default: all for a part, only the result for a whole drive.

    >>> choose_steps("prc", RenderOptions())
    ('range', 'classes')
    """
    steps_of_method = {
        "sequential-angle": ("classes",),
        "fused": ("classes", "confidence"),
        "rings": ("classes",),
    }
    # label files hold no intermediate images
    steps = (
        ("classes",)
        if options.labels is not None
        else steps_of_method.get(method, (*PRC_STEPS, "classes"))
    )
    of_reference = () if options.reference is None else REFERENCE_STEPS
    possible = ("range", "intensity", *steps, *of_reference)
    chosen = FIGURE_1 if options.is_figure1 else options.steps
    if chosen is None:
        is_whole_drive = options.lines is None
        chosen = tuple(step for step in possible if step not in ON_REQUEST)
        if is_whole_drive:
            chosen = ("range", "classes", *of_reference)
    elif options.is_figure1 and of_reference:
        chosen = (*chosen, "reference")
    hint = f"possible here: {', '.join(possible)}"
    for step in (wrong for wrong in chosen if wrong not in possible):
        why = f"which is no step of {method}"
        if step not in TITLES:
            why = "which is no step"
        elif options.labels is not None:
            why = "which a label file does not hold"
        problem = f"found {step!r}, {why}"
        if step in REFERENCE_STEPS:
            problem = f"{step!r} needs a reference, expected --reference FILE"
        raise ConfigError("--steps", problem, hint)
    if not chosen:
        raise ConfigError("--steps", "found none, expected at least one", hint)
    return tuple(dict.fromkeys(chosen))
