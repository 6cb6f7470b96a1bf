"""Ways to damage a file, with and without knowing its format.

The same seed makes the same damage.
"""

from __future__ import annotations

import gzip
import io
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable

import pyarrow as pa

Mutation = Callable[[bytearray, random.Random], bytearray]

NUMBERS = (
    0,
    1,
    2,
    3,
    7,
    8,
    54,
    127,
    128,
    255,
    256,
    1000,
    32767,
    32768,
    65535,
    65536,
    10**7,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**33,
    2**53,
    2**62,
    2**63 - 1,
    2**63,
    2**64 - 1,
)
FLOATS = (
    0.0,
    -0.0,
    1e-300,
    5e-324,
    1e300,
    -1e300,
    float("nan"),
    float("inf"),
    float("-inf"),
    1e19,
    -1e19,
    2.0**53,
)
WORDS = (
    b"nan",
    b"inf",
    b"-inf",
    b"1e999999",
    b"-1e999999",
    b"1e-999999",
    b"9" * 400,
    b"9" * 5000,
    b"-1",
    b"0",
    b"",
    b"0x10",
    b"1_000",
    b"\0",
    b"\xff\xfe",
    b"\xed\xa0\x80",
    b"\x1b[31m",
    b"\x1b]0;x\x07",
    b"\r",
    b"\n",
    b'"',
    b"'",
    b"#",
    b",",
    b";",
    b"\t",
    b"true",
    b"1979-05-27T07:32:00Z",
    b"[",
    b"]",
    b"{",
    b"}",
    b"=",
    b".",
    b"[" * 3000,
    b"a." * 3000,
    b"\xe2\x80\xae",
    b"\xc2\x9b",
    b"1" * 70000,
    b"," * 70000,
    b"18446744073709551616",
    b"-9223372036854775809",
    b"2147483648",
    b"1.5",
    b"10000000",
    b"9999999999",
)


def flip_bits(data: bytearray, rng: random.Random) -> bytearray:
    for _ in range(rng.choice((1, 1, 2, 8))):
        place = rng.randrange(len(data))
        data[place] ^= 1 << rng.randrange(8)
    return data


