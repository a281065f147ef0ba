"""Hypothesis strategies for valid scenes and their parts."""

from __future__ import annotations

from hypothesis import strategies as st

from tracer import Light, Scene, Sphere, View

Vec3 = tuple[float, float, float]

SMALLEST, LARGEST = 1e-100, 1e100

fractions = st.sampled_from((0.0, 0.5, 1.0)) | st.floats(0.001, 1)
colors: st.SearchStrategy[Vec3] = st.tuples(fractions, fractions, fractions)
signs = st.sampled_from((1.0, -1.0))
exponents = st.sampled_from((0.0, 0.5, 1.0, 2.0, 50.0, 1000.0)) | st.floats(0, 200)
words = st.text("!#$*-./09AZ_az~\xe9\u03bb\u7403", min_size=1, max_size=6) | st.text(
    st.characters(min_codepoint=0x21, max_codepoint=0x7E), min_size=1, max_size=20
)


def magnitudes(*, extreme: bool = False) -> st.SearchStrategy[float]:
    """Positive lengths: 0.05 to 5, or all that the format allows."""
    return st.floats(SMALLEST, LARGEST) if extreme else st.floats(0.05, 5)


def coordinates(*, extreme: bool = False) -> st.SearchStrategy[float]:
    """Numbers of both signs and 0: up to 8 (multiples of 1/4 among them), or all that the format allows."""
    if extreme:
        return st.just(0.0) | st.builds(lambda value, sign: sign * value, magnitudes(extreme=True), signs)
    return st.integers(-32, 32).map(lambda quarters: quarters / 4) | st.floats(0.01, 8) | st.floats(-8, -0.01)


def vectors(*, extreme: bool = False) -> st.SearchStrategy[Vec3]:
    """Triples of coordinates."""
    return st.tuples(*[coordinates(extreme=extreme)] * 3)


@st.composite
def views(draw: st.DrawFn, *, extreme: bool = False, max_size: int = 12) -> View:
    """Frusta, off the centre too, with images of at most `max_size` columns and rows."""
    edges = coordinates(extreme=True) if extreme else st.integers(-24, 24).map(lambda eighths: eighths / 8)
    left, right = sorted(draw(st.lists(edges, min_size=2, max_size=2, unique=True)))
    bottom, top = sorted(draw(st.lists(edges, min_size=2, max_size=2, unique=True)))
    near = draw(magnitudes(extreme=True) if extreme else st.sampled_from((0.5, 1.0, 2.0)) | st.floats(0.25, 4))
    sizes = st.integers(1, max_size)
    return View(near=near, left=left, right=right, bottom=bottom, top=top, columns=draw(sizes), rows=draw(sizes))


@st.composite
def spheres(draw: st.DrawFn, *, extreme: bool = False) -> Sphere:
    """Ellipsoids; half of the moderate ones are round the view of `views()`, so that pixels see them."""
    position = draw(vectors(extreme=extreme))
    if not extreme and draw(st.booleans()):
        x, y, z = position
        position = (x, y, -abs(z) - 1)
    scaling = draw(st.tuples(*[magnitudes(extreme=extreme)] * 3))
    if draw(st.booleans()):
        scaling = (scaling[0],) * 3
    unit = st.floats(0, 1) if extreme else fractions
    flips = draw(st.just((1.0, 1.0, 1.0)) | st.tuples(signs, signs, signs))
    return Sphere(
        name=draw(words),
        position=position,
        scaling=(flips[0] * scaling[0], flips[1] * scaling[1], flips[2] * scaling[2]),
        color=draw(st.tuples(unit, unit, unit)),
        ka=draw(unit),
        kd=draw(unit),
        ks=draw(unit),
        kr=draw(unit),
        exponent=draw(st.floats(0, allow_infinity=False) if extreme else exponents),
    )


@st.composite
def lights(draw: st.DrawFn, *, extreme: bool = False) -> Light:
    """Lights, some of them negative or dark."""
    intensity = vectors(extreme=True) if extreme else colors | vectors()
    return Light(name=draw(words), position=draw(vectors(extreme=extreme)), intensity=draw(intensity))


def _place(sphere: Sphere) -> tuple[Vec3, Vec3]:
    x, y, z = sphere.scaling
    return sphere.position, (abs(x), abs(y), abs(z))


@st.composite
def scenes(
    draw: st.DrawFn, *, extreme: bool = False, max_size: int = 12, max_spheres: int = 5, max_lights: int = 5
) -> Scene:
    """Valid scenes without duplicate spheres.

    By default their numbers are moderate and their images small, so that they can be rendered and compared; `extreme`
    draws from all that the format allows. More than five spheres or lights need `limits=False` when they are parsed.
    """
    numbers = st.floats(allow_nan=False, allow_infinity=False) if extreme else fractions
    return Scene(
        view=draw(views(extreme=extreme, max_size=max_size)),
        spheres=draw(st.lists(spheres(extreme=extreme), max_size=max_spheres, unique_by=_place)),
        lights=draw(st.lists(lights(extreme=extreme), max_size=max_lights)),
        background=draw(st.tuples(numbers, numbers, numbers)),
        ambient=draw(vectors(extreme=True) if extreme else colors),
        output=draw(words),
        limits=False,
    )
