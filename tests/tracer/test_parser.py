"""The scene format: what is read, what is refused and in which words, and that text and Scene are the same thing."""

from __future__ import annotations

import codecs
import itertools
import math
import re
import struct
import time
import warnings
from fractions import Fraction
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from strategies import scenes

import tracer
from tracer import Scene, SceneDiagnostic, SceneError, SceneWarning, loads

BASE = {
    "NEAR": "NEAR 1",
    "LEFT": "LEFT -1",
    "RIGHT": "RIGHT 1",
    "BOTTOM": "BOTTOM -1",
    "TOP": "TOP 1",
    "RES": "RES 4 3",
    "SPHERE": "SPHERE s 0 0 -5 1 1 1 1 0 0 0.1 0.6 0.3 0 50",
    "LIGHT": "LIGHT l 0 5 0 1 1 1",
    "BACK": "BACK 0 0 0",
    "AMBIENT": "AMBIENT 1 1 1",
    "OUTPUT": "OUTPUT image.ppm",
}
REQUIRED = "'NEAR', 'LEFT', 'RIGHT', 'BOTTOM', 'TOP', 'RES', 'BACK', 'AMBIENT' and 'OUTPUT'"
TEXT = "a scene is text in UTF-8 with lines such as RES 640 480"
FIELDS = "NEAR, LEFT, RIGHT, BOTTOM, TOP, RES, SPHERE, LIGHT, BACK, AMBIENT, OUTPUT"


def base(**changes: str) -> str:
    """A valid file with some of its lines changed."""
    return "".join(line + "\n" for line in (BASE | changes).values())


def with_number(text: str) -> float:
    """A number as a scene reads it (as part of the background, which may be any number)."""
    return loads(base(BACK=f"BACK {text} 0 0")).background[0]


def errors(text: str | bytes, *, limits: bool = True) -> tuple[SceneDiagnostic, ...]:
    with pytest.raises(SceneError) as caught:
        loads(text, limits=limits)
    return caught.value.errors


def described(text: str | bytes, *, limits: bool = True) -> str:
    """All errors as one text, without the name of the file."""
    with pytest.raises(SceneError) as caught:
        loads(text, limits=limits, source="FILE")
    return str(caught.value).replace("FILE:", "")


# ----------------------------------------------------------------------------------------------------------------------
# Wrong files


def bad_scenes() -> list[tuple[str, bytes, str]]:
    """The cases of bad_scenes.txt: name, file, errors."""
    cases = []
    lines = Path(__file__).with_name("bad_scenes.txt").read_text(encoding="utf-8").splitlines()
    content = [line for line in lines if not line.startswith("# ") and line != "#"]
    for filled, group in itertools.groupby(content, key=bool):
        if not filled:
            continue
        block = list(group)
        end = block.index("--")
        changes: dict[str, list[bytes]] = {}
        for line in block[:end]:
            field, _, new = line.partition(" <-")
            raw, _ = codecs.escape_decode(new.removeprefix(" ").encode())
            changes.setdefault(field, []).extend([raw] if new else [])
        assert set(changes) <= set(BASE)
        parts = itertools.chain.from_iterable(changes.get(field, [line.encode()]) for field, line in BASE.items())
        cases.append((block[0], b"".join(line + b"\n" for line in parts), "\n".join(block[end + 1 :])))
    return cases


BAD = bad_scenes()


def test_there_are_enough_bad_scenes() -> None:
    assert len(BAD) >= 140
    assert len({file for _, file, _ in BAD}) == len(BAD)


