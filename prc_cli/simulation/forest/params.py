"""What can be chosen about a forest."""

from __future__ import annotations

from pydantic import Field, model_validator

from prc_cli.core.config import Params


class ForestSceneParams(Params):
    """A managed boreal forest with a walker's rows through it.

    The defaults are a mature mixed stand like the plot of Lehtola et al. (2019, III): rows of 40 m,
    10 m apart.
    """

    stems_per_ha: float = Field(600.0, ge=0, le=2000, description="stems per hectare")
    dbh_mean_m: float = Field(
        0.22, ge=0.1, le=0.6, description="mean diameter at breast height, 1.3 m [m]"
    )
    dbh_min_m: float = Field(
        0.08, ge=0.03, le=0.5, description="the thinnest stem [m]; thinner ones are undergrowth"
    )
    dbh_shape: float = Field(
        2.2, ge=1.0, le=10.0, description="Weibull shape of the diameters above the thinnest"
    )
    pine_share: float = Field(
        0.4, ge=0, le=1, description="pines of every pine, spruce and birch, before scaling"
    )
    spruce_share: float = Field(0.4, ge=0, le=1, description="spruces, likewise")
    birch_share: float = Field(0.2, ge=0, le=1, description="birches, likewise")
    lean_deg: float = Field(
        1.5, ge=0, le=15, description="lean of stems, root mean square [degrees]"
    )
    sweep_m: float = Field(
        0.08, ge=0, le=1, description="bow of stems halfway up, root mean square [m]"
    )
    leaf_density: float = Field(
        1.0, ge=0, le=10, description="factor on the leaf area density of all that has leaves"
    )

    slope_deg: float = Field(
        5.0, ge=0, le=30, description="slope of the terrain, root mean square [degrees]"
    )
    incline_deg: float = Field(
        0.0, ge=-30, le=30, description="rise of the whole along the rows [degrees]"
    )
    ground_step_m: float = Field(
        1.5, ge=0.25, le=3.0, description="edge of the terrain's triangles, at most [m]"
    )
    mounds_per_ha: float = Field(
        250.0, ge=0, le=5000, description="mounds and boulders per hectare"
    )

    shrubs_per_ha: float = Field(600.0, ge=0, le=10_000, description="shrubs per hectare")
    saplings_per_ha: float = Field(700.0, ge=0, le=10_000, description="young spruces per hectare")
    herbs_per_ha: float = Field(
        3500.0, ge=0, le=20_000, description="patches of dwarf shrubs and herbs per hectare"
    )
    logs_per_ha: float = Field(
        120.0, ge=0, le=5000, description="dead stems and branches on the ground per hectare"
    )
    stumps_per_ha: float = Field(150.0, ge=0, le=5000, description="stumps per hectare")

    row_length_m: float = Field(
        40.0, ge=5, le=10_000, description="length of the rows that are walked [m]"
    )
    row_spacing_m: float = Field(10.0, ge=2, le=100, description="distance between them [m]")
    wander_m: float = Field(
        0.6, ge=0, le=2, description="greatest deviation of the walker from a straight row [m]"
    )
    clearance_m: float = Field(
        1.0, ge=0.1, le=2, description="no stem comes nearer to the path than this [m]"
    )

    @model_validator(mode="after")
    def _check(self) -> ForestSceneParams:
        if self.dbh_min_m >= self.dbh_mean_m:
            problem = (
                f"found dbh_min_m {self.dbh_min_m:g}, "
                f"expected less than dbh_mean_m {self.dbh_mean_m:g}"
            )
            raise ValueError(problem)
        if self.pine_share + self.spruce_share + self.birch_share <= 0:
            problem = (
                "found no pine, no spruce and no birch, expected a share of one at least above 0"
            )
            raise ValueError(problem)
        return self


PRESETS: dict[str, ForestSceneParams] = {
    "mixed": ForestSceneParams(),
    "pine-heath": ForestSceneParams(
        stems_per_ha=450,
        dbh_mean_m=0.26,
        pine_share=0.93,
        spruce_share=0.02,
        birch_share=0.05,
        slope_deg=3,
        shrubs_per_ha=100,
        saplings_per_ha=120,
        herbs_per_ha=4500,
        logs_per_ha=50,
    ),
    "dense-spruce": ForestSceneParams(
        stems_per_ha=1000,
        dbh_mean_m=0.19,
        pine_share=0.05,
        spruce_share=0.85,
        birch_share=0.10,
        slope_deg=7,
        mounds_per_ha=500,
        shrubs_per_ha=250,
        saplings_per_ha=600,
        herbs_per_ha=3000,
        logs_per_ha=250,
    ),
}
"""Forests by name: the mature mixed stand, an open heath of pines, a thicket of spruces on stony
ground."""
