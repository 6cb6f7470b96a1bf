"""PLY: clouds of named properties, binary of both byte orders and text."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(
        name="PLY",
        scans=(".ply",),
        records="prc_cli.formats.ply.read:open_ply",
        has_layout=True,
        streams={".ply": "cloud, a point a cell, with line, column, range and class"},
        write_stream="prc_cli.formats.cloud_writing:CloudStream",
        labels=(".ply",),
        write_labels="prc_cli.formats.cloud_writing:open_label_writer",
        codes=(".ply",),
        open_codes="prc_cli.formats.labels.read:open_cloud_codes",
    ),
)
