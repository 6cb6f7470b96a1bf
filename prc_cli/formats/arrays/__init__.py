"""Range images as NumPy arrays (``.npy``, ``.npz``)."""

from prc_cli.formats.registry import Format

_IMAGES = "prc_cli.formats.arrays.read:ArrayStream"
_COLUMNS = "prc_cli.formats.tables.read:ArrayTable"
_CODES = "prc_cli.formats.arrays.codes:open_array_codes"

FORMATS = (
    Format(
        name="NumPy array",
        scans=(".npy",),
        images=_IMAGES,
        columns=_COLUMNS,
        streams={".npy": "range image alone"},
        write_stream="prc_cli.formats.arrays.write:NpyStream",
        holds=frozenset(),
        labels=(".npy",),
        write_labels="prc_cli.formats.labels:LabelFileWriter",
        codes=(".npy",),
        open_codes=_CODES,
    ),
    Format(
        name="NumPy archive",
        scans=(".npz",),
        images=_IMAGES,
        columns=_COLUMNS,
        streams={".npz": "range image with angles, times, coordinates, intensities and classes"},
        write_stream="prc_cli.formats.arrays.write:NpzStream",
        holds=frozenset(("codes", "relative", "angles", "times", "intensity")),
        codes=(".npz",),
        open_codes=_CODES,
    ),
)
