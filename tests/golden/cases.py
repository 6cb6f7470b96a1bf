"""The cases: a name, and its commands. ``STEPS`` lists the commands that start with ``@``."""

import shlex
from collections.abc import Iterator
from pathlib import Path

EXIT_CODE_ONLY = ("doctor",)
"""What these print depends on the machine."""
ONE_LINE_A_FILE = 60
"""Cases of more files keep one hash for all of them."""

PRESETS = (
    "prc-2019-urban",
    "prc-2019-forest",
    "fused",
    "fused-forest",
    "street-scan",
    "street-scan-published",
)
CSV = "../made/drive.csv"
LAS = "../made/f6.las"
BARE = "../made/bare6.laz"
STREET = "../sim-street/s.npz"
M = "-M 90 --set input.angle_start=-180 --set input.angle_step=4 --set input.nadir=0"
TIMES = "--lines time:50 --columns time:4500 -M 90 --set input.time_origin=1000"
WRITABLE = (
    "bin",
    "csv",
    "csv.gz",
    "csv.zst",
    "parquet",
    "npz",
    "npy",
    "las",
    "laz",
    "ply",
    "pcd",
)
COMMANDS = (
    "info",
    "classify",
    "batch",
    "stream",
    "evaluate",
    "transfer",
    "convert",
    "render",
    "thin",
    "simulate",
    "doctor",
    "config",
    "calibrate",
    "completion",
    "demo",
    "objects",
    "batch status",
    "batch retry",
    "batch clean",
    "simulate street",
    "simulate forest",
    "simulate street-scan",
    "simulate scanners",
    "simulate parameters",
    "config show",
    "config check",
    "config schema",
)


NAMES = {
    "{CSV}": CSV,
    "{LAS}": LAS,
    "{BARE}": BARE,
    "{STREET}": STREET,
    "{M}": M,
    "{TIMES}": TIMES,
}
"""Short names in the tables."""

TABLES = Path(__file__).with_name("tables")


def all_cases() -> dict[str, list[str]]:
    """Return the commands of every case by its name."""
    cases = [case for path in sorted(TABLES.glob("*.txt")) for case in _read(path).items()]
    cases += [(name, commands.split(" ; ")) for name, commands in (*_tables(), *_damaged())]
    assert len(dict(cases)) == len(cases)
    return dict(cases)


def words_of(command: str) -> list[str]:
    """Split a command as a shell does; the lines below ``@py`` are one word."""
    first, _, program = command.partition("\n")
    return [first, program] if first == "@py" else shlex.split(command)


def programs() -> list[str]:
    """Return the Python of the cases, which ``tests/measure.py`` counts like any other."""
    commands = (words_of(command) for case in all_cases().values() for command in case)
    return [words[1] for words in commands if words[0] == "@py"]


def _read(path: Path) -> dict[str, list[str]]:
    """Read a table: a name, its commands with 4 blanks, what continues them with 8.

    A line that begins with ``#`` is a comment.
    """
    text = path.read_text(encoding="utf-8")
    for name, words in NAMES.items():
        text = text.replace(name, words)
    cases: dict[str, list[str]] = {}
    commands: list[str] = []
    for line in filter(str.strip, text.splitlines()):
        if line.startswith("#"):
            continue
        if line.startswith(" " * 8):
            commands[-1] += "\n" + line[8:]
        elif line.startswith(" " * 4):
            commands.append(line.strip())
        else:
            assert line not in cases, line
            commands = cases[line] = []
    return cases


