"""Where two chains of hits part: the first decision that a renderer and truth took otherwise, in words and numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from validation.follow import KINDS, Hit, Sight
from validation.truth import Prover

if TYPE_CHECKING:
    from tracer import Scene
    from validation.flips import Flip

#: Passes that are sums of others: what is off in a part is told of the part.
SUMS = ("direct", "reflection", "beauty")


@dataclass(frozen=True)
class Decision:
    """What truth and a renderer decided otherwise, first along the chain of hits.

    `kind`: as margins have it, or "value" where all decisions are the same; the rest is then the decision that the
    pixel is so near to that its values are off, if there is one. `bounce` 0 is the primary ray. `t` counts along the
    ray, or from the surface, 0, to the light, 1. `says`: a clause that follows the renderer's name.
    """

    kind: str
    says: str
    pattern: str  # the same without numbers: what a group of pixels has in common
    bounce: int = 0
    light: int | None = None
    sphere: int | None = None
    t: float | None = None


def sphere_name(scene: Scene, sphere: int) -> str:
    """Its name, and where others have the same its index."""
    return _named([entry.name for entry in scene.spheres], sphere, "id ")


def light_name(scene: Scene, light: int) -> str:
    """Its name, and where others have the same its index, as passes have it."""
    return _named([entry.name for entry in scene.lights], light, "L")


def _named(names: Sequence[str], index: int, prefix: str) -> str:
    name = names[index]
    return f"'{name}' ({prefix}{index})" if Counter(names)[name] > 1 else f"'{name}'"


def reflections(bounce: int) -> str:
    """As a clause."""
    return f" after {bounce} reflection{'s' * (bounce > 1)}" if bounce else ""


def part(truth: Prover, other: Prover, x: int, y: int) -> Decision | None:
    """The first decision that two proofs of a pixel take otherwise, told from the side of `other`; None: no such."""
    hits, _ = truth.examine(x, y)
    others, _ = other.examine(x, y)
    signs, other_signs = truth.signs(x, y), other.signs(x, y)

    def kind(bounce: int, light: int) -> str:
        for key, sign in signs.items():
            if key.bounce == bounce and key.light == light and other_signs.get(key, sign) != sign:
                return KINDS[key.what]
        return "range"

    for bounce in range(max(len(hits), len(others))):
        a = hits[bounce] if bounce < len(hits) else None
        b = others[bounce] if bounce < len(others) else None
        if a is None or b is None or a.sphere != b.sphere or a.inside != b.inside:
            says, pattern = _hit(truth.scene, a, b, reflections(bounce))
            first = b if a is None or (b is not None and middle(b.t) < middle(a.t)) else a
            assert first is not None
            return Decision(kind(bounce, -1), says, pattern, bounce, None, first.sphere, middle(first.t))
        for sight, seen in zip(a.sights, b.sights, strict=False):
            found = _light(truth, other, a, sight, b, seen)
            if found is not None:
                says, pattern, sphere, t = found
                return Decision(kind(bounce, sight.light), says, pattern, bounce, sight.light, sphere, t)
    return None


def _hit(scene: Scene, a: Hit | None, b: Hit | None, after: str) -> tuple[str, str]:
    """How the hit b differs from the true one, a: with numbers and without."""
    if a is None:
        assert b is not None
        name = sphere_name(scene, b.sphere)
        return f"hits {name}{after} at t = {middle(b.t):.7g}, where the ray passes by", f"hits {name}{after} wrongly"
    name, at = sphere_name(scene, a.sphere), f"at t = {middle(a.t):.7g}"
    if b is None:
        return f"misses {name}{after} {at}", f"misses {name}{after}"
    theirs, their = sphere_name(scene, b.sphere), f"at t = {middle(b.t):.7g}"
    if a.sphere == b.sphere:
        side, right = ("inside", "outside") if b.inside else ("outside", "inside")
        clause = f"hits the {side} of {name}{after}"
        return f"{clause} {their}, not its {right} {at}", clause
    if middle(b.t) == middle(a.t):
        clause = f"takes {theirs}, not {name}, of equal hits{after}"
        return f"{clause} {at}", clause
    if middle(b.t) < middle(a.t):
        return f"hits {theirs}{after} {their}, before {name} {at}", f"hits {theirs}{after} before {name}"
    clause = f"misses {name}{after}"
    return f"{clause} {at}, and hits {theirs} behind it {their}", f"{clause} and hits {theirs} behind it"


def _light(
    truth: Prover, other: Prover, hit: Hit, sight: Sight, their: Hit, seen: Sight
) -> tuple[str, str, int | None, float | None] | None:
    """How two proofs differ about one light: with numbers, without, which sphere, and where."""
    scene, after = truth.scene, reflections(hit.bounce)
    light = f"light {light_name(scene, sight.light)}"
    if (sight.faces > 0) != (seen.faces > 0):
        clause = f"takes {light} to be {'before' if seen.faces > 0 else 'behind'} the surface{after}"
        return clause, clause, hit.sphere, None
    if sight.asked and seen.asked and bool(sight.blockers) != bool(seen.blockers):
        if sight.blockers:
            sphere = sight.blockers[0]
            clause = f"lets {light} past {sphere_name(scene, sphere)}{after}"
            t = _between(truth, hit, sight.light, sphere)
        else:
            sphere = seen.blockers[0]
            clause = f"hides {light} behind {sphere_name(scene, sphere)}{after}"
            t = _between(other, their, sight.light, sphere)
        return clause + ("" if t is None else f" at t = {t:.7g}"), clause, sphere, t
    if (sight.specular is None) != (seen.specular is None):
        more, where = ("adds a", "not above") if seen.specular is not None else ("leaves out the", "above")
        clause = f"{more} highlight of {light} where R.V is {where} 0{after}"
        return clause, clause, hit.sphere, None
    return None


def _between(prover: Prover, hit: Hit, light: int, sphere: int) -> float | None:
    """The root that hides a light: the first between the shadow epsilon and 1, or the one that comes nearest to it."""
    epsilon = prover.settings.shadow_epsilon
    roots = [middle(root) for root in prover.crossings(hit, light, sphere)]
    if sphere == hit.sphere:
        roots = [root for root in roots if root != 0]  # where it starts
    inside = [root for root in roots if epsilon < root < 1]
    return min(inside) if inside else min(roots, key=lambda root: abs(root - 0.5), default=None)


def middle(value: Any) -> float:
    """The middle of a ball."""
    return float(value.mid())


def seen(
    scene: Scene, truth_id: int, values: Mapping[str, Sequence[float]], errors: Mapping[str, float], flip: Flip | None
) -> Decision:
    """What can be told from the values alone; `flip`: the decision they are near to."""
    name = min(errors, key=lambda name: (name != "id", not name.startswith("shadow"), name in SUMS))
    if name == "id":
        drawn = values["id"][0]
        known = drawn in range(len(scene.spheres))
        sees = sphere_name(scene, int(drawn)) if known else "nothing" if drawn < 0 else f"sphere {drawn:g}"
        right = "nothing" if truth_id < 0 else sphere_name(scene, truth_id)
        says = f"sees {sees} where there is {right}"
        return Decision("silhouette", says, says)
    if name.startswith("shadow"):
        light = int(name.removeprefix("shadow.L"))
        says = f"{'sees' if values[name][0] else 'hides'} light {light_name(scene, light)}"
        return Decision("range", says, says, light=light)
    if flip is None:
        return Decision("value", f"is off in {name} by {errors[name]:.2g}", f"is off in {name}")
    says, place = f"is off in {name}", near(scene, flip)
    return Decision(
        "value",
        f"{says} by {errors[name]:.2g} {place}",
        f"{says} {place}",
        flip.key.bounce,
        flip.key.light if flip.key.light >= 0 else None,
        flip.key.sphere,
    )


def near(scene: Scene, flip: Flip) -> str:
    """A decision that makes values change fast, as a clause."""
    key = flip.key
    exactly = "exactly " if flip.sign == 0 else "all but "
    ray = "the ray" if key.light < 0 else f"the shadow ray to {light_name(scene, key.light)}"
    after = reflections(key.bounce)
    sphere = sphere_name(scene, key.sphere)
    if flip.kind == "silhouette":
        return f"where {ray} {exactly}touches {sphere}{after}"
    if flip.kind == "terminator":
        return f"where {exactly}{'N.L' if key.what == 'faces' else 'R.V'} = 0{after}"
    if flip.kind == "order":
        return f"where {sphere} and {sphere_name(scene, key.other)} are {exactly}equally near{after}"
    if key.what == "side":
        return f"where light {light_name(scene, key.light)} is {exactly}on {sphere}{after}"
    return f"where {ray} {exactly}meets {sphere} at the end of its range{after}"
