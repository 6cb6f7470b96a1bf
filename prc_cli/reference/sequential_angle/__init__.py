"""Stamos et al. (2012) in plain NumPy and SciPy, one file for each step, in the order of the paper.

======================  ===================================================================
``angles``              sec. 3: signed angles, line angles
``coarse``              sec. 4: vegetation, then horizontal and vertical
``ground``              sec. 5: potential ground within a line, its height across lines
``curb``                sec. 6: possible curb points, regions of vertical points
``car``                 sec. 7.3 and 7.5: intervals that may be cars, and their spectrum
``labels``              half-lines, suspicious lines, high verticals, the class of every point
======================  ===================================================================

Thresholds and states have the names of :mod:`prc_cli.methods.sequential_angle.thresholds`. Where
the text is silent the readings are those of the stage of the same name in
:mod:`prc_cli.methods.sequential_angle`.
"""
