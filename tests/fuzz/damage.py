"""Ways to damage a file as a strategy of hypothesis, which finds the least damage that fails."""

import gzip
import io
import re
import struct
import warnings
import zipfile
from collections.abc import Callable

import pyarrow as pa
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from tests.formats.organised_files import replace_xml, with_checksums, xml_section

Damage = Callable[[DrawFn, bytes], bytes]

NUMBERS = (0, 1, 2, 7, 54, 127, 128, 255, 32767, 65535, 65536, 10**7)
NUMBERS += tuple(2**power + step for power in (31, 32, 53, 62, 63) for step in (-1, 0))
FLOATS = (0.0, -0.0, 5e-324, 1e300, float("nan"), float("inf"), float("-inf"), 1e19, 2.0**53)
WORDS = b"nan inf -inf 1e999999 -1 0 0x10 1_000 true [ ] { } = . , ; \" ' # 1.5 9999999999".split()
WORDS += [b"", b"\0", b"\n", b"\xff\xfe", b"\x1b]0;x\x07", b"\xe2\x80\xae", b"\xc2\x9b", b"\0" * 64]
WORDS += [b"9" * 5000, b"[" * 3000, b"a." * 3000, b"," * 70_000, b"\xff" * 1_200_000]
CODES = ("<B", "<H", "<I", "<Q", ">I", ">Q")
HEADERS = [
    f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"
    for descr, shape in (
        *(("'<f4'", shape) for shape in ("(-1, 24)", "()", "(0, 24)", "(14.0, 24)", "(14, 24, 1)")),
        *((f"'{kind}'", "(7, 24)") for kind in ("|O", "<f8", ">f4", "<M8[s]", "<c8", "<U1000000")),
        ("'<V0'", "(9999999999, 9999999999)"),
        ("[('a', '<f4'), ('\\x1b[31m', '<f4')]", "(14,)"),
        ("('<f4', (1000000, 1000))", "(14, 24)"),
    )
]
HEADERS += ["__import__('os').system('id')", "(" * 500, "9" * 9000]
LAS_FIELDS = (24, 25, 94, 96, 100, 104, 105, 107, 111, 131, 155, 179, 227, 235, 243, 247, 255)
"""First bytes of fields of the header of a LAS file."""
MAX_BYTES = 16 << 20


def cut(draw: DrawFn, data: bytes) -> bytes:
    return data[: draw(st.integers(1, len(data)))]


def edit(draw: DrawFn, data: bytes) -> bytes:
    """Bytes that are lost, doubled or replaced."""
    start = draw(st.integers(0, len(data) - 1))
    end = start + draw(st.sampled_from((0, 1, 4, 30, 300, 3000)))
    new = st.sampled_from([*WORDS, data[start:end] * 2]) | st.binary(min_size=1, max_size=8)
    return data[:start] + draw(new) + data[end:]


def put(data: bytes, start: int, field: bytes) -> bytes:
    return data[:start] + field + data[start + len(field) :]


def number_in(draw: DrawFn, data: bytes, starts: st.SearchStrategy[int]) -> bytes:
    """A number that lies, or is off by a little."""
    start = draw(starts)
    code = draw(st.sampled_from(CODES))
    size = struct.calcsize(code)
    if start + size > len(data):
        return data
    (old,) = struct.unpack_from(code, data, start)
    value = draw(st.sampled_from((*NUMBERS, len(data), old + 1, old - 1, 2 * old)))
    return put(data, start, struct.pack(code, value % (1 << 8 * size)))


def number(draw: DrawFn, data: bytes) -> bytes:
    """Most often near the start, where headers are."""
    end = draw(st.sampled_from((64, 400, len(data))))
    return number_in(draw, data, st.integers(0, min(end, len(data)) - 1))


def real(draw: DrawFn, data: bytes) -> bytes:
    start = draw(st.integers(0, len(data) - 1))
    field = struct.pack("<d", draw(st.sampled_from(FLOATS)))
    return put(data, start, field[: len(data) - start])


def word(draw: DrawFn, data: bytes) -> bytes:
    """Another word in place of a number, a name or a cell of a text."""
    words = list(re.finditer(rb"[^\s,=;\[\]{}\"':#]+", data[:20_000]))
    if not words:
        return data
    chosen = draw(st.sampled_from(words[: draw(st.sampled_from((12, 60, len(words))))]))
    new = draw(st.sampled_from([*WORDS, *(match.group() for match in words[:12])]))
    return data[: chosen.start()] + new + data[chosen.end() :]


