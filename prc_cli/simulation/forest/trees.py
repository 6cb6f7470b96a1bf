"""Trees as bodies: stems of truncated cones, branches, crowns of leaves."""

from __future__ import annotations

import numpy as np

from prc_cli.simulation.forest.parts import cones
from prc_cli.simulation.forest.stems import BREAST_HEIGHT_M, Stems
from prc_cli.simulation.world import Bodies, Material

_FOOT_M = 0.35
"""Height up to which roots widen a stem [m]."""


def stem_bodies(stems: Stems) -> Bodies:
    """Return the stems: five truncated cones each, from below the ground to the top."""
    h = stems.height
    above = [np.full(len(stems), -0.3), np.full(len(stems), _FOOT_M), np.full(len(stems), BREAST_HEIGHT_M)]
    above += [np.maximum(0.35 * h, 2.0), np.maximum(0.7 * h, 3.0), h]
    radius = stems.dbh / 2
    # the foot swells; above breast height the stem tapers slowly, in the crown fast
    widths = [1.5 * radius, 1.12 * radius, radius]
    widths += [radius * ((h - up) / (h - BREAST_HEIGHT_M)).clip(0.0) ** 0.75 for up in above[3:5]]
    widths.append(np.full(len(stems), 0.01))
    axis = np.stack([stems.axis(up) for up in above], axis=1)
    width = np.stack(widths, axis=1)
    return cones(axis[:, :-1], axis[:, 1:], width[:, :-1], width[:, 1:], Material.STEM)