@pytest.mark.parametrize(("file", "expected"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_bad_scene(file: bytes, expected: str) -> None:
    assert described(file) == expected


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        (b"", f"1:1: error: the file is empty: the fields {REQUIRED} are missing, expected once each"),
        (b"\n\n", f"2:1: error: the file is empty: the fields {REQUIRED} are missing, expected once each"),
        (b" \t", f"1:1: error: the file is empty: the fields {REQUIRED} are missing, expected once each"),
        (
            b"\xef\xbb\xbf" + base(NEAR="NEAR 0").encode(),
            "1:1: error: found a byte-order mark, expected a field\n"
            "  hint: save the file as UTF-8 without BOM\n"
            "1:9: error: NEAR: found '0' for 'n', expected a number above 0",
        ),
        (base().encode("utf-16"), "1:1: error: the file is UTF-16, expected UTF-8\n  hint: save the file as UTF-8"),
        (
            b"\xfe\xff" + base().encode("utf-16-be"),
            "1:1: error: the file is UTF-16, expected UTF-8\n  hint: save the file as UTF-8",
        ),
        (
            b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
            f"1:1: error: this is an image (PNG), not a scene\n  hint: {TEXT}",
        ),
        (b"P6\n2 1\n255\nabcdef", f"1:1: error: this is an image (PPM), not a scene\n  hint: {TEXT}"),
        (b"P3 2 1 255", f"1:1: error: this is an image (PPM), not a scene\n  hint: {TEXT}"),
        (b"\xff\xd8\xff\xe0", f"1:1: error: this is an image (JPEG), not a scene\n  hint: {TEXT}"),
        (b"v/1\x01", f"1:1: error: this is an image (EXR), not a scene\n  hint: {TEXT}"),
        (b"\x7fELF\x02\x01\x01" + bytes(9), f"1:1: error: this is not a text file\n  hint: {TEXT}"),
        (base().encode("utf-16-le"), f"1:1: error: this is not a text file\n  hint: {TEXT}"),
        (
            base(TOP="TOP x").replace("\n", "\r").encode(),
            "5:5: error: TOP: found 'x' for 't', expected a number",
        ),
        (
            base(TOP="\tTOP  x").replace("\n", "\r\n").encode(),
            "5:7: error: TOP: found 'x' for 't', expected a number",
        ),
        (
            base(SPHERE=BASE["SPHERE"].replace(" s ", " Kugel ")).encode().replace(b"Kugel", b"K\xfcgel"),
            "7:8: error: SPHERE: found 'K\\xfcgel' for 'name', expected UTF-8 text\n  hint: save the file as UTF-8",
        ),
        (
            base(SPHERE=BASE["SPHERE"].replace(" s ", " \ud800 ")).encode("utf-8", "surrogatepass"),
            "7:8: error: SPHERE: found '\\xed\\xa0\\x80' for 'name', expected UTF-8 text\n"
            "  hint: save the file as UTF-8",
        ),
    ],
    ids=[
        "empty",
        "blank lines",
        "blanks",
        "BOM",
        "UTF-16 LE",
        "UTF-16 BE",
        "PNG",
        "PPM",
        "plain PPM",
        "JPEG",
        "EXR",
        "program",
        "UTF-16 without BOM",
        "CR",
        "CRLF",
        "Latin-1",
        "surrogate",
    ],
)
def test_bad_file(file: bytes, expected: str) -> None:
    assert described(file) == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (
            "RES 4000000000 4000000000",
            "6:5: error: RES: found 4000000000 x 4000000000 pixels, expected a number of pixels that 64 bits can count",
        ),
        (
            "RES 9223372036854775807 1",
            "6:5: error: RES: found '9223372036854775807' for 'columns', expected an integer below 2^63 - 1",
        ),
        (
            "RES 1 99999999999999999999",
            "6:7: error: RES: found '99999999999999999999' for 'rows', expected an integer below 2^63 - 1",
        ),
    ],
)
def test_limits_that_always_hold(line: str, expected: str) -> None:
    assert described(base(RES=line), limits=False) == expected


def test_no_limits() -> None:
    many = base(
        RES="RES 100001 9000000000",
        SPHERE="\n".join(BASE["SPHERE"].replace("-5", f"-{i}") for i in range(10, 30)),
        LIGHT="\n".join([BASE["LIGHT"]] * 20),
    )
    assert [error.message for error in errors(many)] == [
        "RES: found '100001' for 'columns', expected at most 100000",
        "RES: found '9000000000' for 'rows', expected at most 100000",
        "found 20 spheres, expected at most 5",
        "found 20 lights, expected at most 5",
    ]
    scene = loads(many, limits=False)
    assert len(scene.spheres) == len(scene.lights) == 20
    assert (scene.view.columns, scene.view.rows) == (100001, 9000000000)
    largest = loads(base(RES="RES 9223372036854775806 1"), limits=False)
    assert largest.view.columns == 2**63 - 2
    assert loads(largest.text(), limits=False) == largest


