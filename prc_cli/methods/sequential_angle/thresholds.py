"""The thresholds of the sequential-angle method.

Each once, for the configuration, the loops and their twins.

A field with :func:`~prc_cli.methods.keys.key` is a key of ``[sequential_angle]``; the others are
constants. Lengths are in metres, angles in degrees; heights are counted from the scanner.
:meth:`SequentialAngleThresholds.at_noise` gives what the loops compare with. ``R`` is the number of
rows (half-lines) and ``n`` that of their beams.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from pydantic import AfterValidator, Field

from prc_cli.core.types import F32, F64, I32, Mask
from prc_cli.methods.keys import key

Floats = Annotated[F64, 1]
Ints = Annotated[I32, 1]

Probability = Annotated[float, Field(ge=0, le=1)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Spread = Annotated[float, Field(gt=0, le=360)]
Three = tuple[float, float, float]


def _add_up(row: Three) -> Three:
    """Refuse probabilities that do not add up to one."""
    if not math.isclose(sum(row), 1.0, abs_tol=1e-6):
        msg = f"probabilities that add up to 1, found a sum of {sum(row):g}"
        raise ValueError(msg)
    return row


Row = Annotated[tuple[Probability, Probability, Probability], AfterValidator(_add_up)]
Matrix = tuple[Row, Row, Row]
UNIFORM: Three = (1 / 3, 1 / 3, 1 / 3)
CALM: Three = (0.1, 0.8, 0.1)


class ChordThresholds(NamedTuple):
    """Chords between shots, on which angles are measured (``[sequential_angle.angles]``)."""

    range_noise_m: Annotated[float, key(0, 10)] = 0.005
    """Standard deviation of the range noise of the scanner [m].

    It is the accuracy of the scanner of the paper (sec. 9); footnote 3 implies 1 mm.
    """
    min_chord_sigmas: Annotated[float, key(0, 1000)] = 4.0
    """Shortest chord that an angle is measured on [standard deviations of the range noise].

    Below about 3 noise turns
    chords round and looks like foliage; published: 0, successive shots."""
    max_shots: int = 256
    """Valid shots before and after a shot among which its chords may end.

    Bounds the time where all are at one spot.
    """
    least_chord_m: float = 0.0
    """``min_chord_sigmas`` in metres."""

    def at_noise(self) -> ChordThresholds:
        """Return lengths in metres at the range noise."""
        return self._replace(least_chord_m=self.min_chord_sigmas * self.range_noise_m)


class MarkovThresholds(NamedTuple):
    """Two hidden Markov models of three states with common Gaussians, and the end of their test."""

    means_deg: tuple[Angle, Angle, Angle] = (-90.0, 0.0, 90.0)
    """Mean of every state [deg] (published)."""
    sigmas_deg: Annotated[tuple[Spread, Spread, Spread], key()] = (30.0, 30.0, 30.0)
    """Standard deviation of every state [deg]; published (the script): 2, 2, 12."""
    h0: Annotated[Matrix, key()] = (
        (0.05, 0.475, 0.475),
        (0.05, 0.875, 0.075),
        (0.05, 0.075, 0.875),
    )
    """Transition probabilities of model 0, no vegetation; row = from, each adds up to 1."""
    h1: Matrix = (UNIFORM, UNIFORM, UNIFORM)
    """Transition probabilities of model 1, vegetation; row = from (published)."""
    initial_h0: Three = UNIFORM
    """Probabilities of the states of model 0 at the first sample of a start (published)."""
    initial_h1: Three = UNIFORM
    """Those of model 1."""
    threshold: Annotated[float, key(above=0, most=100)] = 10.0
    """Log-likelihood ratio that vegetation begins at [nats] (published for dense vegetation)."""
    accept: float = 10.0
    """Upper bound of the tests that confirm and end a region [nats]."""
    reject: float = -5.0
    """Lower bound of these tests [nats]."""
    merge_gap: int = 5
    """Regions that are closer than this become one [samples]."""
    backdate: Annotated[bool, key()] = True
    """Vegetation begins at its estimated onset; published (the script): false, at the sample that
    raised the alarm."""


DENSE_VEGETATION = MarkovThresholds(
    means_deg=(-150.0, 0.0, 150.0), h0=(CALM, CALM, CALM), backdate=False
)
"""Those of dense vegetation, T' (published, and the script)."""


