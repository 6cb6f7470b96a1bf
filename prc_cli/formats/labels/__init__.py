"""Class codes in record order: read out of any file that carries them, written as files of their own."""

from prc_cli.formats.registry import Format

KITTI_SUFFIX = ".label"
FORMATS = (
    Format(
        name="SemanticKITTI labels", codes=(KITTI_SUFFIX,), open_codes="prc_cli.formats.labels.read:open_semantic_codes"
    ),
)