def test_diagnostics_have_all_parts() -> None:
    (error,) = errors(base(NEAR="  NEAR 1,5"))
    assert (error.line, error.column, error.field) == (1, 8, "NEAR")
    assert error.message == "NEAR: found '1,5' for 'n', expected a number"
    assert error.hint == "did you mean '1.5'?"
    assert error.describe("a.txt") == f"a.txt:1:8: error: {error.message}\n  hint: {error.hint}"
    assert error.describe("a.txt", "warning").startswith("a.txt:1:8: warning: NEAR")


def test_the_source_is_shown_without_control_characters() -> None:
    with pytest.raises(SceneError, match=re.escape("bad\\x1b[31m name:1:1: error: the file is empty")):
        loads("", source="bad\x1b[31m name")


def test_all_errors_at_once_in_file_order() -> None:
    text = base(LEFT="LEFT 3", TOP="TOP", SPHERE="\n".join([BASE["SPHERE"] + " 1"] * 7), OUTPUT="OUTPUT a b")
    places = [(error.line, error.column, error.field) for error in errors(text)]
    assert places == [
        (3, 7, "RIGHT"),
        (5, 4, "TOP"),
        *[(line, 46, "SPHERE") for line in range(7, 12)],
        (12, 1, "SPHERE"),
        (12, 46, "SPHERE"),
        (13, 46, "SPHERE"),
        (17, 10, "OUTPUT"),
    ]


def test_a_hundred_errors_are_shown_and_the_rest_counted() -> None:
    found = errors("x y\n" * 5000)
    assert len(found) == 101
    assert [error.line for error in found[:100]] == list(range(1, 101))
    # 5000 lines and the missing fields.
    assert found[100] == SceneDiagnostic(message="and 4901 more")
    assert len(errors("NEAR 1\n" * 101 + base())) == 100 + 1
    exactly = errors("x y\n" * 99)
    assert len(exactly) == 100
    assert exactly[99].message.startswith("the fields 'NEAR', ")


def test_long_words_are_cut() -> None:
    (error,) = errors(base(NEAR="NEAR " + "\u00e4" * 500_000))
    shown = "\u00e4" * 20
    assert error.message == f"NEAR: found '{shown}...' (1000000 bytes) for 'n', expected a number"


# ----------------------------------------------------------------------------------------------------------------------
# Right files


def test_every_field() -> None:
    scene = loads(
        "NEAR 2\nLEFT -3\nRIGHT 4\nBOTTOM -5\nTOP 6\nRES 7 8\n"
        "SPHERE ball 1 2 -3 4 -5 6 .1 .2 .3 .4 .5 .6 .7 80\n"
        "LIGHT lamp 9 10 11 -12 13 14\nBACK -1 2 3e200\nAMBIENT .5 -.25 4\nOUTPUT out.ppm\n"
    )
    assert scene == Scene(
        view=tracer.View(near=2, left=-3, right=4, bottom=-5, top=6, columns=7, rows=8),
        spheres=[
            tracer.Sphere(
                name="ball",
                position=(1, 2, -3),
                scaling=(4, -5, 6),
                color=(0.1, 0.2, 0.3),
                ka=0.4,
                kd=0.5,
                ks=0.6,
                kr=0.7,
                exponent=80,
            )
        ],
        lights=[tracer.Light(name="lamp", position=(9, 10, 11), intensity=(-12, 13, 14))],
        background=(-1, 2, 3e200),
        ambient=(0.5, -0.25, 4),
        output="out.ppm",
    )


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\n\n", "\r\r", " \t\n", "\n\r", "\n \t\r\n"], ids=repr)
@pytest.mark.parametrize("last", [True, False], ids=["ended", "unended"])
def test_line_ends(end: str, last: bool) -> None:
    text = base().replace("\n", end)
    assert loads(text if last else text.removesuffix(end)) == loads(base())


