"""Constants that stages and loops share are equal; no other test checks them."""

from __future__ import annotations

from prc_cli.methods.fused import classes, ground, pipeline, plane, range_noise
from prc_cli.methods.fused import classes_loops as fused_classes
from prc_cli.methods.fused import confidence_loops as fused_confidence
from prc_cli.methods.fused import fans_loops as fused_fans
from prc_cli.methods.fused import flanks_loops as fused_flanks
from prc_cli.methods.fused import ground_loops as fused_ground
from prc_cli.methods.fused import neighbours_loops as fused_neighbours
from prc_cli.methods.fused import strips_loops as fused_strips
from prc_cli.methods.fused import texture_loops as fused_texture


def test_stages_and_loops_agree_on_what_lies_around_a_block() -> None:
    assert plane.INNER_LINES == fused_neighbours.LINES
    assert plane.WIDE_LINES == fused_strips.LINES == fused_texture.LINES == fused_classes.LINES
    assert classes.THING_LINES == fused_classes.MARGIN
    assert range_noise.PART_LINES <= pipeline.SPACED_LINES
    assert plane.INNER_LINES + plane.WIDE_LINES + plane.VOTE_LINES == plane.AROUND_LINES


def test_stages_and_loops_agree_on_places_beside_the_scanner() -> None:
    assert (ground.BINS, ground.DEPTHS) == (fused_ground.BINS, fused_ground.DEPTHS)
    assert (classes.LINES, classes.BINS) == (fused_fans.LINES, fused_fans.BINS)
    strips = (fused_strips.STRIPS, fused_strips.STRIP_M, fused_strips.SLOT_M, fused_strips.SLOTS)
    assert strips == (fused_classes.STRIPS, fused_classes.STRIP_M, fused_classes.SLOT_M, fused_classes.SLOTS)
    for loops in (fused_confidence, fused_flanks):
        assert strips[:3] == (loops.STRIPS, loops.STRIP_M, loops.SLOT_M)
        assert loops.LINES == fused_strips.LINES
    assert fused_classes.HANGS == fused_flanks.HANGS
    assert 2 * fused_classes.HALF_STRIP_M == fused_strips.STRIP_M
    # the walk reaches as far as the strips do
    assert 2 * fused_ground.BINS * fused_ground.BIN_M == fused_strips.STRIPS * fused_strips.STRIP_M
