"""Shadow acne: a shadow ray meets the very sphere that it starts on, near t = 0, at random and so in speckles.

No rule tells which pixels have it. So it is looked for where nothing else explains a pixel: truth in which some lights
are hidden by the sphere itself has to make the pixel, and most such pixels have to stand beside right ones of the same
sphere. Where whole areas are dark, something else is wrong.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from validation.court import CLEARLY, Court, Finding, Pixel, Possible, Side
from validation.follow import Follower, Hit, Vector, add
from validation.rules import ACNE
from validation.truth import NOWHERE, Prover, Truth

#: Of so many lights of a pixel, over all hits of its chain, every choice is looked at.
MOST_LIGHTS = 12
#: Of these choices so many, those that come nearest to the pixel, are proved.
NEAREST = 4
#: Fewer such pixels are no speckles, but something that happened to a few.
LEAST = 3

BECAUSE = f"truth makes this pixel if it {ACNE.says}"


class _Speckled(Follower):
    """At some hits the sphere itself hides some lights, whatever its roots are."""

    hidden: frozenset[tuple[int, int]] = frozenset()  # bounce, light

    def hides(self, hit: Hit, relative: object, to_light: Vector, i: int, j: int) -> bool:
        own = j == hit.sphere and (hit.bounce, i) in self.hidden
        return own or super().hides(hit, relative, to_light, i, j)


def acne(court: Court, truth: Truth, side: Side, compared: Sequence[str]) -> Finding | None:
    """What is to be said about a pixel if truth makes it in which the sphere itself hides some of its lights."""
    if "beauty" not in compared:
        return None
    court.allowance.restore()
    pixel = Pixel(court, truth, side, compared)
    ways = []
    for hidden in _choices(court.prover, truth, pixel.values["beauty"], side):
        follower = type("_Hidden", (_Speckled,), {"hidden": hidden})
        prover = Prover(court.scene, court.settings, follower=follower, allowance=court.allowance)
        ways.append(Possible("mistake", BECAUSE, pixel.made(prover)))
    for possible in pixel.makers(ways, within=CLEARLY**2, sensitivities=1):
        # The root that hides it is one that is not there.
        decision = court.parted(pixel, possible)
        decision = replace(decision, says=f"{decision.pattern}, where its shadow ray starts", t=0.0)
        return Finding(side.renderer.name, pixel.errors, decision, "mistake", BECAUSE)
    return None


def _choices(prover: Prover, truth: Truth, drawn: Sequence[float], side: Side) -> list[frozenset[tuple[int, int]]]:
    """Which lights may be hidden at which hits, to come near to what was drawn: the nearest few."""
    try:
        hits, _ = prover.examine(truth.x, truth.y)
    except NOWHERE:
        return []
    parts: dict[tuple[int, int], NDArray[np.float64]] = {}
    for hit in hits:
        for sight in hit.sights:
            light = add(sight.diffuse, sight.specular)
            if sight.blockers or not any(light):
                continue
            weight = 1.0 if hit.weight is None else float(hit.weight)
            parts[hit.bounce, sight.light] = weight * np.array([float(value) for value in light])
    if not 0 < len(parts) <= MOST_LIGHTS:
        return []
    whole, keys = np.array([ball.value for ball in truth.values["beauty"]]), list(parts)
    chosen = np.array(list(itertools.product((0, 1), repeat=len(keys)))[1:], dtype=np.float64).reshape(-1, len(keys))
    made = whole - chosen @ np.array(list(parts.values())).reshape(-1, 3)
    if side.encoding:
        levels = np.rint(np.broadcast_to(drawn, made.shape) * side.encoding.steps)
        far = side.encoding.distance(levels, made).max(axis=-1)
    else:
        far = np.abs(made - drawn).max(axis=-1)
    nearest = np.argsort(far, kind="stable")[:NEAREST]
    return [frozenset(key for key, taken in zip(keys, chosen[k], strict=True) if taken) for k in nearest]


def scattered(places: Sequence[tuple[int, int]], over: NDArray[np.bool_], ids: NDArray[np.int32]) -> bool:
    """Whether most of these pixels (column, row) stand beside a right one of the same sphere.

    `over`: where the image is wrong; `ids`: the sphere that each pixel sees.
    """
    if len(places) < LEAST:
        return False
    beside = 0
    for x, y in places:
        around = slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2)
        beside += bool((~over[around] & (ids[around] == ids[y, x])).any())
    return 2 * beside > len(places)
