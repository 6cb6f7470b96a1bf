"""What the compiled loops of the sequential-angle method and their twins are given: thresholds and states, by name.

Each is a ``NamedTuple``, which numba takes as it is. Arrays say how the compiler sees them. Lengths are in metres,
angles in degrees; heights are counted from the scanner. ``R`` is the number of rows (half-lines) and ``n`` that of
their beams.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from prc_cli.core.types import F32, F64, I32, Mask

Floats = Annotated[F64, 1]
Ints = Annotated[I32, 1]


class ChordThresholds(NamedTuple):
    """Which shots a chord joins (sec. 3)."""

    min_chord_m: float
    """Shots nearer than this to each other make no chord; shots at the same place never do."""
    depth_m: float
    """Range differences up to this count nothing for that length, larger ones by what they have more."""
    max_shots: int
    """Valid shots looked at on either side of a shot."""


class MarkovModel(NamedTuple):
    """A hidden Markov model of three states (sec. 4)."""

    transition: Annotated[F64, 2]
    """(3, 3) float64, transition probabilities; row = from."""
    initial: Floats
    """(3,) float64, probabilities of the states at the first sample after a restart."""


class MarkovThresholds(NamedTuple):
    """Where the test between two hidden Markov models begins and ends a region (sec. 4)."""

    threshold: float
    """Log-likelihood ratio of model 1 to model 0 at which a region begins [nats]."""
    threshold_back: float
    """Log-likelihood ratio of model 0 to model 1 at which it ends [nats]."""
    backdate: bool
    """A region begins and ends at the onset rather than at the alarm."""
    sprt: bool
    """Regions end, after they are confirmed, by tests between two bounds."""
    accept: float
    """Upper bound of those tests, positive [nats]."""
    reject: float
    """Lower bound of those tests, negative [nats]."""
    merge_gap: int
    """Regions found with ``sprt`` that are closer than this become one [samples]."""


class SurfaceThresholds(NamedTuple):
    """When a run turns from horizontal to vertical and back (sec. 4)."""

    drift_vertical_deg: float
    """From H to V the sum of (drift - angle) since its last reset ..."""
    threshold_vertical_deg: float
    """... must exceed this."""
    drift_horizontal_deg: float
    """From V to H the sum of (angle - drift) since its last reset ..."""
    threshold_horizontal_deg: float
    """... must exceed this."""
    fold: bool
    """Angles beyond 90 deg count as their supplement."""
    backdate: bool
    """A change begins at the first sample after the last reset rather than at the alarm."""
    start_horizontal: bool
    """Runs begin with H, not with what their first five samples are."""


class LayerThresholds(NamedTuple):
    """When a run of vegetation is a facade seen through its windows."""

    width_m: float
    """A layer is as many horizontal distances as fit into this."""
    share: float
    """The two fullest layers must hold more than this share of the run."""
    min_points: int
    """Runs of fewer returns stay as they are."""


class WallThresholds(NamedTuple):
    """When a vertical run is a wall, and what is vegetation no more beside it."""

    extent_m: float
    """Height of a run of vertical points at least, ..."""
    break_m: float
    """... which a larger change of horizontal distance from one return to the next ends, ..."""
    residual_m: float
    """... root mean square of the residuals of its horizontal distances from a straight line at most, ..."""
    slope: float
    """... and slope of that line from the vertical at most, a tangent: it is a wall."""
    width_m: float
    """Vegetation no farther than this from the wall's distance is the wall, ..."""
    front_m: float
    """... and below the wall all that is farther away than it, less this."""


