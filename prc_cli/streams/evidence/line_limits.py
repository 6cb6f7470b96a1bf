"""Limits of the checks of shots and lines, one a row: value, unit and reason.

"Likeness" is the median difference of the logarithms of two ranges (:mod:`.figures`). "All scans"
are 23 scans of streets and forests, static scans and frames that were read with the right M.
"""

from __future__ import annotations

LEAST_LINES = 24
"""[lines] Shorter streams are not checked: figures of fewer lines depend on single objects."""

# shot-order
ORDER_DOUBTFUL = 0.3
"""[likeness of random shots] Neighbouring shots reach at most 0.05 in all scans."""
ORDER_AGAINST = 0.7
"""[likeness of random shots] Shuffled shots and misread numbers reach 1."""
SECOND = 0.5
"""[likeness of the next shot or line] If the second neighbour is closer, every other one belongs
to another scanner. In all scans the second is less alike than the first."""

# line-length: neighbouring lines
LINE_DOUBTFUL = 0.12
"""[likeness of random shots] Neighbouring lines reach at most 0.03 in all scans."""
LINE_AGAINST = 0.4
"""[likeness of random shots] Far above the warning: only a wrong M or shuffled lines get there."""
ALIKE = 0.005
"""[likeness of random shots] Lines below it are of one scanner. If a turn has a number of shots
and a half, every second line has the same angles, and differs less (0.001) while standing."""
HALF = 2.0
"""[times] The next line in reverse order is as alike as the second next within this factor if every
second line runs back."""
NEXT_CLEAR = 0.8
"""[times] Lines of the right length differ by this much less than lines of any other length: 0.004
to 0.63 in 22 frames of spinning scanners and 6 drives."""
FRAME_SHOTS = 160
"""[shots] Longer lines are not those of a spinning scanner: these have 128 rings at most."""
FAN_DEG = 60.0
"""[deg] All beams of a spinning scanner are within it. Its lines far apart look in other
directions, and have nothing in common."""

# line-length: periods
PERIOD_SHOTS = 1 << 17
"""[shots] Shots in which a period is searched: enough for 16 lines of the longest scanners."""
FAR_OFF = 1.5
"""[times] A period that is this many times longer or shorter than M means several turns in a line,
or a part of one."""
AS_ALIKE = 1.25
"""[times] Shots a period apart are as alike as shots M apart within this factor: at most 1.05 in 32
scans read with 2 to 100 times their M, or a half to a tenth. In a room half a turn is a period, but
not as alike."""
MOST_UNLIKE = 0.06
"""[likeness] Lines of a period if M cannot be compared: at most 0.02 in the same scans."""
SHIFTS = 400
"""[shots] A scene that moves from line to line moves the period by one shot in so many."""

# line-length: along the stream
FOLD_REACH = 4
"""[shots] Line lengths that are tried on either side of M: more is found as a period."""
FOLD_DOUBTFUL = 1.05
"""[times] Another length agrees this much better: at most 0.9 in all scans."""
FOLD_AGAINST = 1.2
"""[times] With M off by one the right length agrees 1.16 to 7 times better."""
FOLD_SHORT = 1.25
"""[times] The warning for streams of fewer lines than ``M / FOLD_LONG``."""
FOLD_LONG = 12
"""[lines, as M divided by it] With M off by one all columns turn by 30 deg in so many lines. Before
that, moving things shift as much."""
FOLD_RANDOM = 0.8
"""[difference of profiles] Places along the stream: at most 0.6 in all scans."""
FOLD_NOTHING = 0.97
"""[difference of profiles] Above it not even the ground is in common: 0.5 to 1 if lines and columns
are exchanged."""

# columns-along
TURNED_AGAINST = 0.45
"""[times] If a buffer of shots was lost, places mostly differ by less with the right shift."""
SHIFT_NEAR = 0.012
"""[share of a line] Accuracy of a shift."""

# line-order and standing
MOVED_SAME = 1.6
"""[times] Lines far apart differ this much more than neighbours: at least 2.1 in all scans."""
MOVED_AGAINST = 1.4
"""[times] Shuffled lines, and a platform that stands, reach 0.8 to 1.2."""
MOVED_NOISE = 15.0
"""[times the roughness of surfaces] Smaller changes may be noise and stray shots: at least 18 with
shuffled lines, at most 2 while standing, in the tenth of the columns that changes most."""
SEEN_AGAIN = 0.85
"""[share] Leaves and edges that the next line sees again: 0.27 to 0.53 in real scans, 0.7 at 1 cm a
line with columns 1.3 deg apart, 0.97 if each line comes 20 times."""
STANDING_LINES = 200
"""[lines] Shorter streams may be a stop at a traffic light."""

# dropouts
LONELY = 0.085
"""[share] Missing shots between smooth surfaces: at most 0.06 in all scans, 0.1 if a tenth of the
shots is lost."""
