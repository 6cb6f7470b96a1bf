"""LAS and LAZ: headers, points, compression, new files, and rewriting with changed classes."""

from prc_cli.formats.registry import Format

LAZ = ".laz"
SUFFIXES = (".las", LAZ)

FORMATS = (
    Format(
        name="LAS",
        scans=SUFFIXES,
        records="prc_cli.formats.las.read:open_las",
        streams={".las": "point cloud", ".laz": "point cloud, compressed"},
        write_stream="prc_cli.formats.las.build:LasBuilder",
        labels=SUFFIXES,
        keeps_points=True,
        write_labels="prc_cli.formats.las.rewrite:open_label_writer",
        codes=SUFFIXES,
        open_codes="prc_cli.formats.labels:open_las_codes",
    ),
)
