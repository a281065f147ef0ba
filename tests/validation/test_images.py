"""The images of other programs: what is read, exactly, and that every fault is a sentence of its own."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from typing import Any

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from validation.images import Image, ImageError, decode

COLUMNS, ROWS = SIZE = (5, 4)
SAMPLES = 3 * COLUMNS * ROWS
LEVELS = (np.arange(SAMPLES) * 37 % 256).reshape(ROWS, COLUMNS, 3)
#: Bytes without a line feed, and without white space at the end.
BINARY = bytes(64 + k for k in range(SAMPLES))


def fault(data: bytes, size: tuple[int, int] = SIZE) -> tuple[str, str]:
    with pytest.raises(ImageError) as caught:
        decode(data, size)
    assert str(caught.value) == caught.value.message
    return caught.value.message, caught.value.hint


def p6(levels: NDArray[Any] = LEVELS, maximum: int = 255, header: str = "P6\n{} {}\n{}\n") -> bytes:
    rows, columns, _ = levels.shape
    return header.format(columns, rows, maximum).encode() + levels.astype("u1" if maximum < 256 else ">u2").tobytes()


def p3(levels: NDArray[Any] = LEVELS, maximum: int = 255, between: str = "\n", end: str = "\n") -> bytes:
    rows, columns, _ = levels.shape
    words = ["P3", str(columns), str(rows), str(maximum), *map(str, levels.ravel())]
    return (between.join(words) + end).encode()


def png(levels: NDArray[Any] = LEVELS, mode: str = "RGB", **options: Any) -> bytes:
    file = io.BytesIO()
    image = PIL.Image.fromarray(levels.astype(np.uint8))
    (image if image.mode == mode else image.convert(mode)).save(file, "PNG", **options)
    return file.getvalue()


def chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def chunks(
    *rest: bytes, columns: int = COLUMNS, rows: int = ROWS, depth: int = 8, color: int = 2, way: int = 0
) -> bytes:
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, depth, color, 0, 0, way))
    return b"\x89PNG\r\n\x1a\n" + head + b"".join(rest)


def pixels(raw: bytes) -> bytes:
    return chunk(b"IDAT", zlib.compress(raw))


END = chunk(b"IEND", b"")
#: The rows of a picture in RGB, each after a filter byte.
RAW = b"".join(b"\0" + LEVELS[row].astype(np.uint8).tobytes() for row in range(ROWS))


def same(image: Image, levels: NDArray[Any], steps: int = 255) -> None:
    assert image.steps == steps
    assert image.levels.dtype == (np.uint8 if steps < 256 else np.uint16)
    assert np.array_equal(image.levels, levels)


class TestRead:
    @pytest.mark.parametrize("maximum", [1, 7, 254, 255, 256, 1000, 65535])
    @pytest.mark.parametrize("write", [p3, p6])
    def test_every_maximum(self, write: Any, maximum: int) -> None:
        levels = (np.arange(SAMPLES) * 7919 % (maximum + 1)).reshape(LEVELS.shape)
        levels[-1, -1, -1] = maximum
        same(decode(write(levels, maximum), SIZE), levels, maximum)

    @pytest.mark.parametrize(
        "header",
        [
            "P6 {} {} {} ",
            "P6\n# by hand\n{}\n{}\n{}\n",
            "P6\r{}\t{}\v\f{}\r",
            "P6#{{\n#\n{} # columns\n  {}# rows\r{}\n",
            "P6\n{}\n{} {}# the maximum\n",
            "P6 000{} 0{} 00{}\n",
        ],
    )
    def test_headers_of_any_form(self, header: str) -> None:
        same(decode(p6(header=header), SIZE), LEVELS)

    @pytest.mark.parametrize("between", [" ", "\n", "\r\n", "\t \v\f\r", " # 9 9 9\n", "#\n"])
    def test_numbers_with_any_white_space_between(self, between: str) -> None:
        same(decode(p3(between=between, end=between), SIZE), LEVELS)
        same(decode(p3(between=between, end=""), SIZE), LEVELS)

    def test_zeros_before_numbers(self) -> None:
        text = p3(between=" ").replace(b" 37 ", b" 0037 ").replace(b" 74 ", b" " + b"0" * 5000 + b"74 ")
        same(decode(text, SIZE), LEVELS)

    def test_white_space_after_the_last_pixel(self) -> None:
        same(decode(p6() + b"\n \r\n", SIZE), LEVELS)
        # No line feed elsewhere: nothing shows that this one was changed.
        assert decode(b"P6 5 4 255 " + BINARY + b"\r\n", SIZE).levels.tobytes() == BINARY

    def test_bytes_that_look_like_line_ends(self) -> None:
        levels = np.where(LEVELS % 2, 10, 13)
        same(decode(p6(levels), SIZE), levels)

    def test_text_in_many_pieces(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for piece in (1, 2, 3, 7, 50):
            monkeypatch.setattr("validation.images.PIECE", piece)
            same(decode(p3(), SIZE), LEVELS)

    @pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P", "1", "LA"])
    def test_png(self, mode: str) -> None:
        data = png(mode=mode)
        with PIL.Image.open(io.BytesIO(data)) as image:
            assert image.mode == mode
            same(decode(data, SIZE), np.asarray(image.convert("RGB")))

    @pytest.mark.parametrize(("depth", "grey"), [(1, 255), (2, 85), (4, 17)])
    def test_grey_png_of_few_bits(self, depth: int, grey: int) -> None:
        row = int("01" * 8, 2).to_bytes(2, "big") if depth == 1 else b"\x12\x34\x56"
        wide = -(-COLUMNS * depth // 8)
        bits = "".join(f"{byte:08b}" for byte in row)
        expected = [int(bits[k * depth : (k + 1) * depth], 2) * grey for k in range(COLUMNS)]
        data = chunks(pixels((b"\0" + row[:wide].ljust(wide, b"\0")) * ROWS), END, depth=depth, color=0)
        assert decode(data, SIZE).levels[2, :, 1].tolist() == expected

    def test_interlaced_png(self) -> None:
        # Seven pictures in one: each shows every eighth, fourth or second pixel.
        grid = ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
        raw = b""
        for top, left, down, right in grid:
            for row in LEVELS[top::down, left::right].astype(np.uint8):
                raw += b"\0" + row.tobytes() if row.size else b""
        same(decode(chunks(pixels(raw), END, way=1), SIZE), LEVELS)
        assert "ends after pixel" in fault(chunks(pixels(raw[:-1]), END, way=1))[0]

    def test_what_a_png_says_beside_its_pixels_has_no_effect(self) -> None:
        extra = chunk(b"gAMA", struct.pack(">I", 100000)) + chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1 << 27)))
        same(decode(chunks(extra, pixels(RAW), END), SIZE), LEVELS)


class TestFaults:
    def test_empty(self) -> None:
        assert fault(b"") == ("it is empty", "does the program close its file, and write every row, before it ends?")

    @pytest.mark.parametrize(
        ("data", "name"),
        [
            (b"BM" + bytes(60), "BMP"),
            (b"\xff\xd8\xff\xe0", "JPEG"),
            (b"GIF89a...", "GIF"),
            (b"P5 5 4 255 ", "PGM"),
            (b"P2\n5 4\n", "PGM"),
            (b"P7\nWIDTH 5", "PAM"),
            (b"PF\n5 4\n-1.0\n", "PFM"),
            (b"\xff\xfeP\0" + b"3\0", "UTF-16"),
        ],
    )
    def test_another_kind(self, data: bytes, name: str) -> None:
        message, hint = fault(data)
        assert name in message
        assert hint == "PPM (P3 or P6) and PNG are read"

    def test_no_image(self) -> None:
        assert "the text 'Rendering ...\\n'" in fault(b"Rendering ...\n")[0]
        assert "no image: it begins with '\\x00\\x01'" in fault(b"\0\1")[0]
        assert "nothing may stand before" in fault(b"\n" + p6())[0]
        assert "nothing may stand before" in fault(b"\xef\xbb\xbf" + p3())[0]
        assert "white space is expected after 'P6', found '5'" in fault(b"P65 4 255 ")[0]

    def test_header_cut_off(self) -> None:
        whole = p6(header="P6 {} {} {} ")
        columns, rows = "number of columns", "number of rows"
        for length, name in ((2, columns), (4, columns), (5, rows), (6, rows), (7, "maximum"), (10, "maximum")):
            assert fault(whole[:length])[0] == f"it ends within the header, before or in the {name}"
        assert "pixel 0 of 20" in fault(whole[:11])[0]
        assert "does not end within 65536 bytes" in fault(b"P6\n#" + bytes(70000) + b"\n5 4 255 " + BINARY)[0]

    @pytest.mark.parametrize("word", ["-5", "5.0", "abc", "5x4", "\0", "\u0665"])
    def test_a_number_that_is_none(self, word: str) -> None:
        message, _ = fault(f"P6 {word} 4 255 ".encode() + BINARY)
        assert message.startswith("the number of columns in its header is '")
        assert message.endswith("which is no number")
        assert "the maximum in its header is" in fault(f"P6 5 4 {word} ".encode() + BINARY)[0]

    @pytest.mark.parametrize("write", ["P6 {} {} 255 ", "P3 {} {} 255 "])
    def test_sizes(self, write: str) -> None:
        def at(columns: int, rows: int) -> tuple[str, str]:
            return fault(write.format(columns, rows).encode() + BINARY)

        assert at(0, 4)[0] == "the image is 0x4: it has no pixels"
        assert at(4, 4)[0] == "the image is 4x4, the scene asks for 5x4"
        assert at(4, 5) == (
            "the image is 4x5, the scene asks for 5x4",
            "columns and rows are swapped: columns come first",
        )
        assert "swapped" not in at(4, 4)[1]
        assert "larger than any" in at(10**12, 4)[0]

    def test_no_memory_for_another_size(self) -> None:
        large = [b"P6 99999 99999 255 ", b"P3 99999 99999 255 ", chunks(pixels(b""), END, columns=99999, rows=99999)]
        # What is compressed is as large as it likes.
        bomb = chunks(pixels(bytes(1 << 26)), END)
        tracemalloc.start()
        try:
            for data in large:
                assert "99999x99999" in fault(data)[0]
            assert "follow the last of 20 pixels" in fault(bomb)[0]
            assert tracemalloc.get_traced_memory()[1] < 1 << 20
        finally:
            tracemalloc.stop()

    def test_a_maximum_that_is_none(self) -> None:
        assert "maximum in its header is 0, expected 1 to 65535" in fault(p6(maximum=0))[0]
        assert "65536" in fault(p6(maximum=65536))[0]

    def test_too_little_data(self) -> None:
        assert fault(p6()[:-1])[0] == "it ends after pixel 19 of 20"
        assert fault(p6()[:-3])[0] == "it ends after pixel 19 of 20"
        assert fault(p6()[:-4])[0] == "it ends after pixel 18 of 20"
        assert fault(p3().rsplit(b"\n", 2)[0])[0] == "it ends after pixel 19 of 20"
        assert fault(p3(end="")[:20])[0] == "it ends after pixel 1 of 20"
        assert fault(chunks(pixels(RAW[:-1]), END))[0] == "it ends after pixel 15 of 20"

    def test_too_much_data(self) -> None:
        assert fault(p6() + b"\0")[0] == "1 byte follows the last of 20 pixels"
        assert fault(p3() + b"7")[0] == "'7' follows the last of 20 pixels"
        assert fault(p3() + b"Done.")[0] == "'Done.' follows the last of 20 pixels"
        assert fault(png() + b"Done.")[0] == "5 bytes follow the end of the PNG"

    def test_bytes_a_sample(self) -> None:
        assert "two bytes for each sample" in fault(p6(header="P6 {} {} 65535 "))[1]
        assert "one byte for each sample" in fault(b"P6 5 4 255 " + BINARY * 2)[1]

    def test_text_and_bytes_confused(self) -> None:
        assert "the header of such a file says P3" in fault(b"P6" + p3()[2:])[1]
        assert "the header of such a file says P3" in fault(b"P6" + p3(LEVELS * 0 + 7, between=" ")[2:60])[1]
        assert "the header of a file with bytes says P6" in fault(b"P3" + p6()[2:])[1]

    @pytest.mark.parametrize("maximum", [255, 65535])
    def test_written_in_text_mode(self, maximum: int) -> None:
        levels = LEVELS.copy()
        levels[1, 2] = 10
        levels[3, 4] = 10, 32, 10
        for header in ("P6\n{} {}\n{}\n", "P6 {} {} {} "):
            data = p6(levels, maximum, header)
            message, hint = fault(data.replace(b"\n", b"\r\n"))
            assert "a carriage return before each line feed" in message
            assert hint == 'written in text mode? open the file in binary mode, "wb"'
        # All that is too much is white space, which otherwise is allowed.
        assert "text mode" in fault(p6(LEVELS * 0 + 10).replace(b"\n", b"\r\n"))[1]
        # One bare line feed: no text mode.
        assert "text mode" not in fault(p6(levels).replace(b"\n", b"\r\n") + b"\n.")[1]

    def test_header_that_ends_in_cr_lf(self) -> None:
        data = p6(header="P6\r\n{} {}\r\n{}\r\n", levels=np.where(LEVELS == 0, 10, LEVELS))
        assert fault(data) == (
            "its header ends in CR LF, so every sample would be off by a byte",
            "one byte of white space ends the header, and CR LF are two: was it written in text mode?",
        )
        assert fault(data[:-1] + b"\n") == fault(data), "the byte too many may look like the end of a line"

    @pytest.mark.parametrize("write", [p3, p6])
    def test_a_sample_above_the_maximum(self, write: Any) -> None:
        levels = LEVELS % 100
        levels[2, 3, 1] = 101
        assert fault(write(levels, 100))[0] == "the green of column 3, row 2 is 101, above the maximum of 100"
        assert fault(write(levels, 1))[0].endswith("above the maximum of 1")

    def test_numbers_that_are_larger_than_any_level(self) -> None:
        for number in ("4294967297", "2147483648", "256", "1" * 5000):
            text = p3(between=" ").replace(b" 74 ", f" {number} ".encode())
            shown = number if len(number) < 20 else f"{number[:20]}..."
            assert fault(text)[0] == f"the blue of column 0, row 0 is {shown}, above the maximum of 255"

    @pytest.mark.parametrize(
        ("word", "hint"),
        [
            ("-5", "clamp"),
            ("0.5", "scale"),
            ("1.5e3", "scale"),
            ("-nan", "scale"),
            ("nan", "scale"),
            ("x", "decimal"),
        ],
    )
    def test_a_sample_that_is_none(self, word: str, hint: str) -> None:
        message, found = fault(p3(between=" ").replace(b" 74 ", f" {word} ".encode()))
        assert message == f"the blue of column 0, row 0 is '{word}', which is no level"
        assert hint in found

    def test_png_of_16_bits(self) -> None:
        data = chunks(pixels(bytes(ROWS * (1 + 6 * COLUMNS))), END, depth=16)
        assert fault(data)[0] == "it is a PNG of 16 bits a sample, of which only 8 would be read"

    def test_transparent_png(self) -> None:
        levels = np.concatenate([LEVELS, np.full((ROWS, COLUMNS, 1), 255)], axis=2)
        same(decode(png(levels, "RGBA"), SIZE), LEVELS)
        levels[1, 3, 3] = 254
        assert "column 3, row 1, has an alpha of 254" in fault(png(levels, "RGBA"))[0]
        # One colour of all is transparent.
        assert "alpha of 0" in fault(png(transparency=tuple(int(level) for level in LEVELS[0, 2])))[0]
        assert (
            "alpha of 0"
            in fault(png(mode="P", transparency=int(np.asarray(PIL.Image.open(io.BytesIO(png(mode="P"))))[0, 1])))[0]
        )

    def test_damaged_png(self) -> None:
        whole = png()
        assert "ends too early, after 30 bytes" in fault(whole[:30])[0]
        assert "ends too early" in fault(whole[:-1])[0]
        spoiled = bytearray(whole)
        spoiled[whole.index(b"IDAT") + 9] ^= 1
        assert fault(bytes(spoiled))[0] == "it is a damaged PNG: the checksum of its chunk 'IDAT' is wrong"
        assert "cannot be decompressed" in fault(chunks(chunk(b"IDAT", b"abc"), END))[0]
        assert "header means nothing" in fault(chunks(pixels(RAW), END, depth=3))[0]
        assert "no palette" in fault(chunks(pixels(bytes(24)), END, color=3))[0]
        palette = chunk(b"PLTE", bytes(3 * 7))
        raw = b"".join(b"\0" + bytes(column + row for column in range(COLUMNS)) for row in range(ROWS))
        assert "not in the palette" in fault(chunks(palette, pixels(raw), END, color=3))[0]
        assert not decode(chunks(palette, pixels(raw[:-1] + b"\0"), END, color=3), SIZE).levels.any()
        assert "header is not where" in fault(chunks(chunks()[8:], pixels(RAW), END))[0]
        assert "nobody knows" in fault(chunks(chunk(b"ABCD", b""), pixels(RAW), END))[0]
        assert "damaged PNG" in fault(chunks(pixels(b"\x09" + RAW[1:]), END))[0]


WHOLE = [
    p6(),
    p3(),
    p6(maximum=65535),
    p3(between=" # x\n"),
    png(),
    png(mode="P"),
    png(mode="LA"),
    chunks(pixels(RAW), END),
]


@st.composite
def spoiled(draw: st.DrawFn) -> bytes:
    """An image with bytes changed, cut out, doubled, or put in."""
    data = bytearray(draw(st.sampled_from(WHOLE)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        end = at + draw(st.integers(0, 6))
        more = draw(
            st.sampled_from([b"", b"0", b"\n", b"#", b" ", b"-", b"99999999999", data[at:end] * 2])
            | st.binary(max_size=4)
        )
        data[at:end] = more
    return bytes(data)


@st.composite
def odd_png(draw: st.DrawFn) -> bytes:
    """A PNG whose checksums are right, and nothing else."""
    names = st.sampled_from([b"IDAT", b"PLTE", b"tRNS", b"IHDR", b"IEND", b"acTL", b"fdAT", b"iCCP"])
    depth, samples, color = draw(st.sampled_from([(1, 1, 0), (4, 1, 0), (8, 3, 2), (2, 1, 3), (8, 1, 3), (8, 4, 6)]))
    wide = -(-COLUMNS * depth * samples // 8)
    rows = st.builds(lambda kind, row: bytes([kind]) + row, st.integers(0, 5), st.binary(min_size=wide, max_size=wide))
    raw = b"".join(draw(rows) for _ in range(ROWS)) + draw(st.binary(max_size=1))
    bodies = st.binary(max_size=12) | st.just(zlib.compress(raw)) | st.just(bytes(range(48))) | st.just(b"\xff" * 6)
    rest = draw(st.lists(st.builds(chunk, names, bodies), max_size=3))
    return chunks(
        *rest,
        chunk(b"IDAT", zlib.compress(raw)),
        END,
        depth=depth,
        color=color,
        way=draw(st.sampled_from((0, 0, 0, 1))),
    )


@given(st.binary(max_size=200) | spoiled() | odd_png())
def test_any_bytes_are_an_image_or_a_clear_error(data: bytes) -> None:
    found: Image | ImageError
    try:
        found = decode(data, SIZE)
    except ImageError as error:
        found = error
    if isinstance(found, ImageError):
        assert found.message.isprintable()
        assert found.message
    else:
        assert found.levels.shape == (ROWS, COLUMNS, 3)
        assert found.levels.dtype in (np.uint8, np.uint16)
        assert found.levels.max() <= found.steps
