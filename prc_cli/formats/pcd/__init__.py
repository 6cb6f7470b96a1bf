"""PCD, the clouds of the Point Cloud Library: text, binary and compressed."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(
        name="PCD",
        scans=(".pcd",),
        records="prc_cli.formats.pcd.read:open_pcd",
        has_layout=True,
        streams={".pcd": "cloud, a point a cell, with line, column, range and class"},
        write_stream="prc_cli.formats.cloud_writing:CloudStream",
        labels=(".pcd",),
        write_labels="prc_cli.formats.cloud_writing:open_label_writer",
        codes=(".pcd",),
        open_codes="prc_cli.formats.labels.read:open_cloud_codes",
    ),
)
