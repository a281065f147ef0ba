"""Explains one pixel: what truth says its ray does, bounce by bounce, and where each renderer first differs from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import arb, ctx, fmpq

from tracer.passes import MARGINS, lookup, names, quantise
from validation import records
from validation.compare import Judge
from validation.court import distance
from validation.encoding import Encoding
from validation.flips import Flip, flipped, flips
from validation.follow import Hit, Key, Vector
from validation.records import Record
from validation.renderers import Renderer, Settings, Uncertainty
from validation.run import (
    ANALYSIS_MAX_PIXELS,
    InputError,
    RendererError,
    analyse,
    blaming,
    draw,
    encoding_of,
    shrink,
    versions,
    why_not,
)
from validation.truth import NOWHERE, Ball, Prover, Tie, Truth
from validation.verdict import Court, Side

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis

Triple = tuple[Ball, Ball, Ball]

#: Bits of the numbers that are shown: far more than are shown, so that what prints as equal is equal or very near.
BITS = 512
#: A sphere is said to stand just behind a light up to this t of the shadow ray.
JUST_BEHIND = 1.1
#: The decisions nearest to turning take a walk along the chain for each number of the scene.
MOST_OBJECTS = 50

#: The smallest float64 above 0, and its exponent.
SMALLEST, SMALLEST_EXPONENT = 5e-324, -1074

SMALL_ENOUGH = "--size {}x{} is small enough; the columns and rows are then others"

#: Exact; a renderer is held against truth by its own uncertainty alone.
CERTAIN = Uncertainty(0.0, 0.0, 0.0, 0.0, 0.0)


# ---- what there is to say


@dataclass(frozen=True)
class Crossing:
    """A sphere and the line of a ray.

    `what`: "hit"; "farther": a hit behind the nearest; "before": met, but only where the ray does not count yet;
    "missed". `roots`: t of its hits, ascending, one where the line touches. `radii`: how far the line passes from the
    centre, with the sphere's scalings as the unit: 1 is the outline; `closest`: t there.
    """

    sphere: int
    what: str
    roots: tuple[Ball, ...]
    radii: Ball
    closest: Ball


@dataclass(frozen=True)
class LightSeen:
    """One light from a hit.

    `state`: "visible", "hidden", "behind" (N.L is not above 0), "here" (the light is at the point itself), "useless"
    (the sphere shows nothing of it). `blockers`: the spheres that hide it, each with t of the shadow ray, 0 at the
    point and 1 at the light. `beside`: spheres on that line that do not count, with t. `diffuse`, `specular`: what
    they add to the pixel.
    """

    light: int
    state: str
    cosine: Ball | None = None
    shine: Ball | None = None
    blockers: tuple[tuple[int, Ball], ...] = ()
    beside: tuple[tuple[int, Ball], ...] = ()
    diffuse: Triple | None = None
    specular: Triple | None = None


@dataclass(frozen=True)
class Bounce:
    """One ray of the chain, 0 the primary one, and what it hits: `sphere` -1 is nothing.

    `weight`: product of the Kr's before. `ambient` and the terms of `lights` carry it. `total`: the pixel so far.
    """

    bounce: int
    weight: Ball
    origin: Triple
    direction: Triple
    crossings: tuple[Crossing, ...]
    total: Triple
    sphere: int = -1
    t: Ball | None = None
    distance: Ball | None = None
    inside: bool = False
    touches: bool = False
    point: Triple | None = None
    normal: Triple | None = None
    ambient: Triple | None = None
    lights: tuple[LightSeen, ...] = ()


@dataclass(frozen=True)
class Call:
    """The decision of a kind that the smallest change would turn: `margin` is that relative change, to first order."""

    key: Key
    margin: float


@dataclass(frozen=True)
class Difference:
    """A pass in which a renderer is off by more than it may be.

    `error`: of the worst channel, of a normal the length of the difference. `edge`: kinds of decisions that it may take
    either way here, each with the margin and what it can tell; `unbounded`: it claims no bound here.
    """

    name: str
    error: float
    tolerance: float
    edge: tuple[tuple[str, float, float], ...]
    unbounded: bool


@dataclass(frozen=True)
class Drawn:
    """What a renderer made of the pixel. `reason`: why there is nothing, `hint`: what to do; `failed`: it should have
    drawn, and did not.

    `differences` are in the order of computation. `encoding`: how `levels` stand for colours; None: it drew colours.
    """

    renderer: str
    reason: str = ""
    hint: str = ""
    failed: bool = False
    values: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    levels: tuple[int, int, int] | None = None
    encoding: Encoding | None = None
    differences: tuple[Difference, ...] = ()
    verdict: str = ""


@dataclass(frozen=True)
class Explanation:
    """Everything about one pixel, column x and row y."""

    label: str
    scene: Scene
    settings: Settings
    x: int
    y: int
    direction: tuple[fmpq, fmpq, fmpq]
    truth: Truth
    levels: tuple[int, int, int]
    bounces: tuple[Bounce, ...]
    end: str
    margins: Mapping[str, float]
    calls: Mapping[str, Call]
    drawn: tuple[Drawn, ...]
    notes: tuple[str, ...]
    versions: Mapping[str, str]
    command: Sequence[str] = ()

    @property
    def ties(self) -> tuple[Tie, ...]:
        """Decisions that are exactly even."""
        return self.truth.ties

    @property
    def failed(self) -> bool:
        """Whether a renderer failed."""
        return any(entry.failed for entry in self.drawn)

    def record(self) -> Record:
        """Everything as strictly valid JSON. Numbers are the float64 nearest to the exact ones."""
        truth = self.truth
        fields = {
            "command": list(self.command),
            "versions": self.versions,
            "scene": self.label,
            "size": [self.scene.view.columns, self.scene.view.rows],
            "x": self.x,
            "y": self.y,
            "settings": vars(self.settings).copy(),
            "ok": not self.failed,
            "direction": [str(value) for value in self.direction],
            "truth": {name: [ball.value for ball in balls] for name, balls in truth.values.items()},
            "levels": self.levels,
            "bits": truth.bits,
            "margins": dict(self.margins),
            "decisions": {
                kind: {"text": decision(self.scene, call.key), "margin": call.margin, **call.key._asdict()}
                for kind, call in self.calls.items()
            },
            "bounces": [_plain(bounce) for bounce in self.bounces],
            "end": self.end,
            "ties": [
                {
                    "text": evenness(self.scene, tie.key, self.settings),
                    "proved": tie.proved,
                    "settled": tie.settled,
                    "outcomes": tie.outcomes,
                    **tie.key._asdict(),
                }
                for tie in truth.ties
            ],
            "renderers": [self._record_of(drawn) for drawn in self.drawn],
            "notes": self.notes,
        }
        return records.result("explain", fields)

    def _record_of(self, drawn: Drawn) -> Record:
        differences = [_plain(entry) for entry in drawn.differences]
        entry: Record = {
            "renderer": drawn.renderer,
            "drawn": not drawn.reason,
            "reason": drawn.reason,
            "failed": drawn.failed,
            "values": dict(drawn.values),
            "levels": drawn.levels,
            "quantisation": drawn.encoding and drawn.encoding.quantisation,
            "agrees": None if drawn.reason else not differences,
            "first_difference": differences[0]["name"] if differences else None,
            "differences": differences,
            "verdict": drawn.verdict,
        }
        return entry


def _plain(value: Any) -> Any:
    """A dataclass of ours as JSON holds it."""
    if isinstance(value, Ball):
        return value.value
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: _plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return value


# ---- in words


def of_sphere(scene: Scene, j: int) -> str:
    """A sphere by its number in the file, from 0, and its name."""
    return f"sphere {j} '{scene.spheres[j].name}'"


def of_light(scene: Scene, i: int) -> str:
    """A light likewise."""
    return f"light {i} '{scene.lights[i].name}'"


def of_ray(bounce: int) -> str:
    """Which ray of the chain."""
    return f"reflected ray {bounce}" if bounce else "primary ray"


def of_hit(bounce: int) -> str:
    """Which hit of the chain."""
    return f"hit of reflection {bounce}" if bounce else "primary hit"


def decision(scene: Scene, key: Key) -> str:
    """Which decision, as a thing that a small change may turn."""
    sphere = of_sphere(scene, key.sphere)
    at = f", in reflection {key.bounce}" * bool(key.bounce)
    if key.light >= 0:
        light = of_light(scene, key.light)
        border = f"the border of the shadow that {sphere} casts from {light}"
        return {
            "meets": border,
            "ahead": border,
            "start": f"{sphere} and the start of the shadow ray to {light}",
            "end": f"{sphere} and the end of the shadow ray to {light}",
            "at": f"whether {light} is at the point itself",
            "side": f"on which side of the surface of {sphere} {light} is",
            "faces": f"the sign of N.L of {light} on {sphere}",
            "shines": f"the sign of R.V of {light} on {sphere}",
        }[key.what] + at
    if key.what == "order":
        return f"which is nearer, {sphere} or {of_sphere(scene, key.other)}" + at
    if key.what == "start":
        return f"{sphere} and the {'start of the ray' if key.bounce else 'near plane'}" + at
    return f"the outline of {sphere}" + at


def evenness(scene: Scene, key: Key, settings: Settings) -> str:
    """What is exactly even in a tie."""
    sphere = of_sphere(scene, key.sphere)
    begin = "where it starts" if key.bounce else "at the near plane, t = 1"
    line = f"the {of_ray(key.bounce)}"
    if key.light >= 0:
        line = f"the shadow ray to {of_light(scene, key.light)}"
        begin = f"at the shadow epsilon, t = {settings.shadow_epsilon:g}"
    return {
        "meets": f"{line} touches {sphere} exactly",
        "ahead": f"{line} touches {sphere} exactly {begin}",
        "start": f"{line} meets {sphere} exactly {begin}",
        "end": f"{line} touches {sphere} exactly at the light, t = 1",
        "order": f"{sphere} and {of_sphere(scene, key.other)} are hit at exactly the same t" if key.other >= 0 else "",
        "faces": f"N.L is exactly 0 for {line.removeprefix('the shadow ray to ')}",
        "shines": f"R.V is exactly 0 for {line.removeprefix('the shadow ray to ')}",
        "at": f"{line.removeprefix('the shadow ray to ')} is exactly at the point",
        "side": f"{line.removeprefix('the shadow ray to ')} is exactly on {sphere}",
    }[key.what]


# ---- the chain


def _ball(value: Any) -> Ball:
    """As a number to show: what is below every float64 is 0."""
    return _seen(Ball.of(arb(value)))


def _seen(ball: Ball) -> Ball:
    """A power such as (R.V)^n may have an exponent of so many digits that nothing can be computed with it."""
    if ball.mantissa and ball.mantissa.bit_length() + ball.exponent < SMALLEST_EXPONENT:
        return Ball(0, 0, SMALLEST)
    return ball


def _triple(values: Sequence[Any]) -> Triple:
    x, y, z = (_ball(value) for value in values)
    return x, y, z


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True)
class _Ray:
    """A ray of the chain; `own`: the sphere it starts on, -1 the eye; `inside`: whether it starts into that."""

    bounce: int
    weight: Any
    origin: Vector
    direction: Vector
    own: int = -1
    inside: bool = False


class _Teller:
    """Goes along the chain that the prover found and works out what that does not say, in balls of BITS bits."""

    def __init__(self, prover: Prover) -> None:
        self.prover, self.scene, self.settings = prover, prover.scene, prover.settings
        of = prover.numbers
        spheres, lights = range(len(self.scene.spheres)), range(len(self.scene.lights))
        self.position = [tuple(arb(a) for a in of.vector(f"s{j}.position")) for j in spheres]
        self.w = [tuple(1 / arb(a) ** 2 for a in of.vector(f"s{j}.scaling")) for j in spheres]
        self.light = [tuple(arb(a) for a in of.vector(f"l{i}.position")) for i in lights]
        self.kr = [arb(of.of[f"s{j}.kr"]) for j in spheres]

    def bounces(self, x: int, y: int) -> tuple[list[Bounce], str]:
        """Every ray of the pixel's chain, the last one perhaps without a hit, and why the chain ends."""
        hits, _ = self.prover.examine(x, y, bits=BITS)
        zero = arb(0)
        dx, dy, dz = (arb(entry) for entry in self.prover.direction(x, y))
        ray = _Ray(0, arb(1), (zero, zero, zero), (dx, dy, dz))
        total: Vector = (zero, zero, zero)
        found: list[Bounce] = []
        for hit in hits:
            total, told = self.hit(ray, hit, total)
            found.append(told)
            if self.kr[hit.sphere] == 0:
                return found, f"Kr of {of_sphere(self.scene, hit.sphere)} is 0, so nothing is reflected"
            if hit.bounce == (most := self.settings.max_reflections):
                count = {1: "one reflected ray", 3: "three reflected rays"}.get(most, f"{most} reflected rays")
                return found, f"a chain has {count} at most, and there has been that many"
            weight = ray.weight * self.kr[hit.sphere]
            ray = _Ray(hit.bounce + 1, weight, hit.point, self.reflected(hit), hit.sphere, hit.inside)
        if hits:
            why = "the reflected ray hits nothing, which adds black: BACK is for primary rays alone"
        else:
            total = tuple(arb(value) for value in self.prover.numbers.vector("background"))  # type: ignore[assignment]
            why = "the ray hits nothing, so the pixel is BACK"
        found.append(self.told(ray, None, total))
        return found, why

    def reflected(self, hit: Hit) -> Vector:
        """The mirror: d - 2 (d.N) N."""
        slant = 2 * _dot(hit.direction, hit.gradient) / _dot(hit.gradient, hit.gradient)
        x, y, z = (d - slant * g for d, g in zip(hit.direction, hit.gradient, strict=True))
        return x, y, z

    def told(self, ray: _Ray, hit: Hit | None, total: Vector, **more: Any) -> Bounce:
        """A ray as a Bounce."""
        return Bounce(
            ray.bounce,
            _ball(ray.weight),
            _triple(ray.origin),
            _triple(ray.direction),
            self.crossings(ray, hit),
            _triple(total),
            **more,
        )

    def hit(self, ray: _Ray, hit: Hit, total: Vector) -> tuple[Vector, Bounce]:
        """One hit, and the colour of the pixel with it."""
        length = _dot(hit.gradient, hit.gradient).sqrt()
        normal = tuple(g / length for g in hit.gradient)
        ambient = [ray.weight * value for value in hit.ambient]
        lights = [self.seen(ray, hit, normal, i) for i in range(len(self.scene.lights))]
        terms = [ambient]
        for sight in hit.sights:
            terms += [[ray.weight * value for value in term] for term in (sight.diffuse, sight.specular) if term]
        red, green, blue = (sum((term[k] for term in terms), total[k]) for k in range(3))
        total = red, green, blue
        return total, self.told(
            ray,
            hit,
            total,
            sphere=hit.sphere,
            t=_ball(hit.t),
            distance=_ball(hit.t * _dot(hit.direction, hit.direction).sqrt()),
            inside=hit.inside,
            touches=hit.touches,
            point=_triple(hit.point),
            normal=_triple(normal),
            ambient=_triple(ambient),
            lights=tuple(lights),
        )

    def crossings(self, ray: _Ray, hit: Hit | None) -> tuple[Crossing, ...]:
        """Every sphere and the ray's line: those met in the order of t, then those missed, the nearest miss first."""
        begins = 0 if ray.bounce else 1
        met: list[tuple[float, Crossing]] = []
        missed: list[tuple[float, Crossing]] = []
        for j in self.scene.distinct:
            if j == ray.own and not ray.inside:
                continue  # it starts there, and leaves
            d, m, w = ray.direction, [a - b for a, b in zip(ray.origin, self.position[j], strict=True)], self.w[j]
            A = sum(a * b * b for a, b in zip(w, d, strict=True))
            B = sum(a * b * c for a, b, c in zip(w, m, d, strict=True))
            C = sum(a * b * b for a, b in zip(w, m, strict=True)) - 1
            roots: list[Any] = []
            D = B * B - A * C
            if j == ray.own:
                roots = [arb(0), -2 * B / A]
            elif D > 0:
                roots = [(-B - D.sqrt()) / A, (-B + D.sqrt()) / A]
            elif not D < 0:
                roots = [-B / A]
            counting = [float(root.mid()) for root in roots if root > begins]
            is_hit = hit is not None and j == hit.sphere
            what = "hit" if is_hit else "farther" if counting else "before" if roots else "missed"
            # |l|^2 = 1 + C - B^2 / A at the point l of the line that is closest to the centre.
            squared = 1 - D / A
            radii = squared.sqrt() if squared > 0 else arb(0)
            entry = Crossing(j, what, tuple(_ball(root) for root in roots), _ball(radii), _ball(-B / A))
            if roots:
                met.append((counting[0] if counting else math.inf, entry))
            else:
                missed.append((float(radii.mid()), entry))
        ordered = sorted(met, key=lambda pair: (pair[1].what != "hit", pair[0]))
        return tuple(entry for _, entry in (*ordered, *sorted(missed, key=lambda pair: pair[0])))

    def seen(self, ray: _Ray, hit: Hit, normal: Sequence[Any], i: int) -> LightSeen:
        """One light from a hit."""
        sphere, intensity = self.scene.spheres[hit.sphere], self.scene.lights[i].intensity
        useful = any(sphere.kd and a and b for a, b in zip(intensity, sphere.color, strict=True))
        useful |= sphere.ks > 0 and any(intensity)
        to_light = [a - b for a, b in zip(self.light[i], hit.point, strict=True)]
        distance = _dot(to_light, to_light)
        sight = next((sight for sight in hit.sights if sight.light == i), None)
        if not distance > 0:
            return LightSeen(i, "here")
        NL = _dot(normal, to_light) / distance.sqrt()
        # R.V with R = 2 (N.L) N - L and V = -d / |d|
        length = (distance * _dot(hit.direction, hit.direction)).sqrt()
        RV = _dot(to_light, hit.direction) / length
        RV -= 2 * NL * _dot(normal, hit.direction) * distance.sqrt() / length
        cosine, shine = _ball(NL), _ball(RV)
        if sight is None:
            return LightSeen(i, "useless", cosine, shine)
        blockers = [(j, self.crosses(hit, i, j)) for j in sight.blockers]
        blockers.sort(key=lambda pair: pair[1].value)
        if sight.faces <= 0:
            return LightSeen(i, "behind", cosine, shine, tuple(blockers))
        if blockers:
            return LightSeen(i, "hidden", cosine, shine, tuple(blockers))
        diffuse, specular = (
            None if term is None else _triple([ray.weight * value for value in term])
            for term in (sight.diffuse, sight.specular)
        )
        state = "visible" if useful else "useless"
        return LightSeen(i, state, cosine, shine, (), tuple(self.beside(hit, i)), diffuse, specular)

    def crosses(self, hit: Hit, i: int, j: int) -> Ball:
        """Where on its way to light i a shadow ray meets sphere j, which hides it."""
        roots = self.prover.crossings(hit, i, j)
        within = [root for root in roots if self.settings.shadow_epsilon < root < 1]
        return _ball((within or list(roots))[0])

    def beside(self, hit: Hit, i: int) -> Iterator[tuple[int, Ball]]:
        """Spheres that a shadow ray meets before it begins to count, or at the light and just behind it."""
        for j in self.scene.distinct:
            for root in self.prover.crossings(hit, i, j):
                t = _ball(root)
                if 0 < t.value <= self.settings.shadow_epsilon or 1 <= t.value <= JUST_BEHIND:
                    yield j, t
                    break


