"""Pictures of the real scans as the sequential-angle classifier sees them: range, coarse and final classes.

    python -m benchmarks.pictures FOLDER

Reads ../shared/data or $PRC_DATA. ``prc render`` draws any file in the same way.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.sequential_angle import DATA, HEADERLESS, KITTI, ORGANISED, headerless_layout, street_scan
from prc_cli.core.errors import PrcError
from prc_cli.jobs.render import RenderOptions, render


def main() -> None:
    """Draw every file that has vertical lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as name:
        layout = headerless_layout(Path(name))
        files = [(DATA / "kitti" / "000000.bin", street_scan(KITTI))]
        for source in sorted((DATA / "organised").iterdir()):
            if source.suffix in ORGANISED:
                chosen = layout if source.name == HEADERLESS else None
                files.append((source, street_scan(chosen, **ORGANISED[source.suffix])))
        files += [(path, street_scan(nadir=0.0, range_noise_m=0.01)) for path in sorted((DATA / "oakland").iterdir())]
        for source, config in files:
            output = folder / f"{source.name.partition('.')[0]}{source.suffix}.png"
            try:
                render(source, output, config, RenderOptions(steps=("range", "coarse", "classes")), overwrite=True)
            except PrcError as error:
                print(f"{source.name}: {error}")
            else:
                print(f"{source.name}: drawn")


if __name__ == "__main__":
    main()