class SurfaceThresholds(NamedTuple):
    """Changes of a run from horizontal to vertical and back (``sequential_angle.coarse.surfaces``).

    From horizontal to vertical the sum of (drift - angle), from vertical to horizontal the sum of
    (angle - drift) is followed, never below zero, until it exceeds the threshold.
    """

    drift_vertical_deg: Annotated[float, key(0, 180)] = 45.0
    """Drift from horizontal to vertical [deg] (published)."""
    threshold_vertical_deg: Annotated[float, key(0, 1e6)] = 20.0
    """Threshold from horizontal to vertical [deg] (published)."""
    drift_horizontal_deg: Annotated[float, key(0, 180)] = 45.0
    """Drift from vertical to horizontal [deg]; published (the script): 30."""
    threshold_horizontal_deg: Annotated[float, key(0, 1e6)] = 30.0
    """Threshold from vertical to horizontal [deg]; published (the script): 15."""


class CoarseThresholds(NamedTuple):
    """The coarse classification (``[sequential_angle.coarse]``)."""

    vegetation: MarkovThresholds = MarkovThresholds()
    surfaces: SurfaceThresholds = SurfaceThresholds()


class GroundThresholds(NamedTuple):
    """How ground is found and followed (``[sequential_angle.ground]``)."""

    first_run: Annotated[int, key(3, 1000)] = 10
    """Horizontal points in succession that potential ground begins with (published)."""
    lowest_points: Annotated[int, key(1, 1000)] = 5
    """Points, the lowest ones, whose mean z is the height of a line (published)."""
    start_heights: Annotated[int, key(1, 100_000)] = 200
    """Heights of lines that the first estimate of the ground needs.

    Published: 50, which the bonnet of a car beside the
    scanner can fill."""
    height_tolerance: Annotated[float, key(above=0, most=10)] = 0.10
    """Potential ground is ground when its height differs from the dominant height by less than this
    share of it (published); heights are counted from the scanner."""
    height_points: Annotated[int, key(0, 100_000)] = 30
    """Points at the beginning of potential ground that its lowest points are taken from.

    0 = all of it, the printed
    text."""
    bandwidth_deg: float = 5.0
    """Bandwidth of the mean shift over line angles: the larger of this ..."""
    bandwidth_sigmas: float = 3.0
    """... and so many standard deviations of a line angle ..."""
    range_noise_m: float = ChordThresholds().range_noise_m
    """... at this standard deviation of a range."""
    mode_samples: int = 2
    """Line angles that make a mode."""
    height_bandwidth: float = 0.05
    """Bandwidth of the mean shift over heights, as a share of their median.

    Rounded up to a multiple of 16 mm.
    """
    growth_points: int = 10
    """Points before a point that the local line is laid through."""
    growth_height_m: float = 0.10
    """Height above or below the local line up to which ground grows."""


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
    z_g: float
    """Height of the ground, NaN = unknown."""
    n_in_histogram_ahead: int
    """Rows to come whose heights the histogram holds already."""


class CurbThresholds(NamedTuple):
    """How curbs are found and verified (``[sequential_angle.curb]``)."""

    under_points: int = 30
    """Points before a point that are looked at for something under it (published)."""
    under_m: float = 0.01
    """A point before that is farther away by more than this lies under the point, which then is no
    curb (published) [m]."""
    search_height_m: float = 2.0
    """Height above the ground where the search for a curb ends (published) [m]."""
    grouping_m: Annotated[float, key(above=0, most=100)] = 2.0
    """Neighbouring vertical points closer than this belong to one region [m] (published)."""
    max_height_m: Annotated[float, key(above=0, most=100)] = 0.2
    """A higher region is not a curb (published) [m]."""
    min_height_m: Annotated[float, key(0, 100)] = 0.08
    """Nor is a lower one, such as a lowered kerb or the edge of a verge.

    Cars stand behind them; published: 0 [m].
    """
    min_lines: Annotated[int, key(1, 200)] = 3
    """Lines that make a curb of a region with a possible curb point (published)."""
    curvature_deg: float = 20.0
    """With fewer lines, the median change of the angle from point to point must be less than
    this."""
    max_lines: int = 200
    """A region of so many lines is decided as it is: bounds memory and delay."""