# ---- the decisions that are nearest to turning


def close_calls(prover: Prover, truth: Truth, bounces: Sequence[Bounce]) -> dict[str, Call]:
    """By kind the decision that the smallest relative change of the ray and of the scene's numbers turns.

    A decision that changes nothing that is seen does not count. Empty for a scene of so many numbers that it would take
    long.
    """
    if len(prover.scene.spheres) + len(prover.scene.lights) > MOST_OBJECTS:
        return {}
    found = flips(prover, truth.x, truth.y)
    hits, _ = prover.examine(truth.x, truth.y)

    def met(key: Key) -> bool:
        if key.light >= 0:
            return bool(prover.crossings(hits[key.bounce], key.light, key.sphere))
        return any(entry.roots for entry in bounces[key.bounce].crossings if entry.sphere == key.sphere)

    calls: dict[str, Call] = {}
    for flip in found:
        if flip.kind not in calls and math.isfinite(flip.margin) and _matters(prover, truth, flip, hits, met):
            calls[flip.kind] = Call(flip.key, flip.margin)
    return calls


def _matters(prover: Prover, truth: Truth, flip: Flip, hits: Sequence[Hit], met: Callable[[Key], bool]) -> bool:
    """Whether the pixel jumps when a decision goes the other way; `met`: whether its line meets its sphere."""
    key, hit = flip.key, hits[min(flip.key.bounce, len(hits) - 1)] if hits else None
    if key.light >= 0 and hit is not None:
        sight = next(sight for sight in hit.sights if sight.light == key.light)
        sphere = prover.scene.spheres[hit.sphere]
        if key.what == "faces" and key.bounce == 0:
            # The shadow is compared where N.L > 0.
            return not any(j != hit.sphere for j in sight.blockers)
        if (key.what == "faces" and sphere.ks == 0) or (key.what == "shines" and sphere.exponent >= 1):
            return False  # the term comes to 0 there
        if key.what == "start" and key.sphere == hit.sphere and not hit.inside:
            return False  # from outside its own sphere never hides a light
        if key.bounce == 0 and sight.faces <= 0:
            return False
    if key.what in ("start", "end") and not met(key):
        return False  # the line would have to meet the sphere first
    try:
        turned = flipped(prover, truth.x, truth.y, flip)
    except NOWHERE:  # no pixel has this decision alone the other way
        return False
    return any(
        not (a == b or (a.mantissa is not None and b.mantissa is not None and a.arb().overlaps(b.arb())))
        for name, balls in truth.values.items()
        for a, b in zip(balls, turned.values[name], strict=True)
    )