def line(draw: DrawFn, data: bytes) -> bytes:
    """A line in another place."""
    lines = data.split(b"\n")
    moved = lines.pop(draw(st.integers(0, len(lines) - 1)))
    lines.insert(draw(st.integers(0, len(lines))), moved)
    return b"\n".join(lines)


def las_field(draw: DrawFn, data: bytes) -> bytes:
    """A field of the header, of the first VLRs, or before and behind the points."""
    if len(data) < 375:
        return data
    size, points = struct.unpack_from("<HI", data, 94)
    starts = (*LAS_FIELDS, *range(size + 18, size + 126, 2), *range(points, points + 80, 4))
    return number_in(draw, data, st.sampled_from((*starts, len(data) - 8)))


def array_header(draw: DrawFn, data: bytes) -> bytes:
    """Another shape, type or order of an array."""
    text = draw(st.sampled_from(HEADERS)).encode() + b"\n"
    start = 10 + struct.unpack_from("<H", data, 8)[0] if len(data) > 10 else 0
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text + data[start:]


def archive_member(draw: DrawFn, data: bytes) -> bytes:
    """An archive with one array damaged inside, renamed, doubled or lost."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return data
    name, content = members.pop(draw(st.integers(0, len(members) - 1)))
    names = ("../../evil.npy", "\x1b[31m.npy", "x" * 3000 + ".npy", ".npy", "range_m.npy")
    if draw(st.booleans()):
        members.append((draw(st.sampled_from((name, *names))), content))
    else:
        members.append((name, draw(st.sampled_from((array_header, edit, number)))(draw, content)))
    out = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")
        for member, inside in members:
            archive.writestr(member, inside)
    return out.getvalue()


def inside_gzip(draw: DrawFn, data: bytes) -> bytes:
    """The text inside damaged, or much text in little space."""
    try:
        text = gzip.decompress(data)
    except (OSError, EOFError, ValueError):
        return data
    bombs = st.sampled_from((b"0" * 8_000_000, b"\n" * 4_000_000, b"," * 4_000_000))
    content = draw(bombs) if draw(st.integers(0, 9)) == 9 else word(draw, text)
    return gzip.compress(content, mtime=0)


def inside_zstd(draw: DrawFn, data: bytes) -> bytes:
    from tests.fuzz.seeds import seed

    return bytes(pa.Codec("zstd").compress(word(draw, seed("a.csv"))))


def e57_pages(draw: DrawFn, data: bytes) -> bytes:
    """Damage behind the checksums: they are made right again."""
    return with_checksums(draw(st.sampled_from((number, real)))(draw, data))


def e57_xml(draw: DrawFn, data: bytes) -> bytes:
    """Another word in the XML section, or entities that grow; checksums and lengths are right."""
    start, length = xml_section(data)
    pages = data[start // 1024 * 1024 :]
    payload = b"".join(pages[first : first + 1020] for first in range(0, len(pages), 1024))
    xml = payload[start % 1024 : start % 1024 + length]
    entities = (
        b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10 if i else b"x") for i in range(9)
    )
    bomb = xml.replace(b"?>", b"?><!DOCTYPE e [" + b"".join(entities) + b"]>", 1)
    new = bomb if draw(st.integers(0, 9)) == 9 else word(draw, xml)
    return replace_xml(data, xml, new) if new and new != xml else data


PLAIN: tuple[Damage, ...] = (cut, edit, number, real)
TEXT: tuple[Damage, ...] = (cut, edit, word, word, line)
DAMAGES: dict[str, tuple[Damage, ...]] = {
    ".las": (*PLAIN, las_field, las_field),
    ".laz": (*PLAIN, las_field, las_field),
    ".npy": (*PLAIN, array_header),
    ".npz": (*PLAIN, archive_member, archive_member),
    ".ply": (*PLAIN, word, word),
    ".pcd": (*PLAIN, word, word),
    ".csv.gz": (cut, edit, inside_gzip, inside_gzip),
    ".csv.zst": (cut, edit, inside_zstd, inside_zstd),
    ".e57": (*PLAIN, e57_pages),
    **dict.fromkeys(
        [".csv", ".txt", ".xyz", ".pts", ".ptx", ".toml", ".json", ".npy.prc.json", ".tum"], TEXT
    ),
}
"""What is done to a file of a suffix; others get :data:`PLAIN`."""


@st.composite
def damaged(draw: DrawFn, data: bytes, suffix: str) -> bytes:
    """Return a damaged copy, never empty."""
    if suffix == ".e57" and draw(st.booleans()):
        return e57_xml(draw, data)
    for damage in draw(
        st.lists(st.sampled_from(DAMAGES.get(suffix, PLAIN)), min_size=1, max_size=3)
    ):
        data = damage(draw, data)[:MAX_BYTES] or b"\0"
    return data
