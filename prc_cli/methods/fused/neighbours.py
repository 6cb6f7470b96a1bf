"""Neighbourhood of a shot: number of near neighbours, smoothness, and direction of the surface."""

from __future__ import annotations

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.neighbours_loops import directions, near_counts, smooth_counts
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import ChordThresholds, NearThresholds, Smoothness


@stage("company")
def near_neighbours(window_m: F32, plane: ScanPlane, limits: NearThresholds) -> U8:
    """Count the near neighbours of every shot, in its own line and two lines before and after.

    Nearness is measured in the scan plane, not in range: at grazing incidence the ranges on one
    surface differ by metres from shot to shot.
    """
    counts: U8 = near_counts(window_m, plane.sine, plane.cosine, plane.step_rad, limits)
    return counts


@stage("smoothness")
def smooth_pairs(
    window_m: F32,
    plane: ScanPlane,
    noise_m: float,
    limits: Smoothness,
) -> U8:
    """Count for every shot the pairs of neighbours on a smooth surface with it."""
    thresholds = limits.thresholds(noise_m, float(plane.step_rad))
    counts: U8 = smooth_counts(window_m, plane.sine, plane.cosine, plane.step_rad, thresholds)
    return counts


@stage("directions")
def chords(
    range_m: F32,
    smooth: U8,
    plane: ScanPlane,
    limits: ChordThresholds,
) -> tuple[U8, U8]:
    """Count the upright and the level chords through every shot."""
    upright, level = directions(range_m, smooth, plane.sine, plane.cosine, plane.step_rad, limits)
    return upright, level
