"""Pictures of the real scans as the sequential-angle classifier sees them: range, coarse and final classes.

    python -m benchmarks.pictures FOLDER

Reads ../shared/data or $PRC_DATA. The sky is at the top, but pictures that would be higher than wide lie on their side.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.sequential_angle import DATA, HEADERLESS, KITTI, ORGANISED, headerless_layout, street_scan
from prc_cli.config import LoadedConfig
from prc_cli.core.classes import Label, Surface
from prc_cli.core.errors import PrcError
from prc_cli.imaging.pictures import label_picture, range_picture, stack_pictures, write_png
from prc_cli.pipeline import label_blocks, open_stream

LABEL_OF_SURFACE = np.array(
    [Label.MISSING, Label.VEGETATION, Label.HORIZONTAL, Label.VERTICAL, Label.UNCLASSIFIED], np.uint8
)
"""Colours of the coarse classes."""
assert len(LABEL_OF_SURFACE) == len(Surface)


def draw(source: Path, config: LoadedConfig, path: Path) -> None:
    """Classify a file and draw it; of several scans the first."""
    stream = open_stream(source, config)
    items = [item for item in label_blocks(stream.blocks(), config.config.classifier) if item.block.scanner == 0]
    beam = items[0].block.beam_rad
    assert beam is not None
    ranges = np.concatenate([item.block.range_m for item in items])
    labels = np.concatenate([item.labels for item in items])
    surface = np.concatenate([item.stages.surface for item in items if item.stages is not None])
    pictures = [
        ("range", range_picture(ranges)),
        ("coarse classes", label_picture(LABEL_OF_SURFACE[surface])),
        ("classes", label_picture(labels)),
    ]
    # a single side goes from low to high or the other way round; two sides meet in the middle of the picture
    one_side = bool((beam >= 0).all() or (beam <= 0).all())
    upwards = np.argsort(-np.abs(beam), kind="stable") if one_side else np.arange(len(beam))
    upright = [(title, np.ascontiguousarray(picture[:, upwards].swapaxes(0, 1))) for title, picture in pictures]
    write_png(path, stack_pictures(upright, legend=[Label(label) for label in np.unique(labels)]))


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
        files += [(path, street_scan(range_noise_m=0.01)) for path in sorted((DATA / "oakland").iterdir())]
        for source, config in files:
            try:
                draw(source, config, folder / f"{source.name.partition('.')[0]}{source.suffix}.png")
            except PrcError as error:
                print(f"{source.name}: {error}")
            else:
                print(f"{source.name}: drawn")


if __name__ == "__main__":
    main()
