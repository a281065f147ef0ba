"""Rules other than the specification's that truth can follow: a renderer's documented ones, and known mistakes.

A renderer that decides by a rule of its own says so in its `rules`; the judge takes such a rule for the cause of a
difference only if truth, following it, makes the same pixel. The mistakes are what programs for this specification get
wrong most often: truth that makes one and comes to the renderer's pixel tells its author what to look for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from flint import arb

from validation.follow import Follower, Hit, Sight, Vector
from validation.renderers import Settings

if TYPE_CHECKING:
    from tracer import Scene


@dataclass(frozen=True)
class Rule:
    """Another way to decide or to compute.

    `says`: a clause that follows a renderer's name, such as "ignores the near plane". `follower`: how truth follows it;
    `settings`: what else is different. `choices`: of a rule that leaves decisions open, every way to take some of them
    otherwise at column x, row y, the likeliest first; it stands in the place of `follower`. `wraps`: the colours are
    right, but in a file those above 1 begin again at 0. `hint`: what to do, of a mistake.
    """

    says: str
    follower: type[Follower] = Follower
    settings: Callable[[Settings], Settings] = field(default=lambda settings: settings)
    choices: Callable[[int, int], Iterator[type[Follower]]] | None = None
    wraps: bool = False
    hint: str = ""


class _NoNearPlane(Follower):
    def begins(self, bounce: int) -> int:
        del bounce
        return 0


class _NearPlaneEverywhere(Follower):
    def begins(self, bounce: int) -> int:
        del bounce
        return 1


class _NeverTurned(Follower):
    def turned(self, gradient: Vector, sphere: int, inside: bool) -> Vector:
        del sphere, inside
        return gradient


class _UnscaledNormal(Follower):
    """The normal is (x - p) / s where it should be (x - p) / s^2."""

    def turned(self, gradient: Vector, sphere: int, inside: bool) -> Vector:
        scaling = self.tables.numbers.vector(f"s{sphere}.scaling")
        x, y, z = (g * self.tables.lift(abs(s)) for g, s in zip(gradient, scaling, strict=True))
        return super().turned((x, y, z), sphere, inside)


class _SphereNormal(Follower):
    """The normal is x - p, as if every ellipsoid were a sphere."""

    def turned(self, gradient: Vector, sphere: int, inside: bool) -> Vector:
        scaling = self.tables.numbers.vector(f"s{sphere}.scaling")
        x, y, z = (g * self.tables.lift(s * s) for g, s in zip(gradient, scaling, strict=True))
        return super().turned((x, y, z), sphere, inside)


class _NoShadows(Follower):
    def casts(self, sphere: int, own: bool, light: int) -> bool:
        del sphere, own, light
        return False


class _NoOwnShadow(Follower):
    def casts(self, sphere: int, own: bool, light: int) -> bool:
        del sphere, light
        return not own


class _BehindTheLight(Follower):
    """A shadow ray does not end at the light."""

    def hides(self, hit: Hit, relative: Any, to_light: Vector, i: int, j: int) -> bool:
        _, gradient, C = relative
        sign, bounce, own = self.sign, hit.bounce, j == hit.sphere
        A = sum(w * d * d for w, d in zip(self.tables.w[j], to_light, strict=True))
        B = sum(g * d for g, d in zip(gradient, to_light, strict=True))
        slope = B + self.epsilon * A
        if own:
            return sign(-B - slope, "start", bounce, i, j) > 0
        if sign(C + self.epsilon * (B + slope), "start", bounce, i, j) < 0:
            return True
        return sign(slope, "ahead", bounce, i, j) < 0 and sign(B * B - A * C, "meets", bounce, i, j) >= 0


class _HalfVector(Follower):
    """N.H with H between L and V, in the place of R.V."""

    def highlight(self, hit: Hit, to_light: Vector, gl: Any, gg: Any) -> tuple[Any, Callable[[], Any]]:
        del gl
        lx, ly, lz = to_light
        dx, dy, dz = hit.direction
        gx, gy, gz = hit.gradient
        # H in the lengths of L: to_light - |to_light| d / |d|.
        share = ((lx * lx + ly * ly + lz * lz) / (dx * dx + dy * dy + dz * dz)).sqrt()
        hx, hy, hz = lx - share * dx, ly - share * dy, lz - share * dz
        return gx * hx + gy * hy + gz * hz, lambda: (gg * (hx * hx + hy * hy + hz * hz)).sqrt()


class _ColoredHighlight(Follower):
    def shade(self, hit: Hit, sight: Sight, to_light: Vector, gl: Any) -> None:
        super().shade(hit, sight, to_light, gl)
        if sight.specular is not None:
            color = self.tables.numbers.vector(f"s{hit.sphere}.color")
            x, y, z = (value * self.tables.lift(c) for value, c in zip(sight.specular, color, strict=True))
            sight.specular = x, y, z


class _FadingHighlight(Follower):
    def shade(self, hit: Hit, sight: Sight, to_light: Vector, gl: Any) -> None:
        super().shade(hit, sight, to_light, gl)
        if sight.specular is not None:
            x, y, z = (value * sight.cosine for value in sight.specular)
            sight.specular = x, y, z


class _NoAmbient(Follower):
    def illuminate(self, hit: Hit, relative: list[Any]) -> None:
        super().illuminate(hit, relative)
        hit.ambient = (0, 0, 0)


class _NoDiffuse(Follower):
    def shade(self, hit: Hit, sight: Sight, to_light: Vector, gl: Any) -> None:
        super().shade(hit, sight, to_light, gl)
        sight.diffuse = None


class _NoHighlight(Follower):
    def shade(self, hit: Hit, sight: Sight, to_light: Vector, gl: Any) -> None:
        super().shade(hit, sight, to_light, gl)
        sight.specular = None


class _Falloff(Follower):
    def shade(self, hit: Hit, sight: Sight, to_light: Vector, gl: Any) -> None:
        super().shade(hit, sight, to_light, gl)
        squared = sum(value * value for value in to_light)
        for name in ("diffuse", "specular"):
            term = getattr(sight, name)
            if term is not None:
                setattr(sight, name, tuple(value / squared for value in term))


class _ClampedMirror(Follower):
    def color(self, hit: Hit) -> Vector:
        x, y, z = (value if isinstance(value, int) else value.min(arb(1)) for value in super().color(hit))
        return x, y, z


class _MirroredBackground(Follower):
    def beyond(self) -> Vector | None:
        background: Vector = self.tables.background
        return background


#: What programs for this specification get wrong, the likeliest first.
MISTAKES = (
    Rule("ignores the near plane: primary hits count from t > 0 on", _NoNearPlane),
    Rule("lets the near plane, t > 1, limit reflected rays too", _NearPlaneEverywhere),
    Rule("keeps the outward normal on the inside of a sphere", _NeverTurned),
    Rule("divides the normal by the scaling once, not twice", _UnscaledNormal),
    Rule("takes the normal of a sphere for that of an ellipsoid", _SphereNormal),
    Rule("casts no shadows", _NoShadows),
    Rule("lets no sphere shadow itself", _NoOwnShadow),
    Rule("lets spheres behind a light hide it", _BehindTheLight),
    Rule("leaves out the ambient term", _NoAmbient),
    Rule("leaves out the diffuse term", _NoDiffuse),
    Rule("leaves out the highlight", _NoHighlight),
    Rule("takes N.H in the place of R.V", _HalfVector),
    Rule("multiplies the highlight by the sphere's color", _ColoredHighlight),
    Rule("multiplies the highlight by N.L", _FadingHighlight),
    Rule("lets light fall off with the square of the distance", _Falloff),
    Rule("clamps what a mirror shows to 1", _ClampedMirror),
    Rule("shows BACK where a reflected ray hits nothing", _MirroredBackground),
    Rule("does not clamp colors: those above 1 begin again at 0", wraps=True),
)

#: A mistake that shows at some pixels and not at others, as rounding has it: see validation.acne.
ACNE = Rule(
    "hides some lights behind the very sphere that the shadow ray starts on: shadow acne",
    hint="a shadow ray meets the surface it starts on again, near t = 0: let hits count from t > 0.0001 on; "
    "if they do, compute in double, or take a larger epsilon, or leave out the near root of the sphere it starts on",
)


def mistakes(scene: Scene, settings: Settings) -> Iterator[Rule]:
    """The mistakes that could show in a scene, those of sampling, shadow epsilon and bounces included."""
    for sample, says in (
        ("corner", "at the top-left corner of the pixels"),
        ("center", "at the centre of the pixels"),
        ("bottom-left", "at the bottom-left corner of the pixels"),
        ("top-right", "at the top-right corner of the pixels"),
        ("inclusive", "from the first column and row to the last, both on the border"),
    ):
        if sample != settings.sample:
            yield Rule(f"samples {says}", settings=lambda old, sample=sample: replace(old, sample=sample))  # type: ignore[misc]
    if scene.lights:
        for epsilon in (0.0, 1e-4, 1e-3, 1e-2):
            if epsilon != settings.shadow_epsilon:
                yield Rule(
                    f"begins shadow rays at t > {epsilon:g}, not {settings.shadow_epsilon:g}",
                    settings=lambda old, epsilon=epsilon: replace(old, shadow_epsilon=epsilon),  # type: ignore[misc]
                )
    if any(sphere.kr > 0 for sphere in scene.spheres):
        for bounces in range(6):
            if bounces != settings.max_reflections:
                yield Rule(
                    f"reflects {bounces} time{'s' * (bounces != 1)}, not {settings.max_reflections}",
                    settings=lambda old, bounces=bounces: replace(old, max_reflections=bounces),  # type: ignore[misc]
                )
    # The general after the special: without shadows all is lit that a large epsilon lights.
    yield from MISTAKES