# ---- the renderers


def order(lights: int, max_reflections: int) -> list[str]:
    """The passes in the order in which they are worked out: the first that differs is nearest to the cause."""
    shadows = [f"shadow.L{i}" for i in range(lights)]
    bounces = [f"reflection.{k}" for k in range(1, max_reflections + 1)]
    first = ["id", "depth", "position", "normal", "ambient", *shadows, "diffuse", "specular", "direct"]
    return [*first, *bounces, "reflection", "beauty"]


def look(
    renderer: Renderer,
    scene: Scene,
    label: str,
    settings: Settings,
    truth: Truth,
    lit: Sequence[bool],
    analysis: Analysis,
) -> Drawn:
    """Draw the scene with a renderer, and hold the pixel against truth; `lit`: by light whether N.L > 0."""
    every, x, y = names(len(scene.lights), settings.max_reflections, margins=False), truth.x, truth.y
    view, name = scene.view, renderer.name
    try:
        with blaming():
            if reason := renderer.unavailable():
                return Drawn(name, f"is not available: {reason}")
            wanted = [entry for entry in every if entry in renderer.passes(scene, settings)]
            if not wanted:
                return Drawn(name, f"cannot carry this scene: {why_not(renderer, scene)}".removesuffix(": "))
            most = renderer.max_pixels(scene, wanted)
            if most is not None and most < view.columns * view.rows:
                size = f"{view.columns}x{view.rows}"
                columns, rows = shrink(view.columns, view.rows, most)
                return Drawn(
                    name,
                    f"would take too long at {size}: it draws up to {most} pixels of this scene",
                    SMALL_ENOUGH.format(columns, rows),
                )
            drawn = draw(renderer, label, scene, wanted, settings)
            for entry in wanted:
                if entry not in drawn or drawn[entry].shape[:2] != (view.rows, view.columns):
                    raise RendererError(f"failed: it did not deliver the pass '{entry}' of the size of the scene")
            claim = renderer.uncertainty(scene, settings, analysis)
    except InputError as error:
        reason = " ".join(str(error).removeprefix(f"{label}: error: ").split())
        return Drawn(name, f"cannot carry this scene: {reason}")
    except RendererError as error:
        return Drawn(name, str(error), failed=True)
    values = {entry: tuple(float(v) for v in np.atleast_1d(drawn[entry][y, x])) for entry in wanted}
    levels, encoding = None, encoding_of(renderer, drawn)
    if "beauty" in drawn:
        color = drawn["beauty"][y, x]
        red, green, blue = (int(level) for level in (np.rint(color * encoding.steps) if encoding else quantise(color)))
        levels = red, green, blue
    judge = Judge(scene, settings, analysis, claim, CERTAIN)
    found = [
        difference
        for entry in order(len(scene.lights), settings.max_reflections)
        if entry in values and (difference := _difference(entry, values, truth, lit, judge, encoding))
    ]
    verdict, failed = "", False
    try:
        if found:
            side = Side(renderer, drawn, claim, encoding)
            verdict = judged(scene, settings, truth, side, analysis)
    except RendererError as error:
        verdict, failed = f"No verdict: {error}.", True
    return Drawn(
        name,
        failed=failed,
        values=values,
        levels=levels,
        encoding=encoding,
        differences=tuple(found),
        verdict=verdict,
    )


