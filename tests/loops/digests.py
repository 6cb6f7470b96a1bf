"""What loops of our own methods give in recorded cases: ``python -m tests.loops.digests check``.

No paper describes these loops, so nothing independent says what is right: scenes by hand do
(``tests/methods``, ``tests/simulation``). Digests say that nothing changed, on the edges and ties
that scenes lack. Every case has two hexadecimal digits for its arguments,
two for the whole numbers of its outputs (labels, counts, shapes, where floats are missing), and one
sum of its floats. Sums may differ in their last digits, as sines do between machines; a case whose
arguments already differ is left out.
"""

import argparse
import json
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.loops import recorded
from tests.loops.twins import LOOPS, has_twin

NAMES = sorted(name for name in LOOPS if not has_twin(name))
"""Loops that no paper describes."""

FILE = Path(__file__).with_name("digests.json")
MANTISSA = 2.0**36
"""Steps of arguments between two powers of two."""
TOLERANCE = 1e-4
LEAST_EQUAL = 0.5
"""Least share of cases with the arguments of the machine that made the digests."""


@dataclass(frozen=True)
class Digests:
    """What is kept of the cases of one loop; no sums where no output is a float."""

    arguments: str
    outputs: str
    sums: Sequence[float]

    @property
    def n_cases(self) -> int:
        return len(self.arguments) // 2

    def of_arguments(self, number: int) -> str:
        return self.arguments[2 * number : 2 * number + 2]

    def of_outputs(self, number: int) -> tuple[str, float]:
        digits = self.outputs[2 * number : 2 * number + 2]
        return digits, self.sums[number] if self.sums else 0.0


def arrays(value: Any) -> Iterator[np.ndarray[Any, Any]]:
    """Yield what tuples of tuples hold."""
    if isinstance(value, tuple):
        for part in value:
            yield from arrays(part)
    else:
        yield np.asarray(value)


def rounded(value: Any) -> Any:
    """Round floats of double precision in arguments: the last digits of sines differ by machine."""
    if isinstance(value, tuple):
        parts = [rounded(part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        mantissa, exponent = np.frexp(value)
        return np.ldexp(np.round(mantissa * MANTISSA) / MANTISSA, exponent)
    return value


def whole_digits(values: Any, *, with_floats: bool) -> str:
    """Return two digits of shapes, types, whole numbers and missing floats, or of all numbers."""
    digest = 0
    for array in arrays(values):
        digest = zlib.crc32(f"{array.dtype} {array.shape}".encode(), digest)
        if array.dtype.kind == "f" and not with_floats:
            array = np.isnan(array)
        elif array.dtype.kind == "f":
            array = np.where(np.isnan(array), array.dtype.type(np.nan), array)  # of any sign
        digest = zlib.crc32(np.ascontiguousarray(array).tobytes(), digest)
    return f"{digest & 0xFF:02x}"


def float_sum(values: Any) -> float:
    """Return the sum of the logarithms of all floats, with weights that tell places apart."""
    total = 0.0
    for array in arrays(values):
        if array.dtype.kind == "f" and array.size:
            numbers = np.nan_to_num(array.astype(np.float64).ravel(), nan=0.5, posinf=1e30)
            weights = 1 + np.arange(array.size) % 97 / 97
            total += float((np.sign(numbers) * np.log1p(np.abs(numbers)) * weights).sum())
    return round(total, 5)


def digests(name: str) -> Digests:
    """Run a loop on its cases."""
    cases = [recorded.copied(rounded(case)) for case in recorded.cases(name)]
    arguments = [whole_digits(case, with_floats=True) for case in cases]
    outputs = [LOOPS[name](*case) for case in cases]
    sums = [float_sum(output) for output in outputs]
    return Digests(
        "".join(arguments),
        "".join(whole_digits(output, with_floats=False) for output in outputs),
        sums if any(sums) else [],
    )


def kept() -> dict[str, Digests]:
    """Return the digests of the file, by loop."""
    table = json.loads(FILE.read_text(encoding="utf-8"))
    return {name: Digests(**row) for name, row in table.items()}


def changed_cases(before: Digests, now: Digests) -> list[int]:
    """Return the numbers of the cases whose outputs changed, of those with equal arguments."""
    equal = [n for n in range(before.n_cases) if before.of_arguments(n) == now.of_arguments(n)]
    if len(equal) < LEAST_EQUAL * before.n_cases:
        return [n for n in range(before.n_cases) if n not in equal]
    return [n for n in equal if _differ(before.of_outputs(n), now.of_outputs(n))]


def _differ(before: tuple[str, float], now: tuple[str, float]) -> bool:
    return before[0] != now[0] or abs(before[1] - now[1]) > TOLERANCE


def changes(names: Sequence[str]) -> list[str]:
    """Return a line for every loop whose outputs changed."""
    table = kept()
    lines = []
    for name in names:
        changed = changed_cases(table[name], digests(name))
        if changed:
            lines.append(f"{name}: {len(changed)} cases changed, the first ones {changed[:5]}")
    return lines


def make() -> None:
    """Write the file, a line for every loop."""
    rows = [f'"{name}": {json.dumps(vars(digests(name)))}' for name in NAMES]
    FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


def main() -> int:
    """Make the digests, or check them and print what changed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("action", choices=("make", "check"))
    parser.add_argument("names", nargs="*", default=NAMES, help="loops to check")
    arguments = parser.parse_args()
    if arguments.action == "make":
        make()
        return 0
    lines = changes(arguments.names)
    sys.stdout.write("\n".join([*(lines or ["no loop changed"]), ""]))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
