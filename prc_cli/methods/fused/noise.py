"""Noise that is told in a wider window: what is asked again after the decision."""

from __future__ import annotations

from typing import TypeAlias

from prc_cli import kernels
from prc_cli.core.classes import Label
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.classes import NEVER, CarParams, NoiseParams
from prc_cli.methods.fused.neighbours import NeighbourhoodParams, Neighbours
from prc_cli.methods.fused.plane import VOTE_LINES, WIDE_LINES, ScanPlane
from prc_cli.methods.fused.strips import StripsParams
from prc_cli.methods.fused.thresholds import AgainThresholds, NearThresholds, typed

Limits: TypeAlias = tuple[NearThresholds, AgainThresholds]


def again_limits(company: NeighbourhoodParams, noise: NoiseParams, strips: StripsParams, cars: CarParams) -> Limits:
    """Return what the loop is given; steps that are switched off get limits that no value reaches."""
    return company.thresholds(), typed(
        AgainThresholds,
        least_near=company.least,
        spike_m=noise.spike_m,
        sparse_texture=noise.sparse_share if noise.sparse else 0.0,
        sparse_shots=noise.sparse_shots,
        through_share=noise.through_share,
        low_m=noise.low_m if noise.sparse else 0.0,
        mirror_m=noise.mirror_m if noise.mirrors else NEVER,
        mirror_share=noise.mirror_share,
        alone_texture=noise.alone_share if noise.alone else NEVER,
        foot_m=strips.foot_m,
        alone_m=noise.alone_m,
        alone_gap_m=noise.alone_gap_m,
        car_label=Label.CAR if cars.named else Label.UNCLASSIFIED,
    )


@stage("noise again")
def ask_again(
    labels: tuple[U8, U8],
    range_m: F32,
    seen: Neighbours,
    above_m: F32,
    texture: F32,
    plane: ScanPlane,
    limits: Limits,
) -> U8:
    """Label noise in a wider window, and take some back; see :func:`noise_loops.noise_again`.

    ``labels`` tuple of (lines + 2, M) uint8 and (lines, M) uint8; ``range_m, above_m`` (lines + 6, M) float32, metres;
    ``texture`` (lines + 2, M) float32; returns (lines, M) uint8.
    """
    inner = slice(WIDE_LINES + VOTE_LINES, -WIDE_LINES - VOTE_LINES)
    beside = slice(VOTE_LINES, -VOTE_LINES)
    found: U8 = kernels.noise_again(
        *labels, range_m, (seen.near, seen.smooth), above_m[inner], texture[beside], plane.beams, plane.step_rad,
        *limits,
    )  # fmt: skip
    return found