def too_large(scene: Scene) -> str:
    """Why no renderer draws a scene here."""
    return f"{scene.view.columns}x{scene.view.rows} pixels take too long to draw: truth alone"


def small_enough(scene: Scene, settings: Settings, renderers: Sequence[Renderer]) -> str:
    """What to do: the size that the renderers draw."""
    every = names(len(scene.lights), settings.max_reflections, margins=False)
    most = ANALYSIS_MAX_PIXELS
    for renderer in renderers:
        with suppress(RendererError), blaming():
            wanted = [name for name in every if name in renderer.passes(scene, settings)]
            limit = renderer.max_pixels(scene, wanted) if wanted else None
            most = most if limit is None else min(most, limit)
    columns, rows = shrink(scene.view.columns, scene.view.rows, most)
    return SMALL_ENOUGH.format(columns, rows)


def _difference(
    name: str,
    values: Mapping[str, tuple[float, ...]],
    truth: Truth,
    lit: Sequence[bool],
    judge: Judge,
    encoding: Encoding | None = None,
) -> Difference | None:
    """How a pass of a renderer differs from truth, if by more than it may; of levels from what these stand for."""
    quantity, x, y = lookup(name).quantity, truth.x, truth.y
    balls, seen = truth.values[name], values[name]
    hit = truth.id >= 0
    if quantity not in ("id", "color") and hit != (int(values.get("id", (truth.id,))[0]) >= 0):
        return None  # the pass `id` says it
    if quantity == "visibility" and hit and not lit[int(name.removeprefix("shadow.L"))]:
        return None  # no light from behind the surface
    off = [ball.error(value) for ball, value in zip(balls, seen, strict=True)]
    if encoding and name == "beauty":
        off = [distance(name, seen, balls, encoding)]
    off = [math.inf if math.isnan(entry) else entry for entry in off]
    error = math.hypot(*off) if quantity == "normal" else max(off)
    allowed = judge.tolerance(name)
    tolerance = float(allowed[y, x]) if hit or quantity == "color" else 0.0
    unbounded = not math.isfinite(tolerance)
    edges = judge.edge(name)
    # Without a bound of its own a pixel is held to the largest bound of the others, as in every comparison.
    limit = float(allowed[~edges].max(initial=0.0)) if unbounded else tolerance
    if error <= limit:
        return None
    kinds = []
    for kind, margin in judge.analysis.behind(name).items():
        least = float(np.broadcast_to(getattr(judge.renderer, kind), edges.shape)[y, x])
        if not margin[y, x] >= least:
            kinds.append((kind, float(margin[y, x]), least))
    return Difference(name, error, tolerance, tuple(kinds), unbounded)