class GroundThresholds(NamedTuple):
    """How ground is found in a row and followed across rows (sec. 5)."""

    first_run: int
    """Horizontal points in a row that potential ground begins with, at least 3."""
    lowest_points: int
    """Points, the lowest ones, whose mean height is the height of potential ground."""
    height_points: int
    """Points at the beginning of potential ground that they are taken from; 0 = all."""
    mode_samples: int
    """Samples that make a mode."""
    bandwidth_deg: float
    """Bandwidth of line angles: the larger of this ..."""
    bandwidth_sigmas: float
    """... and so many standard deviations of a line angle ..."""
    range_noise_m: float
    """... at this standard deviation of a range."""
    growth_points: int
    """Points that the local line is laid through."""
    jump_m: float
    """Height above or below the last point and the local line that ends potential ground."""
    growth_height_m: float
    """Height above or below the local line up to which ground grows."""
    bridge: int
    """Points that are neither horizontal nor missing which a run of horizontal points may pass over, where the next two
    valid points continue the local line."""
    bridge_height_m: float
    """Height above or below the local line up to which they continue it."""
    resume: bool
    """Where growth ends within a run of horizontal points, more potential ground is sought in the rest of the run."""
    start_heights: int
    """Heights that a first estimate of the ground needs."""
    least_heights: int
    """Heights without which the ground stays unknown."""
    memory_heights: int
    """Heights that are remembered, the oldest one is forgotten; 0 = all."""
    height_bandwidth: float
    """Bandwidth of heights, as a share of their median."""
    roof_m: float
    """The main mode of the heights is roofs where another one is this much lower; inf = never ..."""
    roof_share: float
    """... and has at least this share of its heights."""
    all_heights: bool
    """Heights of rows without ground count too."""
    renew_every: bool
    """The height of the ground is computed anew after every height that counts, not after those of ground alone."""
    height_tolerance: float
    """Difference between a row's height and that of the ground, as a share of the latter, below which it is ground."""
    height_tolerance_m: float
    """The same at least."""
    follow_m: float
    """Difference between a row's height and that of the last ground of its side, below which it is ground; 0 = off."""


class PotentialGround(NamedTuple):
    """The first potential ground of every row (sec. 5, part a)."""

    first: Ints
    """(R,) int32, its first beam, -1 = none."""
    last: Ints
    """(R,) int32, its last beam; the horizontal points from the first one on are its points."""
    bandwidth_deg: Floats
    """(R,) float64, bandwidth of its line angles at its end, NaN = none."""
    height_m: Floats
    """(R,) float64, z_i, NaN = none."""


class GroundState(NamedTuple):
    """What is known of the ground between two calls (sec. 5, part b)."""

    histogram: Ints
    """(185 000,) int32, heights of the rows so far, in bins of 2 mm from -310 m on."""
    recent: Ints
    """(at most ``memory_heights``,) int32, their bins, the oldest one first; empty where none is forgotten."""
    z_g: float
    """Height of the ground, NaN = unknown."""
    n_in_histogram_ahead: int
    """Rows to come whose heights the histogram holds already."""
    side_m: Floats
    """(n_sides,) float64, height of the last ground of every side, NaN = none."""


class CurbThresholds(NamedTuple):
    """Where a curb may begin, and what proves it (sec. 6)."""

    under_points: int
    """Valid points before a point that are looked at for something under it, ..."""
    under_m: float
    """... which is farther away by more than this."""
    search_height_m: float
    """The search ends at the first valid point higher above the ground."""
    grouping_m: float
    """Neighbours closer than this belong to one region."""
    max_height_m: float
    """A region higher than this is not a curb."""
    min_height_m: float
    """Nor is one lower than this."""
    by_line: bool
    """That height is the one within a line, not that of the whole region."""
    min_lines: int
    """Lines that make a curb of a region with a possible curb point."""
    curvature_deg: float
    """With fewer lines: the angle must change less than this from point to point, in the median."""
    max_lines: int
    """A region of so many lines is decided as it is, and closed."""