def test_blanks() -> None:
    spread = base().replace(" ", " \t  ").replace("\n", "\t \n \t")
    assert loads(" " + spread) == loads(base())


@pytest.mark.parametrize(
    "name", ["s", "20-bytes-are-allowed", "\u00fcber", "\u7403" * 6, "#1", "//", "50", "-", "NEAR"]
)
def test_names(name: str) -> None:
    scene = loads(base(SPHERE=BASE["SPHERE"].replace(" s ", f" {name} "), OUTPUT=f"OUTPUT {name}"))
    assert scene.spheres[0].name == scene.output == name
    assert loads(scene.text()) == scene


def test_objects_are_optional_and_may_share_a_name() -> None:
    text = "".join(line + "\n" for field, line in BASE.items() if field not in ("SPHERE", "LIGHT"))
    scene = loads(text)
    assert (scene.spheres, scene.lights) == ((), ())
    assert loads(base(LIGHT="\n".join([BASE["LIGHT"]] * 5))).lights == loads(base()).lights * 5


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        ("+1", 1.0),
        ("-1", -1.0),
        ("007", 7.0),
        ("1.", 1.0),
        ("-.5", -0.5),
        ("+.5e+1", 5.0),
        ("1.e2", 100.0),
        ("1E2", 100.0),
        ("1e-2", 0.01),
        ("1e007", 1e7),
        ("0e99999999999999999999", 0.0),
        ("0.1", 0.1),
        ("9007199254740993", 9007199254740992.0),
        ("9007199254740993.0000000000000000000000000000000000000000000000000000000001", 9007199254740994.0),
        ("1.7976931348623157e308", 1.7976931348623157e308),
        ("1.7976931348623158e308", 1.7976931348623157e308),
        ("2.2250738585072014e-308", 2.2250738585072014e-308),
        ("2.2250738585072011e-308", 2.225073858507201e-308),
        ("5e-324", 5e-324),
        ("3e-324", 5e-324),
        ("2e-324", 0.0),
        ("1e-400", 0.0),
        ("1e-99999999999999999999", 0.0),
        ("0." + "0" * 100_000 + "1e100001", 1.0),
        ("1" + "0" * 100_000 + "e-100000", 1.0),
        ("0." + "0" * 700_000 + "25e700001", 2.5),
        ("3" * 5000 + "e-4999", 3 + 1 / 3),
        ("0" * 5000 + "2", 2.0),
    ],
    ids=lambda value: value[:24] if isinstance(value, str) else None,
)
def test_number(text: str, value: float) -> None:
    assert with_number(text) == value


@pytest.mark.parametrize("text", ["-0", "-0.0", "-0e5", "-1e-400"])
def test_a_zero_has_no_sign(text: str) -> None:
    assert math.copysign(1, with_number(text)) == 1


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(("r", ".17g", ".40e", ".800e", ".400f")))
@example(5e-324, ".800e")
def test_numbers_are_read_as_the_nearest_float64(value: float, form: str) -> None:
    text = repr(value) if form == "r" else format(value, form)
    assert with_number(text) == value


@given(st.integers(0, 0x7FEFFFFFFFFFFFFE), st.sampled_from((-1, 0, 1)))
def test_halfway_between_two_floats(bits: int, side: int) -> None:
    # The midpoint of a float64 and the next one as an exact decimal of up to 767 digits, and the least bit beside it.
    low, high = (struct.unpack("<d", struct.pack("<Q", value))[0] for value in (bits, bits + 1))
    middle = (Fraction(low) + Fraction(high)) / 2
    places = middle.denominator.bit_length() - 1  # the denominator is a power of two
    digits = middle.numerator * 5**places
    even = low if bits % 2 == 0 else high
    assert with_number(f"{digits * 10 + side}e{-places - 1}") == {-1: low, 0: even, 1: high}[side]


NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


