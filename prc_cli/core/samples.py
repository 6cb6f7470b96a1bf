"""Location of the sample configurations: presets and class mappings that the program reads."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def samples_folder(package: Path = _PACKAGE) -> Path:
    """Return the folder of the sample configurations: inside an installed package, beside the package in a checkout.

    Parameters
    ----------
    package : Path
        Folder of the package.

    Examples
    --------
    >>> (samples_folder() / "urban.toml").is_file()
    True
    """
    installed = package / "sample_configs"
    return installed if installed.is_dir() else package.parent / "sample_configs"
