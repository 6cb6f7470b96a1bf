"""Raw dumps of fixed-size records."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(
        name="raw dump",
        scans=(".bin", ".raw", ".dat"),
        records="prc_cli.formats.raw_binary.read:open_dump",
        has_layout=True,
        is_dump=True,
        streams={".bin": "raw dump, with a configuration beside it that reads it"},
        write_stream="prc_cli.formats.raw_binary.write:open_stream",
        holds=frozenset(("codes", "registered", "relative", "angles", "times", "intensity")),
    ),
)