def set_bytes(data: bytearray, rng: random.Random) -> bytearray:
    for _ in range(rng.choice((1, 2, 4))):
        data[rng.randrange(len(data))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return data


def cut(data: bytearray, rng: random.Random) -> bytearray:
    return data[: rng.randrange(1, len(data) + 1)]


def cut_middle(data: bytearray, rng: random.Random) -> bytearray:
    start = rng.randrange(len(data))
    del data[start : start + rng.choice((1, 2, 4, 8, 100, 1000))]
    return data or bytearray(b"\0")


def repeat(data: bytearray, rng: random.Random) -> bytearray:
    start = rng.randrange(len(data))
    piece = data[start : start + rng.choice((1, 4, 30, 300, 3000))]
    place = rng.choice((start, rng.randrange(len(data))))
    return data[:place] + piece * rng.choice((1, 2, 50)) + data[place:]


def fill(data: bytearray, rng: random.Random) -> bytearray:
    start = rng.randrange(len(data))
    n = rng.choice((4, 16, 64, 512, 4096))
    data[start : start + n] = bytes([rng.choice((0, 0xFF, 0x20, 0x30))]) * min(n, len(data) - start)
    return data


def insert_run(data: bytearray, rng: random.Random) -> bytearray:
    place = rng.randrange(len(data) + 1)
    return (
        data[:place]
        + bytes([rng.choice((0, 0xFF, 0x0A, 0x20, 0x39))])
        * rng.choice((10, 1000, 100_000, 1_200_000))
        + data[place:]
    )


def set_number(data: bytearray, rng: random.Random) -> bytearray:
    """A number that lies, most often near the start, where headers are."""
    size, code = rng.choice(((1, "<B"), (2, "<H"), (4, "<I"), (8, "<Q"), (4, ">I"), (8, ">Q")))
    if len(data) <= size:
        return data
    place = (
        rng.randrange(min(len(data), rng.choice((64, 400, 10**9))) - size + 1)
        if len(data) > size
        else 0
    )
    value = rng.choice((*NUMBERS, len(data), rng.randrange(2 * len(data))))
    struct.pack_into(code, data, place, value % (1 << (8 * size)))
    return data


def nudge_number(data: bytearray, rng: random.Random) -> bytearray:
    size, code = rng.choice(((2, "<H"), (4, "<I"), (8, "<Q")))
    if len(data) <= size:
        return data
    place = rng.randrange(min(len(data), rng.choice((400, 10**9))) - size + 1)
    value = struct.unpack_from(code, data, place)[0] + rng.choice((-1000, -2, -1, 1, 2, 10, 1000))
    struct.pack_into(code, data, place, value % (1 << (8 * size)))
    return data


def set_float(data: bytearray, rng: random.Random) -> bytearray:
    size, code = rng.choice(((8, "<d"), (8, "<d"), (4, "<f")))
    if len(data) <= size:
        return data
    value = rng.choice(FLOATS)
    value = (
        value
        if size == 8 or abs(value) < 3e38 or value != value or abs(value) == float("inf")
        else 3e38
    )
    struct.pack_into(code, data, rng.randrange(len(data) - size), value)
    return data


def set_word(data: bytearray, rng: random.Random) -> bytearray:
    """Another word in place of a number, a name or a cell of a text."""
    words = list(re.finditer(rb"[^\s,=;\[\]{}\"':#]+", bytes(data[:200_000])))
    if not words:
        return data
    word = rng.choice(words[: rng.choice((12, 60, len(words)))])
    new = rng.choice((*WORDS, bytes(rng.choice(words).group())))
    return data[: word.start()] + new + data[word.end() :]


def insert_word(data: bytearray, rng: random.Random) -> bytearray:
    place = rng.randrange(len(data) + 1)
    return data[:place] + rng.choice(WORDS) + data[place:]


def move_line(data: bytearray, rng: random.Random) -> bytearray:
    lines = bytes(data).split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    lines.insert(rng.randrange(len(lines) + 1), line)
    if rng.random() < 0.3:
        lines.insert(rng.randrange(len(lines) + 1), line)
    return bytearray(b"\n".join(lines))


PLAIN: tuple[Mutation, ...] = (
    flip_bits,
    set_bytes,
    cut,
    cut_middle,
    repeat,
    fill,
    insert_run,
    set_number,
    set_number,
    nudge_number,
    set_float,
)
TEXT: tuple[Mutation, ...] = (
    flip_bits,
    set_bytes,
    cut,
    cut_middle,
    repeat,
    insert_run,
    set_word,
    set_word,
    set_word,
    insert_word,
    move_line,
)


def las_field(data: bytearray, rng: random.Random) -> bytearray:
    """Lie in a field of the header, of a VLR, of the laszip VLR or of the table of chunks."""
    if len(data) < 375:
        return data
    offset, code = rng.choice(
        (
            (24, "B"),
            (25, "B"),
            (94, "H"),
            (96, "I"),
            (100, "I"),
            (104, "B"),
            (105, "H"),
            (107, "I"),
            (111, "I"),
            (131, "d"),
            (139, "d"),
            (155, "d"),
            (179, "d"),
            (187, "d"),
            (227, "Q"),
            (235, "Q"),
            (243, "I"),
            (247, "Q"),
            (255, "Q"),
        )
    )
    if rng.random() < 0.5:
        vlrs = _las_vlrs(data)
        if vlrs:
            start = rng.choice(vlrs)
            offset, code = rng.choice(
                (
                    (start + 18, "H"),
                    (start + 20, "H"),
                    (start + 54 + 2 * rng.randrange(20), "H"),
                    (start + 54 + 4 * rng.randrange(8), "I"),
                )
            )
    elif rng.random() < 0.3:
        where = struct.unpack_from("<I", data, 96)[0]
        table = struct.unpack_from("<q", data, where)[0] if where + 8 < len(data) else 0
        offset, code = rng.choice(
            (
                (where, "q"),
                (max(table, 0), "I"),
                (max(table, 0) + 4, "I"),
                (len(data) - 8, "q"),
                (where + 8 + rng.randrange(80), "I"),
                (max(table, 0) + 8, "I"),
            )
        )
    size = struct.calcsize(code)
    if offset + size > len(data):
        return data
    if code == "d":
        struct.pack_into("<d", data, offset, rng.choice(FLOATS))
        return data
    old = struct.unpack_from("<" + code, data, offset)[0]
    value = rng.choice(
        (*NUMBERS, old + 1, old - 1, old * 2, len(data), len(data) - 1, rng.randrange(len(data)))
    )
    bits = 8 * size
    value %= 1 << bits
    struct.pack_into(
        "<" + code,
        data,
        offset,
        value - (1 << bits) if code == "q" and value >= 1 << (bits - 1) else value,
    )
    return data


def _las_vlrs(data: bytearray) -> list[int]:
    offset = struct.unpack_from("<H", data, 94)[0]
    records = []
    for _ in range(min(struct.unpack_from("<I", data, 100)[0], 50)):
        if offset + 54 > len(data):
            break
        records.append(offset)
        offset += 54 + struct.unpack_from("<H", data, offset + 20)[0]
    return records


def las_grow_vlr(data: bytearray, rng: random.Random) -> bytearray:
    """One more VLR, as large as they come, with a name that should not reach a terminal."""
    if len(data) < 375:
        return data
    size, start, count = (
        struct.unpack_from(code, data, offset)[0]
        for code, offset in (("<H", 94), ("<I", 96), ("<I", 100))
    )
    content = rng.choice(
        (
            b"\xff" * 65535,
            b"\x1b[2J" * 100,
            b"A" * 192 * 300,
            b"\0" * 192 * 3,
            bytes(rng.randbytes(400)),
        )
    )
    user, number = rng.choice(
        (
            (b"LASF_Spec", 4),
            (b"LASF_Projection", 2112),
            (b"LASF_Projection", 34735),
            (b"prc-cli", 1),
            (b"laszip encoded", 22204),
            (b"\x1b[31mred", 1),
        )
    )
    vlr = struct.pack("<H16sHH32s", 0, user, number, len(content), b"\x1b]0;title\x07") + content
    times = rng.choice((1, 1, 3))
    struct.pack_into("<I", data, 96, (start + times * len(vlr)) % 2**32)
    struct.pack_into("<I", data, 100, (count + times) % 2**32)
    return data[:size] + vlr * times + data[size:]


def _header(descr: str = "'<f4'", shape: str = "(14, 24)", order: str = "False") -> str:
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"


def npy_header(data: bytearray, rng: random.Random) -> bytearray:
    """Another shape, type or order in the header of an array."""
    text = rng.choice(
        (
            _header(shape=f"({rng.choice(NUMBERS)}, {rng.choice(NUMBERS)})"),
            _header(shape="(-1, 24)", order="True"),
            _header("'|O'"),
            _header("[('a', '<f4'), ('\\x1b[31m', '<f4')]", "(14,)"),
            _header("'<V0'", "(9999999999, 9999999999)"),
            _header(shape="()"),
            _header(shape="(True, 24)"),
            _header(shape="(0, 24)"),
            _header(shape="(24, 0)"),
            _header(shape="(14.0, 24)", order="1"),
            _header("('<f4', (1000000, 1000))"),
            "__import__('os').system('id')",
            "(" * 500,
            _header("'" + "<f4," * 2000 + "'", "(1,)"),
            _header("'<U1000000000'", "(1,)"),
            "9" * 9000,
            "-" * 9000,
            _header("'<f8'", "(7, 24)"),
            _header("'<i1'", "(56, 24)"),
            _header("'<f2'", "(28, 24)"),
            _header("'>f4'"),
            _header(shape="(" + "1," * 400 + "14, 24)"),
            _header(shape="(1, 336)"),
            _header(shape="(336, 1)"),
            _header(shape="(14, 24, 1)"),
            _header("'<M8[s]'", "(7, 24)"),
            _header("'<c8'", "(7, 24)"),
        )
    )
    version = rng.choice(((1, 0), (1, 0), (2, 0), (3, 0), (9, 9)))
    raw = text.encode() + b"\n"
    code = "<H" if version[0] == 1 else "<I"
    length = rng.choice((len(raw), len(raw), len(raw), 0, 2**16 - 1)) % (
        2**16 if code == "<H" else 2**32
    )
    start = 10 + (struct.unpack_from("<H", data, 8)[0] if len(data) > 10 else 0)
    return bytearray(b"\x93NUMPY" + bytes(version) + struct.pack(code, length) + raw) + data[start:]


def zip_member(data: bytearray, rng: random.Random) -> bytearray:
    """An archive with one array damaged inside, or with members that lie, doubled, or unpack to
    much."""
    try:
        with zipfile.ZipFile(io.BytesIO(bytes(data))) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:
        return data
    if not members:
        return data
    number = rng.randrange(len(members))
    name, content = members[number]
    how = rng.randrange(6)
    if how <= 2:
        mutation = rng.choice((npy_header, flip_bits, set_number, cut, fill))
        members[number] = name, bytes(mutation(bytearray(content), rng))
    elif how == 3:
        members[number] = (
            rng.choice(
                (
                    "../../evil.npy",
                    "/tmp/evil.npy",
                    "\x1b[31m.npy",
                    "a\nb.npy",
                    "x" * 3000 + ".npy",
                    ".npy",
                    "range_m.npy",
                )
            ),
            content,
        )
    elif how == 4:
        n = rng.choice((10**6, 4 * 10**6))
        head = _header(shape=f"({n // 96}, 24)") + "\n"
        members[number] = (
            name,
            b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head.encode() + bytes(n // 96 * 96),
        )
    else:
        members.pop(number)
    out = io.BytesIO()
    import warnings

    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")
        for member, inside in members:
            archive.writestr(zipfile.ZipInfo(member), inside, zipfile.ZIP_DEFLATED)
    return bytearray(out.getvalue())


def inside_gzip(data: bytearray, rng: random.Random) -> bytearray:
    """The text inside damaged, or much text in little space."""
    if rng.random() < 0.1:
        return bytearray(
            gzip.compress(
                rng.choice(
                    (b"0" * 8_000_000, b"1\n" * 2_000_000, b"\n" * 4_000_000, b"," * 4_000_000)
                ),
                mtime=0,
            )
        )
    try:
        text = gzip.decompress(bytes(data))
    except (OSError, EOFError, zlib.error):
        return data
    return bytearray(gzip.compress(bytes(rng.choice(TEXT)(bytearray(text or b"0"), rng)), mtime=0))


def inside_zstd(data: bytearray, rng: random.Random) -> bytearray:
    codec = pa.Codec("zstd")
    if rng.random() < 0.1:
        return bytearray(
            bytes(
                codec.compress(rng.choice((b"0" * 8_000_000, b"1\n" * 2_000_000, b"," * 4_000_000)))
            )
        )
    from tests.fuzz.seeds import seed

    return bytearray(bytes(codec.compress(bytes(rng.choice(TEXT)(bytearray(seed("a.csv")), rng)))))


def e57_pages(data: bytearray, rng: random.Random) -> bytearray:
    """Damage behind the checksums: they are made right again."""
    from tests.formats.organised_files import with_checksums

    damaged = rng.choice((flip_bits, set_bytes, set_number, set_number, fill, set_float))(data, rng)
    return bytearray(with_checksums(bytes(damaged)))


def e57_xml(data: bytearray, rng: random.Random) -> bytearray:
    """Another word, or a piece more than once, in the XML section; checksums and lengths right."""
    from tests.formats.organised_files import replace_xml, xml_section

    try:
        start, length = xml_section(bytes(data))
        pages = bytes(data)[start // 1024 * 1024 :]
        payload = b"".join(
            pages[page_start : page_start + 1020] for page_start in range(0, len(pages), 1024)
        )
        xml = payload[start % 1024 : start % 1024 + length]
        how = rng.randrange(4)
        if how == 0:
            entities = b"".join(
                b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10 if i else b"x")
                for i in range(12)
            )
            new = xml.replace(b"?>", b"?><!DOCTYPE e [" + entities + b"]>", 1)
        elif how == 1:
            new = bytes(
                rng.choice((flip_bits, set_bytes, repeat, cut_middle, insert_word))(
                    bytearray(xml), rng
                )
            )
        elif how == 2:
            numbers = list(re.finditer(rb">-?[0-9.e+-]+<|\"-?[0-9.e+-]+\"", xml))
            if not numbers:
                return data
            number = rng.choice(numbers)
            ends = number.group()[:1], number.group()[-1:]
            word = rng.choice(
                (
                    b"%d" % rng.choice(NUMBERS),
                    b"-%d" % rng.choice(NUMBERS),
                    b"nan",
                    b"inf",
                    b"1e999",
                    b"x",
                    b"",
                )
            )
            new = xml[: number.start()] + ends[0] + word + ends[1] + xml[number.end() :]
        else:
            new = bytes(set_word(bytearray(xml), rng))
        return bytearray(replace_xml(bytes(data), xml, new)) if new and new != xml else data
    except Exception:
        return data


def head_word(data: bytearray, rng: random.Random) -> bytearray:
    """Another word in the text before the points."""
    end = max(data.find(b"end_header"), data.find(b"\nDATA ") + 12)
    words = list(re.finditer(rb"[^\s]+", bytes(data[:end])))
    if not words:
        return data
    chosen = rng.choice(words)
    word = rng.choice(
        (
            b"%d" % rng.choice(NUMBERS),
            b"-1",
            b"nan",
            b"x",
            b"",
            b"list uchar int",
            rng.choice(words).group(),
        )
    )
    return data[: chosen.start()] + word + data[chosen.end() :]


def sbet_value(data: bytearray, rng: random.Random) -> bytearray:
    if len(data) < 136:
        return data
    place = rng.randrange(len(data) // 136) * 136 + 8 * rng.randrange(4)
    struct.pack_into("<d", data, place, rng.choice((*FLOATS, rng.uniform(-10, 10))))
    return data


MUTATIONS: dict[str, tuple[Mutation, ...]] = {
    ".las": (*PLAIN, *(las_field,) * 8, las_grow_vlr),
    ".laz": (*PLAIN, *(las_field,) * 8, las_grow_vlr),
    ".npy": (*PLAIN, npy_header, npy_header, npy_header),
    ".npz": (*PLAIN, *(zip_member,) * 6),
    ".csv": TEXT,
    ".txt": TEXT,
    ".xyz": TEXT,
    ".pts": TEXT,
    ".ply": (*PLAIN, *(head_word,) * 8),
    ".pcd": (*PLAIN, *(head_word,) * 8),
    ".ptx": TEXT,
    ".toml": TEXT,
    ".json": TEXT,
    ".npy.prc.json": TEXT,
    ".tum": TEXT,
    ".csv.gz": (flip_bits, cut, set_number, *(inside_gzip,) * 5),
    ".csv.zst": (flip_bits, cut, set_number, *(inside_zstd,) * 5),
    ".e57": (*PLAIN, *(e57_pages,) * 6, *(e57_xml,) * 8),
    ".sbet": (*PLAIN, sbet_value, sbet_value),
}
"""What is done to a file of a suffix; others get :data:`PLAIN`."""

MAX_BYTES = 16 << 20


def mutate(data: bytes, suffix: str, seed: int) -> bytes:
    """Return a damaged copy, never empty."""
    rng = random.Random(seed)
    content = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        content = rng.choice(MUTATIONS.get(suffix, PLAIN))(content or bytearray(b"\0"), rng)
    return bytes(content[:MAX_BYTES]) or b"\0"
