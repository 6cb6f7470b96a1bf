"""E57 (ASTM E2807), organised scans in a binary container."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(
        name="E57",
        scans=(".e57",),
        images="prc_cli.formats.e57.read:open_e57",
        streams={".e57": "organised scans, relative to the scanner"},
        write_stream="prc_cli.formats.e57.write:E57Stream",
        holds=frozenset(("relative", "angles", "times", "intensity", "returns")),
    ),
)