@given(st.text("+-.eE0123459", min_size=1, max_size=8) | st.text("+-.eE019xnaif,_", min_size=1, max_size=5))
def test_number_syntax(text: str) -> None:
    if NUMBER.fullmatch(text) and math.isfinite(float(text)):
        assert with_number(text) == float(text)
    else:
        (error,) = errors(base(BACK=f"BACK {text} 0 0"))
        assert (error.line, error.column) == (9, 6)


def test_magnitudes_at_the_ends_of_the_range() -> None:
    for value in ("1e-100", "1e100"):
        sphere = f"SPHERE s -{value} {value} 0 -{value} {value} {value} 0 0 0 0 0 0 0 1e308"
        loads(base(NEAR=f"NEAR {value}", RIGHT=f"RIGHT {value}", SPHERE=sphere, AMBIENT=f"AMBIENT -{value} 0 0"))
    for value in ("9.999999999999999e-101", "1.0000000000000002e100"):
        assert len(errors(base(NEAR=f"NEAR {value}"))) == 1
        assert len(errors(base(AMBIENT=f"AMBIENT 0 -{value} 0"))) == 1


# ----------------------------------------------------------------------------------------------------------------------
# Duplicates

TWINS = base(
    SPHERE="SPHERE a 1 -0 -5 1 2 3 1 0 0 0 1 0 0 1\n"
    "SPHERE b 1 0 -5 1 2 3.5 1 0 0 0 1 0 0 1\n"
    " SPHERE c 1e0 0 -5 -1 2.0 -3 0 1 0 1 0 0 0 9\n"
    "SPHERE d 1 0 -5 1 2 3 1 0 0 0 1 0 0 1"
)


def test_duplicate_spheres_are_ignored_with_a_warning() -> None:
    with pytest.warns(SceneWarning) as caught:
        scene = loads(TWINS, source="twins.txt")
    assert [str(warning.message) for warning in caught] == [
        "twins.txt:9:2: warning: 'c' has the centre and the scaling of 'a' on line 7 and is ignored\n"
        "twins.txt:10:1: warning: 'd' has the centre and the scaling of 'a' on line 7 and is ignored"
    ]
    assert caught[0].filename == __file__
    assert scene.distinct == (0, 1)
    assert [sphere.name for sphere in scene.spheres] == ["a", "b", "c", "d"]


def test_the_warning_of_load_points_to_its_caller(tmp_path: Path) -> None:
    path = tmp_path / "twins.txt"
    path.write_text(TWINS)
    with pytest.warns(SceneWarning, match="twins.txt:9:2: warning: 'c' has the centre") as caught:
        tracer.load(path)
    assert caught[0].filename == __file__


