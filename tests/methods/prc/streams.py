"""Streams with many ties, and conversion of parameters to those of the oracle."""

from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, I64, U8
from prc_cli.methods.base import Wanted
from prc_cli.methods.prc.pipeline import Prc, PrcParams
from prc_cli.methods.prc.surfaces import area_threshold
from prc_cli.methods.run import run_blocks
from tests.methods.prc.paper import Settings


def run_stream(
    range_m: F32, params: PrcParams, threads: int = 1, *, segments: bool = True
) -> tuple[U8, I64]:
    """Labels and segments of a whole stream."""
    blocks = iter([ScanBlock(0, range_m)])
    wanted = Wanted(segments=segments)
    items = list(run_blocks(blocks, Prc(params), threads=threads, wanted=wanted))
    assert all((item.segments is None) != segments for item in items)
    return np.concatenate([item.labels for item in items]), np.concatenate(
        [item.labels if item.segments is None else item.segments for item in items]
    )


def to_settings(params: PrcParams, points_per_line: int) -> Settings:
    """Parameters under the oracle's names."""
    k = params.lines_per_block
    return Settings(
        k=k,
        environment=params.environment,
        zeta_s=params.support.zeta_s,
        zeta_p=params.support.zeta_p,
        rho_c=params.support.rho_c,
        rounding=params.support.rounding,
        form=params.background.form,
        alpha=params.background.alpha,
        d_c=params.background.d_c,
        min_votes=params.components.min_votes,
        forks=params.components.forks,
        area=area_threshold(params.surfaces, k, k, points_per_line),
        gamma=params.surfaces.gamma,
        ground=params.urban.ground,
        column_step=params.forest.column_step,
        density=params.forest.density,
        noise_in_ground_columns=params.forest.noise_in_ground_columns,
    )


def pick(rng: Generator, *values: Any) -> Any:
    return values[rng.integers(len(values))]


def random_params(rng: Generator) -> PrcParams:
    """Parameters at which small streams show everything: every option, small areas, few votes."""
    return PrcParams.model_validate(
        {
            "lines_per_block": pick(rng, 1, 2, 3, 5, 8, 99),
            "environment": pick(rng, "urban", "forest"),
            "support": {
                "zeta_s": pick(rng, 1.0, 0.5, 0.1, 0.01, 1e9),
                "zeta_p": pick(rng, 1.0, 0.5, 0.1, 0.01, 0.0625),
                "rho_c": pick(rng, 1 / 3, 1 / 3, 0.25, 0.5, 0.1),
                "rounding": pick(rng, "ceil", "floor"),
            },
            "background": {
                "form": pick(rng, "centred", "centred", "literal", "abs", "guard"),
                "alpha": pick(rng, 0.3, 0.25),
                "d_c": pick(rng, 0.05, 0.0625, 1.0),
            },
            "components": {
                "min_votes": pick(rng, 1, 2, 3),
                "forks": pick(rng, "all", "largest"),
            },
            "surfaces": {
                "area": pick(rng, 1, 3, 7.5, 12, 30, "auto"),
                "gamma": pick(rng, 0, 1, 2, 3),
            },
            "urban": {"ground": pick(rng, "running-total", "block")},
            "forest": {
                "column_step": pick(rng, 1, 3, 10),
                "density": pick(rng, 1 / 3, 0.5, 0.0),
                "noise_in_ground_columns": pick(rng, True, False),
            },
        }
    )


def random_stream(rng: Generator) -> F32:
    """Patches at a few ranges, ramps, strays and gaps, on a grid of 1/1000 or 1/16 m, some lines
    without returns."""
    n_lines = int(rng.integers(1, 22))
    width = int(pick(rng, 1, 2, 3, 4, 5, 8, 17, 33))
    grid = pick(rng, 0.001, 0.0625)
    levels = np.array([5.0, 5.5, 6.0, 8.0, 5.1])
    patch = (int(rng.integers(1, 6)), int(rng.integers(1, 9)))
    coarse = rng.integers(len(levels), size=(-(-n_lines // patch[0]), -(-width // patch[1])))
    image = levels[np.kron(coarse, np.ones(patch, dtype=int))[:n_lines, :width]]
    image += grid * np.arange(width) * pick(rng, 0, 0, 1, -1, 20)
    image += grid * rng.integers(-2, 3, image.shape) * pick(rng, 0, 1, 4)
    strays = rng.random(image.shape) < pick(rng, 0.0, 0.05, 0.3)
    image[strays] = rng.integers(1, 100, np.count_nonzero(strays)) * 0.5
    image[rng.random(image.shape) < pick(rng, 0.0, 0.05, 0.4)] = np.nan
    image[rng.random(n_lines) < pick(rng, 0.0, 0.0, 0.2)] = np.nan
    stream: F32 = image.astype(np.float32)
    return stream
