"""Parts of a stream give the labels of one run, bit for bit, whatever crosses their borders."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from prc_cli.classifiers.prc.parts import BlockFacts, JoinedBlocks, PartBlocks
from prc_cli.classifiers.prc.pipeline import ParallelBlocks, PrcParams
from prc_cli.classifiers.prc.support import SupportParams, window_reach
from prc_cli.classifiers.prc.surfaces import SurfacesParams
from prc_cli.core.classes import Label
from prc_cli.core.errors import InputError
from prc_cli.core.threads import ordered
from prc_cli.core.types import F32, U8
from tests.simulated import drive_scan

NEAR, FAR = np.float32(5), np.float32(20)


def blocks_of(range_m: F32, k: int) -> list[tuple[F32, F32]]:
    """Blocks of k lines, each with more lines after it than anything looks ahead."""
    return [(range_m[i : i + k], range_m[i + k : i + k + 5]) for i in range(0, len(range_m), k)]


def label_whole(range_m: F32, params: PrcParams) -> U8:
    whole = ParallelBlocks(range_m.shape[1], params)
    return np.concatenate([
        whole.classify(whole.begin(*block))[0] for block in blocks_of(range_m, params.lines_per_block)
    ])  # fmt: skip


def facts_of(range_m: F32, params: PrcParams, first: int, stop: int, warm_up: int = 1) -> list[BlockFacts]:
    """Blocks ``first`` to ``stop`` as a part of their own."""
    k, reach = params.lines_per_block, window_reach(range_m.shape[1])
    begin = max(first - warm_up, 0)
    before = np.concatenate([np.full(reach, np.nan, np.float32), range_m[: begin * k].ravel()])[-reach:]
    part = PartBlocks(before, range_m.shape[1], params)
    found = [part.classify(part.begin(*block)) for block in blocks_of(range_m, k)[begin:stop]]
    return found[first - begin :]


def join(range_m: F32, params: PrcParams, facts: list[BlockFacts], threads: int = 1) -> tuple[U8, int]:
    joined = JoinedBlocks(range_m.shape[1], params)
    jobs = (
        joined.begin(*block, found)
        for block, found in zip(blocks_of(range_m, params.lines_per_block), facts, strict=True)
    )
    return np.concatenate(list(ordered(joined.classify, jobs, threads=threads))), joined.n_redrawn


def label_in_parts(range_m: F32, params: PrcParams, borders: list[int], warm_up: int = 1) -> tuple[U8, int]:
    """Labels by way of parts that end at these blocks, the last one first; and how many blocks were drawn again."""
    n_blocks = -(-len(range_m) // params.lines_per_block)
    bounds = sorted({0, n_blocks, *borders})
    parts = list(pairwise(bounds))
    found = {part: facts_of(range_m, params, *part, warm_up) for part in reversed(parts)}
    return join(range_m, params, [facts for part in parts for facts in found[part]])


def random_scene(rng: np.random.Generator) -> tuple[F32, PrcParams]:
    n_lines, m, k = (int(rng.integers(*limits)) for limits in ((1, 140), (1, 60), (1, 20)))
    size = int(rng.integers(3, 12))
    patches = rng.choice([5.0, 9.0, 20.0], (n_lines // size + 1, m // size + 1))
    range_m = np.repeat(np.repeat(patches, size, 0), size, 1)[:n_lines, :m] + rng.normal(0, 0.3, (n_lines, m))
    range_m[rng.random((n_lines, m)) < rng.choice([0, 0.1, 0.3])] = np.nan
    params = PrcParams(
        lines_per_block=k,
        environment=str(rng.choice(["urban", "forest"])),
        support=SupportParams(zeta_p=0.8, zeta_s=0.8),
        surfaces=SurfacesParams(area=float(rng.choice([4, 12, 30, 60])), gamma=int(rng.integers(0, 4))),
    )
    return range_m.astype(np.float32), params


@pytest.mark.parametrize("seed", range(60))
def test_random_scenes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    range_m, params = random_scene(rng)
    borders = rng.integers(0, -(-len(range_m) // params.lines_per_block) + 1, 4).tolist()
    labels, _ = label_in_parts(range_m, params, borders, warm_up=int(rng.integers(0, 3)))
    np.testing.assert_array_equal(labels, label_whole(range_m, params))


def corridor(n_lines: int, joined_lines: int, k: int) -> F32:
    """Two walls that meet at the begin and never again; in the middle block both are but stubs at its first lines."""
    image = np.full((n_lines, 40), np.nan, np.float32)
    image[:, :12] = image[:, 28:] = FAR
    image[:joined_lines] = FAR
    return image


def test_ids_shared_long_ago_make_small_pieces_smooth() -> None:
    """A part cannot know that two walls met before it: together their ends are large, apart they are small."""
    k = 10
    image = corridor(10 * k, joined_lines=k, k=k)
    image[8 * k + 2 : 9 * k] = np.nan  # block 8 holds two lines of either wall, 24 pixels each
    params = PrcParams(lines_per_block=k, surfaces=SurfacesParams(area=40.0, gamma=1))
    whole = label_whole(image, params)
    labels, n_redrawn = label_in_parts(image, params, [5])
    np.testing.assert_array_equal(labels, whole)
    assert n_redrawn == 1
    assert whole[8 * k, 5] == Label.GROUND
    # and the part alone had it wrong
    assert not facts_of(image, params, 5, 10)[3].smooth.any()


def test_ground_that_changes_late() -> None:
    """The running total of the left wall leads until the right one, which began later, has grown past it."""
    k = 10
    image = np.full((30 * k, 60), np.nan, np.float32)
    image[:, :20] = FAR
    image[12 * k :, 25:] = FAR
    params = PrcParams(lines_per_block=k)
    whole = label_whole(image, params)
    changes = np.flatnonzero(np.diff((whole[::k, 5] == Label.GROUND).astype(int)))
    assert changes.tolist() == [27], "the ground must change in the last part"
    labels, n_redrawn = label_in_parts(image, params, [3, 14, 15, 22])
    np.testing.assert_array_equal(labels, whole)
    assert n_redrawn == 0


def test_every_border_of_a_long_segment() -> None:
    k = 4
    rng = np.random.default_rng(3)
    image = np.full((11 * k - 1, 30), FAR)
    image[:, 10:14] = NEAR
    image[rng.random(image.shape) < 0.15] = np.nan
    params = PrcParams(lines_per_block=k)
    whole = label_whole(image, params)
    for border in range(12):
        np.testing.assert_array_equal(label_in_parts(image, params, [border])[0], whole)
    np.testing.assert_array_equal(label_in_parts(image, params, list(range(12)), warm_up=0)[0], whole)


def test_simulated_street() -> None:
    """Real segments cross every border, and a block of warm-up is enough for them."""
    range_m = np.concatenate([block.range_m for block in drive_scan(600, 400, seed=7).blocks()])
    params = PrcParams(lines_per_block=50)
    labels, n_redrawn = label_in_parts(range_m, params, list(range(1, 12)))
    np.testing.assert_array_equal(labels, label_whole(range_m, params))
    assert n_redrawn == 0


def test_last_part_is_one_short_block() -> None:
    params = PrcParams(lines_per_block=7)
    image = np.full((22, 9), FAR)
    labels, _ = label_in_parts(image, params, [3])
    np.testing.assert_array_equal(labels, label_whole(image, params))


@pytest.mark.parametrize("n_smooth", [252, 253, 254, 300])
def test_more_segments_than_a_byte_can_tell(n_smooth: int) -> None:
    """Surfaces of 6 x 6 shots, a missing column and line between them."""
    columns = 20
    rows = -(-n_smooth // columns)
    image = np.full((rows * 7, columns * 7), np.nan, np.float32)
    for i in range(n_smooth):
        row, column = divmod(i, columns)
        image[row * 7 : row * 7 + 6, column * 7 : column * 7 + 6] = FAR + i % 3
    params = PrcParams(lines_per_block=len(image), surfaces=SurfacesParams(area=20.0, gamma=0))
    facts = facts_of(image, params, 0, 1)
    assert len(facts[0].drawn) == n_smooth
    assert facts[0].image.dtype == (np.uint8 if n_smooth <= 253 else np.uint16)
    np.testing.assert_array_equal(join(image, params, facts)[0], label_whole(image, params))


def test_threads_change_nothing() -> None:
    range_m, params = random_scene(np.random.default_rng(12))
    n_blocks = -(-len(range_m) // params.lines_per_block)
    facts = [found for i in range(n_blocks) for found in facts_of(range_m, params, i, i + 1)]
    one, four = (join(range_m, params, facts, threads)[0] for threads in (1, 4))
    np.testing.assert_array_equal(one, four)


def test_part_of_other_lines_is_refused() -> None:
    params = PrcParams(lines_per_block=5)
    image = np.full((10, 9), FAR)
    facts = facts_of(image, params, 0, 2)
    joined = JoinedBlocks(9, params)
    with pytest.raises(InputError, match="run again"):
        joined.begin(image[:4], None, facts[0])
    with pytest.raises(InputError, match="shots before the part"):
        PartBlocks(np.zeros(3, np.float32), 9, params)
