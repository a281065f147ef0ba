"""Reads the image that somebody's program wrote, PPM or PNG, and says what is wrong with it."""

from __future__ import annotations

import io
import re
import struct
import zlib
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from validation.terminal import counted

#: Levels of an image up to a maximum of 255, or of 65535.
Levels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

#: What files begin with; those of the first two kinds are read.
KINDS = (
    ("PPM", re.compile(rb"P[36](?=[\s#]|$)")),
    ("PNG", re.compile(rb"\x89PNG\r\n\x1a\n")),
    ("PBM (P1 or P4, black and white)", re.compile(rb"P[14](?=[\s#]|$)")),
    ("PGM (P2 or P5, grey)", re.compile(rb"P[25](?=[\s#]|$)")),
    ("PAM (P7)", re.compile(rb"P7(?=\s|$)")),
    ("PFM", re.compile(rb"P[Ff](?=\s|$)")),
    ("BMP", re.compile(rb"BM.{12}", re.DOTALL)),
    ("JPEG", re.compile(rb"\xff\xd8\xff")),
    ("GIF", re.compile(rb"GIF8[79]a")),
    ("TIFF", re.compile(rb"II\*\0|MM\0\*")),
    ("WebP", re.compile(rb"RIFF....WEBP", re.DOTALL)),
    ("OpenEXR", re.compile(rb"v/1\x01")),
    ("Radiance HDR", re.compile(rb"#\?R")),
    ("text in UTF-16", re.compile(rb"\xff\xfe|\xfe\xff")),
)
READ = ("PPM", "PNG")

#: A header with its comments ends within so many bytes.
LONGEST_HEADER = 1 << 16
#: Samples written as text are read in pieces of so many bytes, so that memory does not grow with the file.
PIECE = 1 << 22
LARGEST_MAXIMUM = 65535

CHANNELS = ("red", "green", "blue")
FORMATS = "PPM (P3 or P6) and PNG are read"
UNCLOSED = "does the program close its file, and write every row, before it ends?"

#: Samples of a pixel, and the bits that one may have, by the colour type of a PNG.
PNG_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
PNG_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
#: Where the passes of an interlaced PNG begin and how far their pixels are apart: columns, then rows.
ADAM7 = ((0, 8, 0, 8), (4, 8, 0, 8), (0, 4, 4, 8), (2, 4, 0, 4), (0, 2, 2, 4), (1, 2, 0, 2), (0, 1, 1, 2))


class ImageError(ValueError):
    """The bytes are not the image that was expected: one sentence, and a hint or ""."""

    def __init__(self, message: str, hint: str = "") -> None:
        """`message` says what is wrong and where, `hint` what to do."""
        super().__init__(message)
        self.message = message
        self.hint = hint


@dataclass(frozen=True)
class Image:
    """Levels from 0 to `steps`, an array (rows, columns, 3) with row 0 at the top."""

    levels: Levels
    steps: int


def kind(data: bytes) -> str:
    """What the bytes seem to be: "PPM" and "PNG" can be read; "" if they look like no image."""
    return next((name for name, begins in KINDS if begins.match(data)), "")


def decode(data: bytes, size: tuple[int, int]) -> Image:
    """The image in these bytes, which has to have that many columns and rows; no more memory is taken than for that.

    Raises:
        ImageError: it is none, or another one.
    """
    if not data:
        raise ImageError("it is empty", UNCLOSED)
    found = kind(data)
    if found == "PPM":
        return _ppm(data, size)
    if found == "PNG":
        return _png(data, size)
    if found:
        raise ImageError(f"it is {found}, no image that can be read", FORMATS)
    if kind(data[:64].removeprefix(b"\xef\xbb\xbf").lstrip()) in READ:
        raise ImageError(f"it begins with {_show(data[:4])}: nothing may stand before an image", FORMATS)
    if re.match(rb"P[36]", data):
        raise ImageError(f"white space is expected after {_show(data[:2])}, found {_show(data[2:3])}", FORMATS)
    text = re.fullmatch(rb"[\t\n\f\r -~]+", data[:256])
    raise ImageError(f"it is no image: it begins with {'the text ' * bool(text)}{_show(data)}", FORMATS)


def ppm_size(data: bytes) -> tuple[int, int]:
    """Columns and rows that a PPM file says it has.

    Raises:
        ImageError: its header is wrong, or it is another kind of file.
    """
    if kind(data) != "PPM":
        raise ImageError(f"it is {kind(data) or 'no image'}, expected PPM", FORMATS)
    columns, rows = _header(data)[0]
    if data.startswith(b"P3") and 3 * columns * rows > len(data):
        # Before there is memory for it.
        raise ImageError(f"it is too short for {columns}x{rows} pixels", UNCLOSED)
    return columns, rows


