"""Smooth and non-smooth surfaces: large segments are smooth, small ones are joined.

Lehtola et al. (2019), II-E.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import I32, I64, Mask
from prc_cli.methods.prc.components import Components
from prc_cli.methods.prc.components_loops import label_components
from prc_cli.methods.prc.surfaces_loops import dilate, select_components

PUBLISHED_AREA = 30
"""A, pixels, for blocks of ..."""
PUBLISHED_BLOCK = 99 * 2154
"""... k x M pixels; the ratio should be kept (II-E)."""


def _area(value: Any) -> Any:
    """Give one message for a wrong area instead of one per allowed type."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if value != "auto" and not (is_number and 0 < value < float("inf")):
        msg = f'a positive number of pixels or "auto", found {value!r}'
        raise ValueError(msg)
    return value


class SurfacesParams(Params):
    """Size limit of smooth segments, and dilation of the others (``[prc.surfaces]``)."""

    area: Annotated[Annotated[float, Field(gt=0)] | Literal["auto"], BeforeValidator(_area)] = (
        Field(
            30.0,
            description=(
                "segments of this many pixels in a full block are smooth [pixels, real number]; "
                '"auto" keeps the published share of the block, 30 / (99 * 2154) * k * M'
            ),
        )
    )
    gamma: int = Field(
        2,
        ge=0,
        le=10_000,
        description="dilations of the non-smooth image; keep far below the square root of the area",
    )


MOST_GAMMA = 0.5
"""Gamma, as a share of the square root of the area, from which on a notice is given.

The published values are .37 of it."""


def unusual_dilation(params: SurfacesParams) -> str | None:
    """Return a notice if the paper advises against this dilation (II-E: gamma far below sqrt A).

    >>> unusual_dilation(SurfacesParams()), unusual_dilation(SurfacesParams(area="auto", gamma=9))
    (None, None)
    >>> unusual_dilation(SurfacesParams(gamma=20))
    'prc.surfaces.gamma = 20 is not far below the square root of prc.surfaces.area = 30: surfaces
    of that size vanish under their neighbours, and buildings become vegetation'
    """
    if params.area == "auto" or params.gamma < MOST_GAMMA * math.sqrt(params.area):
        return None
    return (
        f"prc.surfaces.gamma = {params.gamma} is not far below the square root of "
        f"prc.surfaces.area = {params.area:g}: surfaces of that size vanish under their "
        "neighbours, and buildings become vegetation"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Smooth and non-smooth shots of a block, and their segmentation R."""

    supported: Mask
    """(lines, M) bool, S."""
    components: Components
    """H."""
    covered: Mask
    """(lines, M) bool, the dilated non-smooth image; also covers noise and missing shots."""
    patches: I32 | None
    """(lines, M) int32, components of ``covered``, 0 = none; None unless segments are requested."""
    n_patches: int
    """Number of patches, numbered after the components of H; 0 unless segments are requested."""

    @property
    def smooth(self) -> Mask:
        """(lines, M) bool, supported shots of H outside V."""
        smooth: Mask = self.supported & ~self.covered
        return smooth

    @property
    def next_id(self) -> int:
        """First segment id that is still free."""
        return self.components.next_id + self.n_patches

    def to_patches(self) -> I64:
        """Return V, the dilated image with the noise under it, as segment ids (lines, M) int64.

        0 = none.
        """
        if self.patches is None:
            msg = "surfaces were found without patches"
            raise ValueError(msg)
        patches: I64 = np.where(
            self.covered, self.patches + np.int64(self.components.next_id - 1), 0
        )
        return patches

    def to_segments(self) -> I64:
        """Return R: the segment id of every supported shot, 0 elsewhere, (lines, M) int64.

        Needs patches.
        """
        segments: I64 = np.where(self.covered, self.to_patches(), self.components.to_segments())
        segments[~self.supported] = 0
        return segments


def area_threshold(
    params: SurfacesParams,
    n_lines: int,
    lines_per_block: int,
    points_per_line: int,
) -> float:
    """Return the least number of pixels of a smooth segment in a block of ``n_lines`` lines.

    A shorter block at the end of the stream needs proportionally fewer. The division comes last, so
    that whole results are exact.

    >>> area_threshold(SurfacesParams(), 33, 99, 2154)
    10.0
    >>> area_threshold(SurfacesParams(area="auto"), 99, 99, 2154)
    30.0
    >>> round(area_threshold(SurfacesParams(area="auto"), 255, 255, 4270), 1)
    153.2
    """
    if params.area == "auto":
        return PUBLISHED_AREA * n_lines * points_per_line / PUBLISHED_BLOCK
    return params.area * n_lines / lines_per_block


@stage("surfaces")
def find_small(components: Components, threshold: float) -> Mask:
    """Return which components are non-smooth, (n + 1,) bool.

    The size of a segment is that of all its components together. Entry 0 is for supported shots
    without component (background that hole filling did not assign): they are non-smooth as well.
    """
    small: Mask = components.sum_by_id(components.pixels) < threshold
    small[0] = True
    return small


@stage("surfaces")
def surfaces(
    supported: Mask,
    components: Components,
    small: Mask,
    params: SurfacesParams,
    *,
    with_patches: bool = False,
) -> Surfaces:
    """Split a block into smooth and non-smooth surfaces.

    Small segments and background shots without component form the non-smooth image, which is
    dilated and connected. Smooth shots under it become non-smooth, noise stays noise.

    ``supported`` (lines, M) bool; ``small`` (n + 1,) bool.

    A segment of 8 pixels stays smooth, except where the dilated single pixel on its right covers
    it:

    >>> image = np.array([[1, 1, 1, 1, 0, 2], [1, 1, 1, 1, 0, 0]], dtype=np.int32)
    >>> h = Components(
    ...     image, np.array([0, 8, 1]), ids=np.array([0, 1, 2]), first_new_id=1, next_id=3
    ... )
    >>> small = find_small(h, threshold=8)
    >>> surfaces(image > 0, h, small, SurfacesParams(), with_patches=True).to_segments()
    array([[1, 1, 1, 3, 0, 3],
           [1, 1, 1, 1, 0, 0]])
    """
    covered = dilate(select_components(supported, components.image, small), params.gamma)
    patches, n_patches = label_components(covered) if with_patches else (None, 0)
    return Surfaces(supported, components, covered, patches, n_patches)


@stage("surfaces")
def smooth_last_line(
    supported: Mask,
    components: Components,
    small: Mask,
    params: SurfacesParams,
) -> I64:
    """Return the segment ids of a block's last line where it is smooth, 0 elsewhere, (M,) int64.

    The same as from :func:`surfaces`, computed only from the lines within reach of the dilation.
    """
    reach = slice(-min(params.gamma + 1, len(supported)), None)
    image = components.image[reach]
    covered = dilate(select_components(supported[reach], image, small), params.gamma)
    last_line: I64 = np.where(supported[-1] & ~covered[-1], components.ids[image[-1]], 0)
    return last_line