def judged(
    scene: Scene,
    settings: Settings,
    truth: Truth,
    side: Side,
    analysis: Analysis,
) -> str:
    """The judge's sentence about a renderer that differs at this pixel; "" where it is within what it claims."""
    finding = Court(scene, settings, analysis).find(truth, side, tuple(side.passes))
    if finding.right or finding.decision is None:
        return ""
    excused = "" if finding.explained else "Not excused. "
    return f"{excused}Verdict: it {finding.decision.says}: {finding.because}."


# ---- everything together


def explain(
    scene: Scene,
    x: int,
    y: int,
    settings: Settings | None = None,
    renderers: Sequence[Renderer] = (),
    *,
    label: str = "scene",
    progress: Callable[[str], None] | None = None,
    command: Sequence[str] = (),
) -> Explanation:
    """Explain column x, row y of a scene, and hold renderers against it.

    Raises:
        IndexError: there is no such pixel.
        UnprovedError: truth could not be had at any precision.
    """
    settings = settings or Settings()
    say = progress or (lambda _: None)
    prover = Prover(scene, settings)
    say(f"{label}: proving the pixel")
    truth = prover.pixel(x, y)
    seen = {name: tuple(_seen(ball) for ball in balls) for name, balls in truth.values.items()}
    truth = replace(truth, values=seen)
    with ctx.workprec(BITS):
        bounces, end = _Teller(prover).bounces(x, y)
        calls = close_calls(prover, truth, bounces)
    notes: list[str] = []
    margins: dict[str, float] = {}
    drawn: list[Drawn] = []
    if scene.view.columns * scene.view.rows > ANALYSIS_MAX_PIXELS:
        notes.append(f"{too_large(scene)}; {small_enough(scene, settings, ())}")
    else:
        say(f"{label}: finding the margins")
        analysis = analyse(scene, settings)
        margins = {kind: float(analysis.margins[kind][y, x]) for kind in MARGINS}
        lit = [seen.state not in ("behind", "here") for seen in bounces[0].lights]
        for renderer in renderers:
            say(f"{label}: {renderer.name}")
            entry = look(renderer, scene, label, settings, truth, lit, analysis)
            drawn.append(entry)
    direction = prover.direction(x, y)
    return Explanation(
        label,
        scene,
        settings,
        x,
        y,
        direction,
        truth,
        _levels(truth.values["beauty"]),
        tuple(bounces),
        end,
        margins,
        calls,
        tuple(drawn),
        tuple(notes),
        versions([renderer for renderer, entry in zip(renderers, drawn, strict=False) if not entry.reason]),
        tuple(command),
    )


def _levels(color: Sequence[Ball]) -> tuple[int, int, int]:
    """The 8-bit value of an exact colour: clamped, times 255, truncated."""
    red, green, blue = (int((min(max(ball.middle(), fmpq(0)), fmpq(1)) * 255).floor()) for ball in color)
    return red, green, blue