class OpenRegions(NamedTuple):
    """The C regions of vertical points that are not decided yet, and the P lines they lie in (sec. 6)."""

    labels: Annotated[I32, 2]
    """(P * n_sides, n) int32: 0 not vertical, 1 too high, 2 no curb, 3 a curb, from 4 on the undecided regions."""
    n_given: int
    """Lines at the beginning of ``labels`` that were returned as decided before, 0 or 1."""
    side: Ints
    """(C,) int32."""
    first: Ints
    """(C,) int32, first line of every region, from the beginning of ``labels`` on."""
    last: Ints
    """(C,) int32, its last line."""
    possible: Annotated[Mask, 1]
    """(C,) bool, whether it has a possible curb point."""
    low_m: Annotated[F32, 1]
    """(C,) float32, its lowest height."""
    high_m: Annotated[F32, 1]
    """(C,) float32, its highest height."""


class DividerThresholds(NamedTuple):
    """Where a car may begin and end along a line (sec. 7.3)."""

    height_m: float
    """The search ends at the first return higher above the ground, ..."""
    tall_m: float
    """... but goes on along a vertical run that ends no higher than this."""
    glass_m: float
    """The search goes on behind T' where the next return is H or V and no farther behind the last one; 0 = it ends."""
    sudden_from_deg: float
    """A change from H to V at an angle between this ..."""
    sudden_to_deg: float
    """... and this is sudden."""
    chord_m: float
    """Least length of the chord that the angle is measured on; 0 or below = the signed angle."""
    chord_reach: int
    """Returns that are looked at for either end of the chord."""
    under_points: int
    """Returns before a sudden change of which one must be ..."""
    under_m: float
    """... this much farther away."""
    separation_m: float
    """Successive returns farther apart, the second one not nearer to the scanner, belong to two intervals."""
    return_points: int
    """They do not where one of so many returns after them is nearer again; 0 = none is looked at."""
    from_start: bool
    """An interval begins with the first return of a row if it is V."""
    flat_length_m: float
    """Horizontal length of a stretch of ground at least, ..."""
    flat_residual_m: float
    """... root mean square of the residuals of its heights at most ..."""
    flat_slope: float
    """... and slope at most, a tangent."""
    flat_step_m: float
    """A larger change of height from one return to the next ends such a stretch; inf = none does."""
    flat_above_m: float
    """Such a stretch is a roof where it begins higher above the lowest return of its interval; inf = none is."""
    vertical_extent_m: float
    """Vertical runs from this difference between their highest and lowest point up are cut out."""
    vertical_break_m: float
    """A larger change of horizontal distance from one return to the next ends such a run."""
    vertical_top_m: float
    """Such a run must end higher than this above the ground; -inf = anywhere."""
    vertical_slope: float
    """Or such a run must be no farther from upright than this, a tangent."""
    vertical_open: bool
    """Or such a run must go on to the last beam of its row: nothing tells where it ends."""
    straight_points: int
    """Runs of fewer returns are cut out by their height alone, wherever they end."""
    straight_extent_m: float
    """Lower runs from this height up are cut out where they are straight and upright; inf = none is."""
    straight_residual_m: float
    """Root mean square of the residuals of their horizontal distances from a straight line at most, ..."""
    straight_slope: float
    """... and slope of that line from the vertical at most, a tangent."""
    relief_m: float
    """Runs of V and H as high as long vertical ones, as upright as straight ones, and no farther than this from a
    straight line (rms) are cut out too, where steps are small; 0 = none is."""
    lean_noise_m: float
    """Noise of a horizontal distance by which both slopes may be larger: this over the root of the sum of squares of
    the heights about their mean."""


class FourierThresholds(NamedTuple):
    """When the angles of an interval hold no high frequency (sec. 7.5)."""

    band: float
    """Frequencies k from ``band * N`` to N/2 must not be ..."""
    ratio: float
    """... larger than this share of the largest one of all, k = 0 included; below 1."""
    min_points: int
    """Fewer angles decide against the interval."""
    window_points: int
    """Longer intervals are cut into windows of at most this many."""
    longest: int
    """Intervals of more angles pass untested; 0 = none does."""