@given(scenes(), st.data())
def test_distinct(scene: Scene, data: st.DataObject) -> None:
    count = len(scene.spheres)
    repeats = data.draw(st.lists(st.integers(0, count - 1), max_size=6)) if count else []
    copies = [
        scene.spheres[i].replace(name="copy", kr=0.5, scaling=[-value for value in scene.spheres[i].scaling])
        for i in repeats
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        longer = scene.replace(spheres=[*scene.spheres, *copies], limits=False)
        assert loads(longer.text(), limits=False) == longer
    assert longer.distinct == scene.distinct == tuple(range(count))


# ----------------------------------------------------------------------------------------------------------------------
# Properties


@given(scenes(extreme=True) | scenes())
def test_a_scene_is_its_text(scene: Scene) -> None:
    text = scene.text()
    again = loads(text)
    assert again == scene
    assert again.text() == text
    assert hash(again) == hash(scene)


@given(scenes(extreme=True), st.randoms(use_true_random=False), st.sampled_from(("\n", "\r\n", "\r", "\n \t\n")))
def test_the_order_of_fields_has_no_effect(scene: Scene, random: Random, end: str) -> None:
    lines = scene.text().splitlines()
    shuffled = lines.copy()
    random.shuffle(shuffled)
    # Objects keep their order among themselves.
    for field in ("SPHERE", "LIGHT"):
        ordered = iter([line for line in lines if line.startswith(field + " ")])
        shuffled = [next(ordered) if line.startswith(field + " ") else line for line in shuffled]
    assert loads(end.join(shuffled)) == scene


def parses(text: str | bytes, *, limits: bool) -> Scene | None:
    """The Scene, or None after a SceneError, whose places are in order and whose texts can be shown."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SceneWarning)
            return loads(text, limits=limits)
    except SceneError as error:
        diagnostics = error.errors
    places = [(found.line, found.column) for found in diagnostics if found.line]
    assert places
    assert places == sorted(places)
    assert len(diagnostics) <= 101
    for found in diagnostics:
        assert found.message
        assert not re.search("[\0-\x1f\x7f-\x9f]", found.message + found.hint + found.field)
    return None


@given(st.binary(), st.booleans())
def test_any_bytes(text: bytes, limits: bool) -> None:
    assert parses(text, limits=limits) is None


@given(st.text(st.characters(exclude_categories=())), st.booleans())
def test_any_text(text: str, limits: bool) -> None:
    assert parses(text, limits=limits) is None


PIECES = tuple(
    word.encode()
    for word in (
        *FIELDS.split(", "),
        *("\n", "\r", "\r\n", " ", "\t", "\0", "-", "+", ".", "e", ",", "#", "1e400", "1e-400", "1e100", "nan", "0x1"),
        *("0", "1", "99999999999999999999", "9223372036854775806", "\ufeff", "\u2212", "\u00a0", "x" * 70),
        *(BASE["SPHERE"] + "\n", BASE["LIGHT"] + "\n"),
    )
)


@st.composite
def mutations(draw: st.DrawFn) -> bytes:
    """A valid file with a few places deleted, doubled, overwritten or filled in."""
    text = bytearray(base().encode())
    for _ in range(draw(st.integers(0, 5))):
        start = draw(st.integers(0, len(text)))
        length = draw(st.integers(0, 40))
        kind = draw(st.sampled_from(("delete", "double", "piece", "bytes")))
        if kind == "delete":
            del text[start : start + length]
        elif kind == "double":
            at = draw(st.integers(0, len(text)))
            text[at:at] = text[start : start + length]
        else:
            text[start : start + length // 10] = draw(
                st.sampled_from(PIECES) if kind == "piece" else st.binary(max_size=3)
            )
    return bytes(text)


@settings(max_examples=400, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(), st.booleans())
def test_mutations_of_a_valid_file(text: bytes, limits: bool) -> None:
    scene = parses(text, limits=limits)
    if scene is not None:
        assert parses(scene.text(), limits=limits) == scene
        # What the parser accepts, the constructor accepts.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SceneWarning)
            assert scene.replace(limits=limits) == scene


# ----------------------------------------------------------------------------------------------------------------------
# Size


@pytest.mark.parametrize(
    "text",
    [
        "x y\n" * 100_000,
        "NEAR 1\n" * 100_000,
        "\r" * 1_000_000,
        "BACK" + " 1" * 500_000,
        "NEAR " + "1" * 2_000_000,
        "RES " + "x" * 2_000_000,
        "RES " + "," * 2_000_000 + " 1",
        "Q" * 2_000_000,
        "OUTPUT" + " " * 2_000_000,
        BASE["SPHERE"].replace(" s ", " " + "n" * 2_000_000 + " "),
    ],
    ids=["lines", "repeated", "CR", "parameters", "digits", "x", "commas", "word", "blanks", "name"],
)
def test_large_nonsense_is_refused_quickly(text: str) -> None:
    start = time.perf_counter()
    assert errors(text)
    # Linear code takes well under 0.1 s for each of these, quadratic code hours.
    assert time.perf_counter() - start < 10


def test_a_hundred_thousand_spheres() -> None:
    lines = "\n".join(f"SPHERE s{i} {i % 50_000} 0 -5 1 1 1 1 0 0 0 1 0 0 9" for i in range(100_000))
    with pytest.warns(SceneWarning) as caught:
        scene = loads(base(SPHERE=lines), limits=False)
    assert len(scene.spheres) == 100_000
    assert scene.distinct == tuple(range(50_000))
    assert str(caught[0].message).splitlines()[-1] == "<text>: warning: and 49900 more"
    assert [error.message for error in errors(base(SPHERE=lines))] == ["found 100000 spheres, expected at most 5"]
