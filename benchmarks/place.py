"""How often the place is told: street or forest, asked by what is taken where no method is named.

``python -m benchmarks.place [--seed N]``

Every 64 lines of simulated streets and forests (the held-out scans of
:mod:`benchmarks.trust_scans`: seeds, scanners and mountings that chose no limit), of the Oakland
strips, the RIEGL strip and the park are asked. Down is told."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator

import numpy as np

from benchmarks import contest_data as data
from benchmarks.trust_scans import sources
from prc_cli.core.types import F32, F64
from prc_cli.streams.evidence.place import SAMPLE_LINES, place_of

PARK = "forest/tls_park.npz"
TURN = 2 * np.pi


def scans(seed: int) -> Iterator[tuple[str, str, F32, F64]]:
    """Yield name, true kind, ranges [m] and beam angles from straight down [rad] of every scan."""
    for source in sources("held-out", seed):
        scan = source.make()
        yield (
            source.name,
            "forest" if scan.mapping == "forest" else "street",
            scan.range_m,
            scan.angle_rad,
        )
    if (data.DATA / "oakland").exists():
        scan = data.oakland(1)
        yield "Oakland strip 1", "street", scan.range_m, scan.angle_rad
    if (data.DATA / PARK).exists():
        with np.load(data.DATA / PARK) as park:
            yield (
                "park (VZ-400i)",
                "park",
                park["range_m"],
                np.pi - np.deg2rad(park["zenith_deg"].astype(np.float64)),
            )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.place", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="other worlds")
    seed = parser.parse_args().seed
    total: Counter[tuple[str, str]] = Counter()
    print("| scan | street | forest | not told |\n|---|---:|---:|---:|")
    for name, true, range_m, angle_rad in scans(seed):
        beam = np.pi - np.remainder(np.pi - angle_rad.astype(np.float64), TURN)
        starts = range(0, max(len(range_m) - SAMPLE_LINES, 0) + 1, SAMPLE_LINES)
        places = Counter(place_of(range_m[a : a + SAMPLE_LINES], beam).kind for a in starts)
        total.update({(true, kind): n for kind, n in places.items()})
        print(
            f"| {name} | {places['street']} | {places['forest']} | {places['unknown']} |",
            flush=True,
        )
    for true in ("street", "forest", "park"):
        row = " | ".join(str(total[true, kind]) for kind in ("street", "forest", "unknown"))
        print(f"| **all: {true}** | {row} |")


if __name__ == "__main__":
    main()