def _show(raw: bytes, most: int = 24) -> str:
    """Bytes in quotation marks, others than printable ones escaped."""
    return repr(raw[:most])[1:] + "..." * (len(raw) > most)


def _check_size(found: tuple[int, int], size: tuple[int, int]) -> None:
    """Whether the image has the size of the scene, before there is memory for it."""
    if 0 in found:
        raise ImageError(f"the image is {found[0]}x{found[1]}: it has no pixels", "the header says columns, then rows")
    if found != size:
        swapped = found == (size[1], size[0])
        hint = "columns and rows are swapped: columns come first" if swapped else "RES says columns, then rows"
        raise ImageError(f"the image is {found[0]}x{found[1]}, the scene asks for {size[0]}x{size[1]}", hint)


def _pixel(sample: int, size: tuple[int, int]) -> str:
    """A sample in words."""
    row, column = divmod(sample // 3, size[0])
    return f"{CHANNELS[sample % 3]} of column {column}, row {row}"


def _ends_after(pixels: int, size: tuple[int, int], hint: str = UNCLOSED) -> ImageError:
    return ImageError(f"it ends after pixel {pixels} of {size[0] * size[1]}", hint)


def _follow(count: int) -> str:
    return "1 byte follows" if count == 1 else f"{count} bytes follow"


# ---- PPM


def _header(data: bytes) -> tuple[tuple[int, int], int, int]:
    """Columns and rows, the maximum, and where the white space after it begins.

    A comment goes from # to the end of its line.
    """
    head, at, numbers = data[:LONGEST_HEADER], 2, []
    for name in ("number of columns", "number of rows", "maximum"):
        while head[at : at + 1].isspace() or head[at : at + 1] == b"#":
            at = _end(rb"#[^\n\r]*|\s+", head, at)
        word = head[at : _end(rb"[^\s#]*", head, at)]
        at += len(word)
        if at >= len(head) and len(data) > len(head):
            raise ImageError(f"its header does not end within {LONGEST_HEADER} bytes", "shorten the comments")
        if at >= len(head):
            raise ImageError(f"it ends within the header, before or in the {name}", UNCLOSED)
        if not word.isdigit():
            hint = "a header is P3 or P6, columns, rows and the maximum, in decimal digits"
            raise ImageError(f"the {name} in its header is {_show(word)}, which is no number", hint)
        if len(word) > 9:
            raise ImageError(f"the {name} in its header is {_show(word)}, larger than any image's")
        numbers.append(int(word))
    columns, rows, maximum = numbers
    return (columns, rows), maximum, at


def _end(pattern: bytes, data: bytes, at: int) -> int:
    """Where what fits the pattern, from there on, ends."""
    match = re.compile(pattern).match(data, at)
    return match.end() if match else at


def _ppm(data: bytes, size: tuple[int, int]) -> Image:
    found, maximum, at = _header(data)
    _check_size(found, size)
    if not 1 <= maximum <= LARGEST_MAXIMUM:
        raise ImageError(f"the maximum in its header is {maximum}, expected 1 to {LARGEST_MAXIMUM}", "the usual is 255")
    levels = (_plain if data.startswith(b"P3") else _raw)(data, at, size, maximum)
    return Image(levels.reshape(size[1], size[0], 3), maximum)


def _raw(data: bytes, at: int, size: tuple[int, int], maximum: int) -> Levels:
    """The samples of a P6 file, one or two bytes each, after one byte of white space."""
    if data[at : at + 1] == b"#":
        at = _end(rb"[^\n\r]*", data, at)
    start = at + 1
    width = 1 if maximum < 256 else 2
    count = 3 * size[0] * size[1]
    need, have = width * count, len(data) - start
    numbers_hint = "the samples are numbers as text: the header of such a file says P3"
    as_text = re.fullmatch(rb"[0-9\s]{16,}", data[start : start + 4096])
    if have < need:
        hint = numbers_hint if as_text else UNCLOSED
        if width == 2 and have == count:
            hint = f"a maximum of {maximum} takes two bytes for each sample, the higher one first"
        raise _ends_after(max(have, 0) // (3 * width), size, hint)
    if have == need + 1 and data[at : at + 2] == b"\r\n":
        hint = "one byte of white space ends the header, and CR LF are two: was it written in text mode?"
        raise ImageError("its header ends in CR LF, so every sample would be off by a byte", hint)
    if have > need:
        if _is_text_mode(data, need):
            extra = f"{counted(have - need, 'byte')} too many, a carriage return before each line feed"
            raise ImageError(f"it has {extra}", 'written in text mode? open the file in binary mode, "wb"')
        if not data[start + need :].isspace():
            hint = numbers_hint if as_text else ""
            if width == 1 and have == 2 * need:
                hint = f"a maximum of {maximum} takes one byte for each sample"
            raise ImageError(f"{_follow(have - need)} the last of {count // 3} pixels", hint)
    levels: Levels = np.frombuffer(data, np.uint8, count, start)
    if width == 2:
        levels = np.frombuffer(data, ">u2", count, start).astype(np.uint16)
    if maximum not in (255, LARGEST_MAXIMUM):
        above = levels > maximum
        if above.any():
            first = int(above.argmax())
            raise _above(_pixel(first, size), str(levels[first]), maximum)
    return levels


def _above(place: str, level: str, maximum: int) -> ImageError:
    return ImageError(f"the {place} is {level}, above the maximum of {maximum}", "clamp colours to 1 before scaling")


def _is_text_mode(data: bytes, need: int) -> bool:
    """Whether the file is a right one in which every line feed became a carriage return and a line feed."""
    if data.count(b"\n") != data.count(b"\r\n"):
        return False
    before = data.replace(b"\r\n", b"\n")
    try:
        start = _header(before)[2] + 1
    except ImageError:
        return False
    # Where the header shows it, the file may go on after its pixels as any other may.
    shown = b"\r\n" in data[: start + 1]
    return len(before) == start + need or (shown and before[start + need :].isspace())


def _plain(data: bytes, at: int, size: tuple[int, int], maximum: int) -> Levels:
    """The samples of a P3 file, decimal numbers."""
    if data.find(b"#", at) >= 0:
        data, at = re.sub(rb"#[^\n\r]*", b"", data[at:]), 0
    count, filled = 3 * size[0] * size[1], 0
    levels: Levels = np.empty(count, np.uint8) if maximum < 256 else np.empty(count, np.uint16)
    white = re.compile(rb"\s")
    while at < len(data):
        # A piece ends between two words.
        match = white.search(data, at + PIECE)
        end = match.start() if match else len(data)
        piece = np.frombuffer(data, np.uint8, end - at, at)
        dark = np.zeros(len(piece) + 2, bool)
        dark[1:-1] = (piece != 0x20) & ((piece < 0x09) | (piece > 0x0D))
        first, last = np.flatnonzero(dark[1:] != dark[:-1]).reshape(-1, 2).T
        taken = min(len(first), count - filled)
        digits = piece - np.uint8(ord("0"))
        stray = np.flatnonzero((digits > 9) & dark[1:-1])
        if len(stray) and (k := int(np.searchsorted(first, stray[0], "right")) - 1) < taken:
            raise _no_level(data[at + int(first[k]) : at + int(last[k])], _pixel(filled + k, size))
        values = _values(digits, first[:taken], last[:taken])
        above = values > maximum
        if above.any():
            k = int(above.argmax())
            word = data[at + int(first[k]) : at + int(last[k])].decode()
            raise _above(_pixel(filled + k, size), word if len(word) < 20 else f"{word[:20]}...", maximum)
        levels[filled : filled + taken] = values
        filled += taken
        if taken < len(first):
            extra = _show(data[at + int(first[taken]) : at + int(last[taken])])
            raise ImageError(f"{extra} follows the last of {count // 3} pixels")
        at = end
    if filled < count:
        raise _ends_after(filled // 3, size)
    return levels


def _values(digits: NDArray[np.uint8], first: NDArray[np.intp], last: NDArray[np.intp]) -> NDArray[np.int32]:
    """Decimal numbers from where their digits begin to where they end; above nine digits 2^31 - 1 at most."""
    largest = np.iinfo(np.int32).max
    values = np.zeros(len(first), np.int32)
    lengths = last - first
    for place in range(min(int(lengths.max(initial=0)), 9)):
        # Of shorter numbers something else is read, and not taken.
        here = digits[np.maximum(last - 1 - place, 0)] * np.int32(10**place)
        values += here * (lengths > place)
    for k in np.flatnonzero(lengths > 9):
        if digits[first[k] : last[k] - 9].any():
            values[k] = largest
    return values


def _no_level(word: bytes, place: str) -> ImageError:
    hint = "the samples are whole numbers in decimal digits"
    if not word.isascii() or re.search(rb"[\0-\x1f\x7f]", word):
        hint = "the samples of P3 are text: the header of a file with bytes says P6"
    elif re.match(rb"-[0-9]", word):
        hint = "clamp colours to 0 before scaling"
    elif re.match(rb"[+-]?([0-9]*\.[0-9]|nan|inf)", word, re.IGNORECASE):
        hint = "scale colours by the maximum and convert them to whole numbers"
    return ImageError(f"the {place} is {_show(word)}, which is no level", hint)


# ---- PNG


def _png(data: bytes, size: tuple[int, int]) -> Image:
    from PIL.PngImagePlugin import PngImageFile

    chunks = _chunks(data, size)
    columns, rows, depth, color, *_, interlaced = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    _check_size((columns, rows), size)
    if depth not in PNG_DEPTHS.get(color, ()) or interlaced > 1:
        raise _damaged("its header means nothing")
    if depth == 16:
        raise ImageError("it is a PNG of 16 bits a sample, of which only 8 would be read", "write 8 bits, or a PPM")
    stride = _stride(columns, depth * PNG_SAMPLES[color])
    if interlaced:
        parts = [
            (-(-(columns - left) // right), -(-(rows - top) // down))
            for left, right, top, down in ADAM7
            if columns > left and rows > top
        ]
        need = sum(high * _stride(wide, depth * PNG_SAMPLES[color]) for wide, high in parts)
    else:
        need = rows * stride
    # Pillow says nothing about rows that are missing.
    inflate = zlib.decompressobj()
    try:
        have = len(inflate.decompress(chunks[b"IDAT"], need + 1))
    except zlib.error as error:
        raise _damaged("its pixels cannot be decompressed") from error
    if have < need:
        raise _ends_after(0 if interlaced else have // stride * columns, size)
    if have > need:
        raise ImageError(f"data follow the last of {columns * rows} pixels")
    if color == 3 and not chunks[b"PLTE"]:
        raise _damaged("it has no palette")
    # Nothing but the pixels goes to Pillow: what other chunks hold may be of any size.
    clean = data[:8] + b"".join(
        struct.pack(">I", len(body)) + name + body + zlib.crc32(name + body).to_bytes(4, "big")
        for name, body in chunks.items()
        if body or name in (b"IHDR", b"IDAT", b"IEND")
    )
    try:
        with PngImageFile(io.BytesIO(clean)) as image:
            if image.mode == "P" and int(np.asarray(image).max()) >= len(chunks[b"PLTE"]) // 3:
                raise ValueError("a pixel has a colour that is not in the palette")
            rgba = np.asarray(image.convert("RGBA"))
    except MemoryError:
        raise
    except Exception as error:  # whatever Pillow raises about bytes that are wrong
        raise _damaged(str(error)) from error
    clear = rgba[..., 3] != 255
    if clear.any():
        row, column = divmod(int(clear.argmax()), columns)
        place = f"column {column}, row {row}, has an alpha of {rgba[row, column, 3]}"
        raise ImageError(f"the image is transparent: {place} instead of 255", "write RGB without alpha")
    return Image(np.ascontiguousarray(rgba[..., :3]), 255)


def _stride(columns: int, bits: int) -> int:
    """Bytes of a row before compression, with that of its filter."""
    return 1 + -(-columns * bits // 8)


def _damaged(reason: str) -> ImageError:
    return ImageError(f"it is a damaged PNG: {reason}")


def _chunks(data: bytes, size: tuple[int, int]) -> dict[bytes, bytes]:
    """The chunks of a PNG that decide about its pixels, those of pixels joined."""
    found: dict[bytes, list[bytes]] = {name: [] for name in (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")}
    at = 8
    while not found[b"IEND"]:
        length, name = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        end = at + 12 + length
        if end > len(data):
            if found[b"IHDR"]:
                _check_size(struct.unpack(">II", found[b"IHDR"][0][:8]), size)
            raise ImageError(f"it is a PNG that ends too early, after {len(data)} bytes", UNCLOSED)
        if (at == 8) != (name == b"IHDR") or (name == b"IHDR" and length != 13):
            raise _damaged("its header is not where it should be")
        with memoryview(data) as view:
            if zlib.crc32(view[at + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
                raise _damaged(f"the checksum of its chunk {_show(name)} is wrong")
        if name in found:
            found[name].append(data[at + 8 : end - 4])
        elif name[:1].isupper():
            raise _damaged(f"it has a chunk {_show(name)} that nobody knows")
        at = end
    if data[at:].strip():
        raise ImageError(f"{_follow(len(data) - at)} the end of the PNG")
    return {name: b"".join(parts) for name, parts in found.items()}
