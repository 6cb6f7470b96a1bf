"""Curbs: steep steps between two pieces of ground."""

from __future__ import annotations

from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import CurbThresholds, typed


class CurbParams(Params):
    """Curbs: steep steps between two pieces of ground (``[fused.curbs]``)."""

    enabled: bool = Field(True, description="whether to find them; otherwise they are ground, or what they look like")
    least_m: float = Field(0.05, gt=0, le=10, description="least height [m]")
    most_m: float = Field(0.25, gt=0, le=10, description="greatest height [m]")
    reach_m: float = Field(
        0.4, gt=0, le=10, description="the heights of the ground up to this far before and beyond are compared [m]"
    )
    half_width_m: float = Field(0.08, gt=0, le=10, description="half width of the face [m]")
    share: float = Field(0.6, ge=0, le=1, description="least share of the rise that is within the face")
    margin: float = Field(0.15, ge=0, le=0.5, description="shots nearer to foot or top than this share are ground")

    steep: float = Field(
        1.5, ge=0, le=4, description="on a face the line climbs this many column spacings in four columns"
    )

    def thresholds(self) -> CurbThresholds:
        """Return what the loop is given."""
        return typed(
            CurbThresholds,
            least_m=self.least_m,
            most_m=self.most_m,
            reach_m=self.reach_m,
            half_m=self.half_width_m,
            share=self.share,
            margin=self.margin,
            steep=self.steep,
        )


@stage("curbs")
def find_curbs(labels: U8, range_m: F32, above_m: F32, plane: ScanPlane, params: CurbParams) -> U8:
    """Label the faces of curbs; see :func:`curbs_loops.curb_labels`."""
    if not params.enabled:
        return labels
    found: U8 = kernels.curb_labels(labels, range_m, above_m, plane.beams, plane.step_rad, params.thresholds())
    return found
