"""Location of the sample configurations: presets and class mappings that the program reads."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def samples_folder(package: Path = _PACKAGE) -> Path:
    """Return the folder of the sample configurations: inside an installed package, beside the package in a checkout."""
    installed = package / "sample_configs"
    return installed if installed.is_dir() else package.parent / "sample_configs"


def or_sample(path: Path) -> Path:
    """Return a file, or where there is none the sample configuration of this name.

    >>> or_sample(Path("kitti_frame.toml")).is_file(), or_sample(Path("no_sample.toml")).is_file()
    (True, False)
    """
    if path.exists() or path.is_absolute() or ".." in path.parts:
        return path
    own = path.relative_to("sample_configs") if path.parts[:1] == ("sample_configs",) else path
    sample = samples_folder() / own
    return sample if sample.is_file() else path
