"""Stamos et al. (2012) in plain NumPy and SciPy, one file for each step, in the order of the paper.

======================  ===================================================================
``lines``, ``angles``   sec. 3: half-lines, signed angles, line angles
``markov``, ``coarse``  sec. 4: vegetation, then horizontal and vertical
``ground``              sec. 5: potential ground within a line, its height across lines
``curb``                sec. 6: possible curb points, regions of vertical points
``suspicious``          sec. 7.2: lines that may hold a car
``dividers``            sec. 7.3: intervals that may be cars
``verticals``           sec. 7.4: high verticals, which no car lies behind
``fourier``             sec. 7.5: cars and vegetation by their spectrum
``labels``              sec. 7 and 8: the class of every point
======================  ===================================================================

Thresholds and states have the names of :mod:`prc_cli.methods.sequential_angle.thresholds`. Where the text is silent the
readings are those of the stage of the same name in :mod:`prc_cli.methods.sequential_angle`.
"""
