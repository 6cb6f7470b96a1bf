"""Text files of one record a row, plain or compressed."""

from prc_cli.formats.registry import Format

_TABLE = (".csv", ".csv.gz", ".csv.zst")
_TEXT = "prc_cli.formats.text.read:TextSource"

FORMATS = (
    Format(
        name="text",
        scans=(*_TABLE, ".txt", ".txt.gz", ".txt.zst"),
        records=_TEXT,
        has_layout=True,
        streams=dict(
            zip(_TABLE, ("table, a row a cell", *("table, compressed",) * 2), strict=True)
        ),
        write_stream="prc_cli.formats.tables.write:CsvStream",
        labels=(".csv",),
        write_labels="prc_cli.formats.labels:LabelFileWriter",
        codes=(*_TABLE, ".txt", ".txt.gz", ".txt.zst"),
        open_codes="prc_cli.formats.text.codes:open_text_codes",
    ),
    Format(name="bare coordinates", scans=(".xyz", ".asc", ".pts"), records=_TEXT, has_layout=True),
)