class OpenRegions(NamedTuple):
    """The C undecided regions of vertical points, and the P lines they are in (sec. 6)."""

    labels: Annotated[I32, 2]
    """(P * n_sides, n) int32: 0 not vertical, 1 too high, 2 no curb, 3 a curb, from 4 on the
    undecided regions."""
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


class SuspiciousThresholds(NamedTuple):
    """Markov chains of H, V, M on a surface and on a car (``sequential_angle.car.suspicious``)."""

    h0: tuple[Three, Three, Three] = (
        (0.8, 0.1, 0.1),
        (0.09, 0.9, 0.01),
        (0.6, 0.3, 0.1),
    )
    """Regular surface: probabilities from H, V, M (rows) to H, V, M (published; the third column
    completes the rows)."""
    h1: tuple[Three, Three, Three] = (
        (0.5, 0.25, 0.25),
        (0.25, 0.5, 0.25),
        (0.25, 0.25, 0.5),
    )
    """Car: probabilities from H, V, M (rows) to H, V, M (published; the third column completes the
    rows)."""
    threshold: Annotated[float, key(0, 1e6)] = 1.0
    """Log likelihood ratio above which a line is suspicious [nats] (published)."""


class DividerThresholds(NamedTuple):
    """Where a car begins and ends along a line (``[sequential_angle.car.dividers]``)."""

    sudden_from_deg: Annotated[float, key(-180, 180)] = -5.0
    """L1: a change from H to V at a signed angle below this is gradual [deg] (published)."""
    sudden_to_deg: Annotated[float, key(-180, 180)] = 20.0
    """L2: so is one above this; gradual changes begin an interval [deg] (published)."""
    change_chord_m: Annotated[float, key(0, 10)] = 0.1
    """That angle is measured to the first return at least this far away; published: 0, the signed
    angle of the point itself [m]."""
    change_reach: int = 200
    """Returns that are looked at for either end of that chord."""
    under_points: int = 30
    """L: returns before a sudden change among which TestUnder looks (published)."""
    under_m: float = 0.01
    """A point before that is farther away by more than this lies under the point, which then begins
    an interval (published) [m]."""
    separation_m: Annotated[float, key(above=0, most=1e4)] = 4.0
    """T_sep: successive returns farther apart are two objects, ... [m] (published)."""
    return_points: Annotated[int, key(0, 100_000)] = 8
    """... unless one of so many returns after the jump is back at the object.

    Such jumps go through its windows;
    published: 0 [returns]."""
    from_start: Annotated[bool, key()] = True
    """A line that begins with V begins with an interval, because a car that stands close hides the
    ground before it; published: false."""
    flat_length_m: Annotated[float, key(above=0, most=1e4)] = 3.0
    """Horizontal length from which a flat stretch is ground [m] (published)."""
    flat_residual_m: float = 0.05
    """Largest rms distance of its heights from a straight line."""
    flat_slope: float = math.tan(math.radians(10.0))
    """Largest slope of that line, a tangent."""
    flat_step_m: Annotated[float, key(0, 1e3)] = 0.2
    """A change of height from one return to the next that ends such a stretch, as from a bonnet to
    the road behind; published: 0, none does [m]."""
    height_m: Annotated[float, key(above=0, most=1e3)] = 2.0
    """T_height: cars are not sought above the first return this high over the ground [m]
    (published)."""
    tall_m: Annotated[float, key(0, 1e3)] = 2.6
    """They are along a vertical run that goes on from below and ends no higher than this above the
    ground, as the side of a van does; published: 0, they are not [m]."""
    vertical_extent_m: float = 1.2
    """Runs of vertical points of this height or more are cut out, ..."""
    vertical_top_m: Annotated[float, key(0, 1e3)] = 2.6
    """Runs of vertical points of 1.2 m height or more are cut out if they end higher than this
    above the ground, as no car does; 0 = wherever they end [m]."""
    vertical_slope: float = math.tan(math.radians(2.5))
    """... or if they lean less than this from the vertical, a tangent."""
    straight_points: int = 16
    """Fewer points do not show whether a run is straight or upright: their height decides."""
    straight_extent_m: Annotated[float, key(0, 1e3)] = 0.25
    """So are runs of this height or more that are straight and upright, as walls, fences and posts
    are and the sides of cars are not; 0 = none [m]."""
    straight_m: float = 0.01
    """Straight is what lies this near to a straight line, rms, ..."""
    straight_sigmas: float = 2.0
    """... or as many times the range noise."""
    straight_slope: float = math.tan(math.radians(1.5))
    """Upright is what leans less than this from the vertical, a tangent."""
    lean_sigmas: float = 2.0
    """Both leans may be larger by so many standard deviations of a lean, as the range noise makes
    it."""
    lean_noise_m: float = 0.0
    """``lean_sigmas`` in metres."""

    def at_noise(self, range_noise_m: float) -> DividerThresholds:
        """Return lengths at a standard deviation of the range [m]; infinity = switched off by 0."""
        return self._replace(
            flat_step_m=self.flat_step_m or math.inf,
            vertical_top_m=self.vertical_top_m or -math.inf,
            straight_extent_m=self.straight_extent_m or math.inf,
            straight_m=max(self.straight_m, self.straight_sigmas * range_noise_m),
            lean_noise_m=self.lean_sigmas * range_noise_m,
        )


