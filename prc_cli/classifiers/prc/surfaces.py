"""Smooth and non-smooth surfaces (Lehtola et al. 2019, II-E): small segments grow together, large ones are smooth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from prc_cli import kernels
from prc_cli.classifiers.prc.components import Components
from prc_cli.core.config import Params
from prc_cli.core.types import I32, I64, Mask

PUBLISHED_AREA = 30
"""A, pixels, for blocks of ..."""
PUBLISHED_BLOCK = 99 * 2154
"""... k x M pixels; the ratio is what should be kept (II-E)."""


def _area(value: Any) -> Any:
    """Say what an area may be in one message rather than one for each kind of value."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if value != "auto" and not (is_number and 0 < value < float("inf")):
        msg = f'a positive number of pixels or "auto", found {value!r}'
        raise ValueError(msg)
    return value


class SurfacesParams(Params):
    """What is large enough to be a surface, and how far the rest grows together (``[prc.surfaces]``)."""

    area: Annotated[Annotated[float, Field(gt=0)] | Literal["auto"], BeforeValidator(_area)] = Field(
        30.0,
        description="segments of this many pixels in a full block are smooth [pixels, real number]; "
        '"auto" keeps the published share of the block, 30 / (99 * 2154) * k * M',
    )
    gamma: int = Field(
        2, ge=0, le=10_000, description="dilations of the non-smooth image; keep far below the square root of the area"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The segmentation R of a block and what is smooth in it."""

    segments: I64
    """(lines, M) int64, R: segment id of every supported shot, 0 elsewhere."""
    smooth: Mask
    """(lines, M) bool, supported shots of H outside V."""
    patches: I32
    """(lines, M) int32, components of the dilated non-smooth image, 0 = none; covers noise and missing shots too."""
    first_patch_id: int
    """Segment id of patch 1; patch n has ``first_patch_id + n - 1``."""
    next_id: int
    """First segment id that is still free."""

    def to_patches(self) -> I64:
        """Return V as segment ids, (lines, M) int64, 0 = none; the dilated image, noise under it included."""
        patches: I64 = np.where(self.patches > 0, self.patches + np.int64(self.first_patch_id - 1), 0)
        return patches


def area_threshold(params: SurfacesParams, n_lines: int, lines_per_block: int, points_per_line: int) -> float:
    """Return the pixels that make a segment smooth in a block of ``n_lines`` lines.

    A block that the end of the stream cuts short asks for proportionally less. The division comes last, so that
    whole results are exact.

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


def surfaces(supported: Mask, components: Components, threshold: float, params: SurfacesParams) -> Surfaces:
    """Split a block into smooth and non-smooth surfaces.

    Segments below the threshold and background shots that no component took back form the non-smooth image; dilated
    and connected, it covers what it touches: smooth shots under it become non-smooth, noise stays noise.

    Parameters
    ----------
    supported : (lines, M) bool
        S.
    components : Components
        H.
    threshold : float, pixels
        From :func:`area_threshold`.
    params : SurfacesParams

    Returns
    -------
    Surfaces

    Examples
    --------
    A segment of 8 pixels stays smooth but for the pixels that the lone one on its right grows over:

    >>> image = np.array([[1, 1, 1, 1, 0, 2], [1, 1, 1, 1, 0, 0]], dtype=np.int32)
    >>> h = Components(image, ids=np.array([0, 1, 2]), next_id=3)
    >>> surfaces(image > 0, h, threshold=8, params=SurfacesParams()).segments
    array([[1, 1, 1, 3, 0, 3],
           [1, 1, 1, 1, 0, 0]])
    """
    small = segment_areas(components) < threshold
    small[0] = True  # supported, yet in no component: background that no neighbour took back
    non_smooth = supported & small[components.image]
    patches, n_patches = kernels.label_components(kernels.dilate(non_smooth, params.gamma))
    first_patch_id = components.next_id
    smooth = supported & (patches == 0)
    segments = np.where(supported, patches + np.int64(first_patch_id - 1), 0)
    segments[smooth] = components.ids[components.image[smooth]]
    return Surfaces(segments, smooth, patches, first_patch_id, first_patch_id + n_patches)


def segment_areas(components: Components) -> I64:
    """Return the pixels that a component shares its segment id with, itself included, (n + 1,) int64."""
    pixels = np.bincount(components.image.ravel(), minlength=len(components.ids))
    return sum_by_id(components.ids, pixels)[2]


def sum_by_id(ids: I64, counts: I64) -> tuple[I64, I64, I64]:
    """Add counts up that belong to the same segment id.

    Parameters
    ----------
    ids, counts : (n,) int64

    Returns
    -------
    unique_ids, sums : (n unique,) int64
        In ascending order of the id.
    sum_of_each : (n,) int64
        The sum that each of the given entries belongs to.
    """
    unique_ids, position = np.unique(ids, return_inverse=True)
    sums = np.zeros(len(unique_ids), dtype=np.int64)
    np.add.at(sums, position, counts)
    return unique_ids, sums, sums[position]