def _tables() -> Iterator[tuple[str, str]]:
    """Yield what holds for each of a list: commands, presets, formats, values of an option."""
    for words in COMMANDS:
        yield f"help-{words.replace(' ', '-')}", f"{words} --help"
    for preset in PRESETS:
        name = preset.removeprefix("prc-2019-")
        yield (
            f"config-{name}",
            f"config show --preset {preset} ; config show --preset {preset} --json",
        )
        yield f"street-{name}", f"classify ../sim-street-laz/s.laz o.laz --preset {preset} -v"
        yield (
            f"sick-{name}",
            f"classify ../sim-sick/k.csv o.csv --preset {preset} --set output.segment_ids=true",
        )
        # a street is nothing but noise to the preset of forests
        accepted = " --accept-doubt noise-share" if name == "forest" else ""
        classified = f"classify {LAS} o.laz --preset {preset} --json{accepted}"
        yield f"las-{name}", f"{classified} ; info {LAS} --preset {preset}"
    for form in range(11):
        source = f"../made/f{form}.las"
        # formats below 6 hold half of the angle in a byte: where it is the ground that tells down,
        # they are refused
        down = (
            ""
            if form >= 6
            else f" ; classify {source} p.laz --preset fused --set input.nadir=0 --accept-doubt "
            "angle-step"
        )
        fused = f"classify {source} o.laz --preset fused{down}"
        yield (
            f"format-{form}",
            f"classify {source} o.las --preset prc-2019-forest --accept-doubt noise-share ; "
            f"{fused}",
        )
        yield (
            f"format-{form}-copy",
            f"convert {source} o.laz ; convert o.laz p.las ; info {source} --json",
        )
    for suffix in WRITABLE:
        yield f"convert-{suffix}", f"convert ../sim-sick/k.csv o.{suffix} -v"
        options = "-M 361" if suffix in ("bin", "npy") else ""
        source = f"../convert-{suffix}/o.{suffix}"
        yield (
            f"read-{suffix}",
            (
                f"info {source} {options} ; classify {source} o.npy {options} ; convert "
                f"{source} b.csv {options}"
            ),
        )
        yield f"convert-las-{suffix}", f"convert {LAS} o.{suffix} --json"
        yield (
            f"simulate-{suffix}",
            f"simulate street s.{suffix} --lines 12 --scanner sick-push-broom -q",
        )
    for suffix in ("npz", "las", "laz", "csv", "csv.gz", "parquet", "npy"):
        yield (
            f"labels-{suffix}",
            f"classify ../sim-forest/f.npz o.{suffix} --preset prc-2019-forest "
            "--set output.segment_ids=true -q",
        )
    for key, value in (
        *(("background.form", form) for form in ("literal", "abs", "guard")),
        ("support.rounding", "floor"),
        ("support.rho_c", "0.6"),
        ("support.zeta_p", "0.1"),
        ("background.d_c", "0.7"),
        ("background.alpha", "0.1"),
        ("components.min_votes", "9"),
        ("surfaces.area", "auto"),
        ("surfaces.area", "77.5"),
        ("surfaces.gamma", "5"),
        ("urban.ground", "block"),
        ("lines_per_block", "7"),
    ):
        yield f"prc-{key}-{value}", f"classify ../sim-sick/k.csv o.npy -q --set prc.{key}={value}"
    for key in ("column_step=3", "density=0.1", "noise_in_ground_columns=false"):
        yield (
            f"prc-forest-{key}",
            "classify ../sim-forest/f.npz o.npy -q --preset prc-2019-forest "
            f"--set prc.forest.{key}",
        )


def _damaged() -> Iterator[tuple[str, str]]:
    """Yield files of every format with damage.

    Cut, overwritten, of another kind; and LAS headers that lie.
    """
    read_only = {"ptx": "../made/scan.ptx", "e57": "$DATA/organised/pumpA.e57"}
    for suffix in (*WRITABLE, *read_only):
        source = read_only.get(suffix, f"../convert-{suffix}/o.{suffix}")
        m = "-M 361" if suffix in ("bin", "npy") else ""
        if suffix == "parquet":  # labels alone
            m = "; evaluate d.parquet ../sim-sick/ref.npy"
        another = "csv" if suffix == "npz" else "npz"
        last = (
            f"info d.{suffix} {m} ; classify d.{suffix} o.npy {m} ; convert d.{suffix} "
            f"o.{another} {m}"
        )
        copy = f"@cp {source} d.{suffix}"
        yield f"damaged-{suffix}-empty", f"@write d.{suffix} '' ; {last}"
        yield f"damaged-{suffix}-garbage", f"@write d.{suffix} 'one, two\\nthree\\n' ; {last}"
        yield f"damaged-{suffix}-short", f"{copy} ; @cut d.{suffix} 50 ; {last}"
        yield f"damaged-{suffix}-half", f"{copy} ; @half d.{suffix} ; {last}"
        yield f"damaged-{suffix}-magic", f"{copy} ; @poke d.{suffix} 0 585858585858 ; {last}"
        yield f"damaged-{suffix}-middle", f"{copy} ; @poke d.{suffix} 3000 {'ff00' * 40} ; {last}"
    for name, offset, data in (
        ("version", 24, "0109"),
        ("header", 94, "ffff"),
        ("header-0", 94, "0000"),
        ("offset", 96, "ffffff7f"),
        ("vlrs", 100, "ffffff7f"),
        ("format", 104, "0b"),
        ("length", 105, "0100"),
        ("length-long", 105, "ff00"),
        ("legacy", 107, "ffffffff"),
        ("scale", 131, "00" * 8),
        ("scale-nan", 131, "ff" * 8),
        ("evlr", 235, "ff" * 8),
        ("evlrs", 243, "ffffff7f"),
        ("count", 247, "ffffffffffffff00"),
        ("count-0", 247, "00" * 8),
        ("vlr-length", 395, "ffff"),
        ("guid", 8, "aa" * 16),
        ("words", 26, "fcfdfeff" * 16),
        ("bounds", 179, "7f" * 48),
    ):
        for suffix, source in (("las", LAS), ("laz", BARE)):
            options = "" if suffix == "las" else "--range origin:650000,6860000,0"
            last = (
                f"info d.{suffix} {options} ; classify d.{suffix} o.laz {options} ; convert "
                f"d.{suffix} o.las"
            )
            yield (
                f"lying-{suffix}-{name}",
                f"@cp {source} d.{suffix} ; @poke d.{suffix} {offset} {data} ; {last}",
            )