class HighVerticalThresholds(NamedTuple):
    """What is too high for a car (``[sequential_angle.car.high_verticals]``)."""

    height_m: Annotated[float, key(above=0, most=1e3)] = 2.5
    """Vertical surfaces that reach this far above the ground hide all cars behind [m]
    (published)."""


class FourierThresholds(NamedTuple):
    """Which spectra are those of vegetation (``[sequential_angle.car.fourier]``)."""

    longest: Annotated[int, key(0, 1_000_000)] = 16
    """Test intervals of at most this many angles.

    Windows of cars look like foliage to it, and where shots are many
    car.most_foliage tells more; published: 0, all [angles]."""
    ratio: Annotated[float, key(above=0, below=1)] = 0.5
    """A high frequency above this share of the largest one tells vegetation (published)."""
    band: float = 0.125
    """Lowest of the high frequencies, as a share of the number of angles (published)."""
    window: int = 2048
    """Longer intervals are tested in windows, of which at least half must be those of a car: the
    cost of a spectrum grows with the square of its length."""


class CarThresholds(NamedTuple):
    """The car algorithm (``[sequential_angle.car]``)."""

    suspicious: SuspiciousThresholds = SuspiciousThresholds()
    dividers: DividerThresholds = DividerThresholds()
    high_verticals: HighVerticalThresholds = HighVerticalThresholds()
    fourier: FourierThresholds = FourierThresholds()
    most_foliage: Annotated[float, key(0, 1)] = 0.8
    """An interval of which the coarse classification calls more than this share vegetation is no
    car; published: 1, such intervals are cars too."""
    ground_layer_m: Annotated[float, key(0, 10)] = 0.3
    """Horizontal points below this height over the ground are no car, even inside an interval.

    Published: 0, all of an
    interval is a car [m]."""

    def at_noise(self, range_noise_m: float) -> CarThresholds:
        """Return lengths at a standard deviation of the range [m]."""
        return self._replace(dividers=self.dividers.at_noise(range_noise_m))


class SequentialAngleThresholds(NamedTuple):
    """Parameters of the sequential-angle classifier (``[sequential_angle]``)."""

    max_range_m: Annotated[float, key(above=0, most=1e9)] = 300.0
    """Ranges beyond are missing (published) [m]."""
    start_lines: Annotated[int, key(1, 1_000_000)] = 500
    """Scan lines that are held back at most until the height of the ground is known from
    ground.start_heights lines; then it is taken from those there are."""
    start_shots: int = 4_000_000
    """Shots that are held back at most for the same purpose.

    Bounds memory where lines are very long.
    """
    extra_return_m: float = 0.3
    """Another return of a shot takes the label of the nearest range up to four columns away if it
    differs by less."""
    angles: ChordThresholds = ChordThresholds()
    coarse: CoarseThresholds = CoarseThresholds()
    ground: GroundThresholds = GroundThresholds()
    curb: CurbThresholds = CurbThresholds()
    car: CarThresholds = CarThresholds()

    def at_noise(self) -> SequentialAngleThresholds:
        """Return what the loops compare with, at the range noise of the scanner."""
        noise = self.angles.range_noise_m
        return self._replace(
            angles=self.angles.at_noise(),
            ground=self.ground._replace(range_noise_m=noise),
            car=self.car.at_noise(noise),
        )
