"""Tables: arrays and Parquet read by column; CSV and Parquet written by row."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(
        name="Parquet",
        columns="prc_cli.formats.tables.read:ParquetTable",
        streams={".parquet": "table, for other programs: prc reads no stream from it"},
        write_stream="prc_cli.formats.tables.write:ParquetStream",
        labels=(".parquet",),
        write_labels="prc_cli.formats.labels:LabelFileWriter",
        codes=(".parquet",),
        open_codes="prc_cli.formats.tables.codes:open_parquet_codes",
    ),
)
