"""PLY, and PCD of the Point Cloud Library: clouds of named properties."""

from prc_cli.formats.registry import Format

FORMATS = tuple(
    Format(
        name=name,
        scans=(suffix,),
        records=opener,
        has_layout=True,
        streams={suffix: "cloud, a point a cell, with line, column, range and class"},
        write_stream="prc_cli.formats.clouds.write:CloudWriter",
        labels=(suffix,),
        keeps_points=True,
        write_labels="prc_cli.formats.clouds.write:open_label_writer",
        codes=(suffix,),
        open_codes="prc_cli.formats.labels:open_record_codes",
    )
    for name, suffix, opener in (
        ("PLY", ".ply", "prc_cli.formats.clouds.ply:open_ply"),
        ("PCD", ".pcd", "prc_cli.formats.clouds.pcd:open_pcd"),
    )
)
