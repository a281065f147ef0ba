"""What `whitted explain` prints: an Explanation in words and numbers, at most 100 columns wide."""

from __future__ import annotations

import decimal
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from flint import fmpq

from tracer.passes import MARGINS, lookup
from validation.explain import (
    Bounce,
    Crossing,
    Difference,
    Drawn,
    Explanation,
    decision,
    evenness,
    of_sphere,
    order,
)
from validation.follow import KINDS
from validation.renderers.floats import UNIT_ROUNDOFF
from validation.terminal import console, number
from validation.truth import Ball

if TYPE_CHECKING:
    from validation.explain import LightSeen
    from validation.truth import Tie

#: Columns of the page, and of what stands before the text.
WIDTH, LABEL = 100, 12
#: Columns of the name of a term, and of a number.
TERM, COLUMN = 21, 14
#: Digits of a number, and the most that two numbers get to be told apart.
DIGITS, MOST_DIGITS = 7, 40
ZERO = Ball(0, 0, 0.0)
#: More spheres than this are counted, not listed.
LISTED = 6

#: Blanks at which no line breaks: in "t = 1", "sphere 1 'name'", "(0, 0, 1)".
TOGETHER = re.compile(r" (?=[=>] )|(?<= [=>]) |(?<=sphere) (?=\d)|(?<=light) (?=\d)|(?<=\d) (?=')|(?<=\d,) (?=[-\d])")
#: A line and its style.
Line: TypeAlias = tuple[str, str]


# ---- numbers


def show(value: Ball | float, *apart: Ball | float, digits: int = DIGITS) -> str:
    """A number with as many digits as tell it from those it must not be taken for."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Ball) and (value.mantissa is None or value.contains(0)):
        return "inf" if value.mantissa is None else "0"
    exact = _rational(value)
    others = [_rational(other) for other in apart if math.isfinite(other.value if isinstance(other, Ball) else other)]
    text = ""
    for count in range(digits, MOST_DIGITS):
        rounded = _rounded(exact, count)
        text = _written(rounded)
        shown = fmpq(*map(int, rounded.as_integer_ratio()))
        if all((shown > other) == (exact > other) and (shown < other) == (exact < other) for other in others):
            break
    return text


def _rational(value: Ball | float) -> fmpq:
    return value.middle() if isinstance(value, Ball) else fmpq(*float(value).as_integer_ratio())


def _rounded(value: fmpq, digits: int) -> decimal.Decimal:
    with decimal.localcontext(prec=digits, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN):
        return (decimal.Decimal(int(value.p)) / decimal.Decimal(int(value.q))).normalize()


def _written(value: decimal.Decimal) -> str:
    return f"{value:f}" if -4 <= value.adjusted() < 9 else f"{value:e}".replace("e+", "e")


def vector(values: Sequence[Ball | float], apart: Sequence[Ball | float] = ()) -> str:
    """Three numbers, or one; with more digits if that would print as `apart` too."""
    texts = [show(value) for value in values]
    if texts == [show(other) for other in apart]:
        texts = [show(value, other) for value, other in zip(values, apart, strict=True)]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})"


# ---- lines


def lines(told: Explanation) -> Iterator[Line]:
    """The whole page."""
    yield from _head(told)
    for bounce in told.bounces:
        yield "", ""
        yield from _bounce(told, bounce)
    yield from wrapped("end", f"{told.end}.")
    yield "", ""
    yield from _passes(told)
    yield "", ""
    yield from _renderers(told)


def print_explanation(told: Explanation) -> None:
    """Print it; with colours on a terminal that wants them."""
    from rich.text import Text

    out = console()
    for line, style in lines(told):
        out.print(Text(line, style=style), soft_wrap=True)


def wrapped(label: str, text: str, style: str = "", *, indent: int = LABEL, hang: int | None = None) -> Iterator[Line]:
    """Text behind a label, on as many lines as it takes; `hang`: where further lines begin."""
    begin = f"  {label}".ljust(indent - 1) + " "
    # Runs of blanks are columns: they stay.
    first, rest = text[: (hang or indent) - indent], text[(hang or indent) - indent :]
    rest = TOGETHER.sub("\u00a0", rest)
    broken = textwrap.wrap(
        rest,
        WIDTH,
        initial_indent=begin + first,
        subsequent_indent=" " * (hang or indent),
        break_long_words=False,
        break_on_hyphens=False,
    )
    for line in broken or [(begin + first).rstrip()]:
        yield line.replace("\u00a0", " "), style


def _head(told: Explanation) -> Iterator[Line]:
    view = told.scene.view
    yield f"{told.label}, {view.columns}x{view.rows}", "bold"
    yield from wrapped("pixel", f"x {told.x}, y {told.y}: column and row, counted from 0 at the top left")
    rgb = ", ".join(map(str, told.levels))
    color = " ".join(show(ball) for ball in told.truth.values["beauty"])
    yield from wrapped("truth", f"RGB {color}; in 8 bits {rgb}")
    if told.calls or told.margins:
        yield from _margins(told)
    for note in told.notes:
        yield from wrapped("note", note, "yellow")


def _margins(told: Explanation) -> Iterator[Line]:
    text = "relative changes of the ray and the scene's numbers that could turn a decision:"
    yield from wrapped("margins", text)
    near = False
    for kind in MARGINS:
        call = told.calls.get(kind)
        margin = told.margins.get(kind, call.margin if call else math.inf)
        key = call.key if call else None
        ties = [tie.key for tie in told.ties if KINDS[tie.key.what] == kind]
        if ties:
            key, margin = key if key in ties else ties[0], 0.0
        if margin < 1:  # more is no small change
            about = decision(told.scene, key) if key else ""
            if call and call.margin > 10 * margin > 0:  # margins of pixels are bounds, on the safe side
                about += f" (which takes a change of {number(call.margin)})"
            yield from wrapped("", f"{kind:<11} {margin:<8.2g} {about}".rstrip(), hang=LABEL + 21)
            near = True
    if not near:
        yield from wrapped("", "none: no small change turns any")


# ---- one ray


def _bounce(told: Explanation, bounce: Bounce) -> Iterator[Line]:
    title = f"REFLECTED RAY {bounce.bounce}" if bounce.bounce else "PRIMARY RAY"
    if bounce.bounce:
        title += f", which counts {show(bounce.weight)} (the product of the Kr before it)"
    yield title, "bold"
    yield from wrapped("from", vector(bounce.origin) + ": the eye" * (bounce.bounce == 0))
    if bounce.bounce:
        yield from wrapped("along", f"{vector(bounce.direction)}: d - 2 (d.N) N; hits count from t > 0")
    else:
        along = ", ".join(_short(ball.value) for ball in bounce.direction)
        exact = all(ball.contains(ball.value) for ball in bounce.direction)
        exactly = "exactly, not normalised" if exact else "rounded to float64, not normalised"
        yield from wrapped("along", f"({along}) {exactly}; hits count from t > 1, the near plane")
    yield from _crossings(told, bounce)
    yield from _ties(told, bounce, -1)
    if bounce.sphere < 0:
        yield from _sum(bounce)
        return
    assert bounce.point is not None
    assert bounce.normal is not None
    assert bounce.distance is not None
    away = f"{show(bounce.distance)} from the {'start' if bounce.bounce else 'eye'}"
    yield from wrapped("point", f"{vector(bounce.point)}, {away}")
    side = "turned inwards, where the ray comes from" if bounce.inside else "outwards"
    yield from wrapped("normal", f"{vector(bounce.normal)}, {side}")
    for light in bounce.lights:
        yield from _light(told, bounce, light)
        yield from _ties(told, bounce, light.light)
    yield from _terms(told, bounce)


def _short(value: float) -> str:
    """The fewest digits that are this float64."""
    return "0" if value == 0 else repr(value).removesuffix(".0")


def _ties(told: Explanation, bounce: Bounce, light: int) -> Iterator[Line]:
    keys = [tie.key for tie in told.ties]
    for tie in told.ties:
        # That it touches there says that it meets there.
        said = tie.key.what == "start" and tie.key._replace(what="ahead") in keys
        if (tie.key.bounce, tie.key.light) == (bounce.bounce, light) and not said:
            yield from _tie(told, tie)


def _tie(told: Explanation, tie: Tie) -> Iterator[Line]:
    even = evenness(told.scene, tie.key, told.settings)
    if not tie.proved:
        even += " as far as can be told"
    if tie.settled:
        others = [color for color in tie.outcomes if color != tie.outcomes[0]]
        else_ = "".join(f" Otherwise the pixel would be {vector(color)}." for color in others)
        yield from wrapped("EXACTLY", f"{even}. The specification: {tie.settled}.{else_}", "cyan")
        return
    if len(tie.outcomes) == 1:
        yield from wrapped("EXACTLY", f"{even}. Nothing settles it; the pixel is the same either way.", "cyan")
        return
    outcomes = " or ".join(map(vector, tie.outcomes))
    yield from wrapped("EXACTLY", f"{even}. Nothing settles it: the pixel may be {outcomes}.", "yellow")


def _crossings(told: Explanation, bounce: Bounce) -> Iterator[Line]:
    scene, begins = told.scene, 0 if bounce.bounce else 1
    met = [entry for entry in bounce.crossings if entry.what in ("hit", "farther")]
    times = [entry_t(entry, begins) for entry in met]
    for place, entry in enumerate(met[:LISTED]):
        others = [t for k, t in enumerate(times) if k != place]
        t = bounce.t if entry.what == "hit" and bounce.t is not None else times[place]
        text = f"{of_sphere(scene, entry.sphere)} at t = {show(t, begins, *others)}"
        text += _side(bounce, entry, begins)
        yield from wrapped("hits" if entry.what == "hit" else "  behind", text, "bold" if entry.what == "hit" else "")
    if not met:
        yield from wrapped("hits", "nothing")
    if len(met) > LISTED:
        yield from wrapped("  behind", f"and {len(met) - LISTED} other spheres")
    before = [entry for entry in bounce.crossings if entry.what == "before" and (bounce.bounce == 0)]
    shown = []
    for entry in before:
        last = entry.roots[-1]
        if last.value > 0:
            times_of = " and ".join(show(root, 1.0) for root in entry.roots)
            shown.append(f"{of_sphere(scene, entry.sphere)} at t = {times_of}")
    for text in shown[:LISTED]:
        yield from wrapped("no hit", f"{text}: before the near plane")
    ahead = [entry for entry in bounce.crossings if entry.what == "missed" and entry.closest.value > begins]
    if ahead:
        names = [f"{of_sphere(scene, entry.sphere)} at {show(entry.radii, 1.0, digits=4)}" for entry in ahead[:LISTED]]
        more = f" and {len(ahead) - LISTED} more" * (len(ahead) > LISTED)
        yield from wrapped("misses", f"{', '.join(names)} radii from the centre (1: the outline){more}")


def entry_t(entry: Crossing, begins: float) -> Ball:
    """The root that counts."""
    return next((root for root in entry.roots if root.value > begins), entry.roots[-1])


def _side(bounce: Bounce, entry: Crossing, begins: float) -> str:
    """From which side a sphere is met, and what became of its other root."""
    if entry.what == "hit" and bounce.touches:
        return ", which it only touches: both roots are the same"
    if len(entry.roots) < 2:
        return ", touched"
    first, last = entry.roots
    if first.value > begins:
        return f" from outside, out again at t = {show(last, first)}"
    if bounce.bounce and first.contains(0):
        return " from inside; its other root is the start of the ray"
    if bounce.bounce == 0 and first.value > 0:
        return f" from inside; its root t = {show(first, 1.0)} is before the near plane"
    return f" from inside; its root t = {show(first)} is behind the {'start' if bounce.bounce else 'eye'}"


def _light(told: Explanation, bounce: Bounce, seen: LightSeen) -> Iterator[Line]:
    label, name = f"light {seen.light}", f"'{told.scene.lights[seen.light].name}'"
    if seen.cosine is None or seen.shine is None:
        yield from wrapped(label, f"{name} is at the point itself: it counts as visible and adds nothing")
        return
    angle = f"N.L = {show(seen.cosine, 1.0)}"
    if seen.state == "behind":
        state = "behind the surface" if seen.cosine.value < 0 else "in the plane of the surface"
    elif seen.state == "hidden":
        state = f"hidden by {hiders(told, seen)}"
    elif seen.state == "useless":
        state = "adds nothing, as a factor of each term is 0"
    else:
        state = "visible"
        if told.scene.spheres[bounce.sphere].ks > 0:
            angle += f", R.V = {show(seen.shine, 1.0)}" + ": no highlight" * (seen.shine.value <= 0)
    yield from wrapped(label, f"{name}: {state}; {angle}")
    for j, t in seen.beside:
        yield from wrapped("", _beside(told, j, t))


def hiders(told: Explanation, seen: LightSeen) -> str:
    """The spheres that hide a light, with t of the shadow ray."""
    apart = 0.0, 1.0, told.settings.shadow_epsilon
    names = [f"{of_sphere(told.scene, j)} at t = {show(t, *apart)}" for j, t in seen.blockers[:LISTED]]
    more = f" and {len(seen.blockers) - LISTED} more" * (len(seen.blockers) > LISTED)
    return " and ".join(names) + more + " (0: the point, 1: the light)"


def _beside(told: Explanation, j: int, t: Ball) -> str:
    """A sphere that a light's shadow ray meets where it does not count."""
    sphere, epsilon = of_sphere(told.scene, j), told.settings.shadow_epsilon
    if t.value <= epsilon:
        return f"its ray meets {sphere} at t = {show(t, epsilon)}, which is not above {epsilon:g}: does not hide it"
    if t.contains(1):
        return f"it lies on {sphere} exactly, at t = 1, which does not hide it"
    return f"its ray meets {sphere} at t = {show(t, 1.0)}, behind the light: does not hide it"


def _terms(told: Explanation, bounce: Bounce) -> Iterator[Line]:
    assert bounce.ambient is not None
    weight = f"{show(bounce.weight, digits=4)} x " if bounce.bounce else ""
    exponent = f"{told.scene.spheres[bounce.sphere].exponent:g}"
    exponent = exponent if len(exponent) < 8 else f"{float(exponent):.4g}"
    rows = [("ambient", bounce.ambient, f"{weight}Ka Ia O")]
    for seen in bounce.lights:
        if seen.diffuse is not None:
            rows.append((f"diffuse, light {seen.light}", seen.diffuse, f"{weight}Kd Ip (N.L) O"))
        if seen.specular is not None:
            rows.append((f"specular, light {seen.light}", seen.specular, f"{weight}Ks Ip (R.V)^{exponent}"))
    yield f"  {'adds':<{TERM}}{'R':<{COLUMN}}{'G':<{COLUMN}}B", ""
    for label, color, formula in rows:
        yield f"    {label:<{TERM - 2}}" + "".join(f"{show(ball):<{COLUMN}}" for ball in color) + formula, ""
    yield from _sum(bounce)


def _sum(bounce: Bounce) -> Iterator[Line]:
    colors = "".join(f"{show(ball):<{COLUMN}}" for ball in bounce.total).rstrip()
    yield f"  {'the pixel so far':<{TERM}}{colors}", "bold"


# ---- the renderers


def _value(told: Explanation, name: str, values: Sequence[Ball | float], apart: Sequence[Ball | float] = ()) -> str:
    """The value of a pass, with digits that tell it from another one."""
    quantity = lookup(name).quantity
    first = values[0].value if isinstance(values[0], Ball) else values[0]
    if quantity == "id":
        known = 0 <= first < len(told.scene.spheres)
        return of_sphere(told.scene, int(first)) if known else f"{first:g}" + ", nothing" * (first == -1)
    if quantity == "visibility":
        return "1, visible" if first == 1 else "0, hidden" if first == 0 else f"{first:g}"
    return vector(values, apart)


def _passes(told: Explanation) -> Iterator[Line]:
    drawn = [entry for entry in told.drawn if not entry.reason]
    below = "; below it whoever is off by more than it may be, and what follows from that"
    yield "PASS BY PASS: truth" + below * bool(drawn), "bold"
    zero: list[str] = []
    for name in order(len(told.scene.lights), told.settings.max_reflections):
        values = told.truth.values[name]
        others = []
        for entry in drawn:
            first = entry.differences[0].name if entry.differences else ""
            if any(difference.name == name for difference in entry.differences) or _follows(entry, name, first, values):
                mark = "   <- first difference" * (name == first)
                others.append((f"    {entry.renderer}: {_value(told, name, entry.values[name], values)}{mark}", "red"))
        quantity = lookup(name).quantity
        if not others and all(ball == ZERO for ball in values) and (quantity == "color" or told.truth.id < 0):
            zero.append(name)
            continue
        dark = quantity == "visibility" and told.truth.id >= 0
        dark = dark and told.bounces[0].lights[int(name.removeprefix("shadow.L"))].state == "behind"
        unseen = ", but behind the surface: not compared" * dark
        yield f"  {name:<13} {_value(told, name, values)}{unseen}", ""
        yield from others
    if zero:
        yield from wrapped("0", ", ".join(_ranges(zero)), indent=16)
    yield from _levels(told, drawn)


def _ranges(names: Sequence[str]) -> Iterator[str]:
    """Passes of three bounces or more in a row as one: "reflection.4 to .99"."""

    def follows(a: str, b: str) -> bool:
        (stem, _, number), (other, _, next_) = a.partition("."), b.partition(".")
        return stem == other and number.isdigit() and next_.isdigit() and int(next_) == int(number) + 1

    runs: list[list[str]] = []
    for name in names:
        if runs and follows(runs[-1][-1], name):
            runs[-1].append(name)
        else:
            runs.append([name])
    for run in runs:
        yield from [f"{run[0]} to .{run[-1].partition('.')[2]}"] if len(run) > 2 else run


def _follows(drawn: Drawn, name: str, first: str, truth: Sequence[Ball]) -> bool:
    """Whether a value is visibly another one, though within a tolerance that the first difference has made void."""
    if first not in ("id", "depth") or name not in drawn.values or lookup(name).quantity == "visibility":
        return False
    largest = max(abs(ball.value) for ball in truth)
    return any(not abs(a - b.value) <= 1e-4 * largest for a, b in zip(drawn.values[name], truth, strict=True))


def _levels(told: Explanation, drawn: Sequence[Drawn]) -> Iterator[Line]:
    same = [entry.renderer for entry in drawn if entry.levels == told.levels]
    text = ", ".join(map(str, told.levels)) + (f", also {', '.join(same)}" if same else "")
    yield from wrapped("8-bit RGB", text, indent=16)
    for entry in drawn:
        if entry.levels is not None and entry.levels != told.levels:
            levels = ", ".join(map(str, entry.levels))
            off = "" if entry.differences else " (within its tolerance: a rounding before the truncation)"
            if entry.encoding:
                exact = entry.encoding.encode(np.array([ball.value for ball in told.truth.values["beauty"]]))
                off = f" ({entry.encoding.says}: of the exact color {', '.join(map(str, exact))})"
            yield f"    {entry.renderer}: {levels}{off}", "red" if entry.differences else ""


def _renderers(told: Explanation) -> Iterator[Line]:
    yield "RENDERERS", "bold"
    agree = [entry.renderer for entry in told.drawn if not entry.reason and not entry.differences]
    if agree:
        yield from wrapped("agree", f"no difference beyond what it may be off by: {', '.join(agree)}", "green")
    for entry in told.drawn:
        if entry.differences:
            told_first = f"{entry.renderer}: first difference: {first_difference(told, entry)}"
            yield from wrapped("differs", told_first, "red")
            for more in (_edge(told, entry, entry.differences[0]), entry.verdict):
                if more:
                    yield from wrapped("", more)
    for entry in told.drawn:
        if entry.reason:
            yield from wrapped("not drawn", f"{entry.renderer} {entry.reason}", "yellow")
    if not told.drawn:
        yield "  none", ""


def first_difference(told: Explanation, drawn: Drawn) -> str:
    """What a renderer does first that truth does not."""
    difference, primary = drawn.differences[0], told.bounces[0]
    name, values, truth = difference.name, drawn.values[difference.name], told.truth.values[difference.name]
    quantity = lookup(name).quantity
    shown, exact = (
        _value(told, name, a, b).removeprefix("1, ").removeprefix("0, ").removeprefix("-1, ")
        for a, b in ((values, truth), (truth, values))
    )
    says = f"{name}: {drawn.renderer} says {shown}, truth says "
    if quantity == "visibility" and primary.lights:
        seen = primary.lights[int(name.removeprefix("shadow.L"))]
        if seen.blockers:
            return f"{says}hidden by {hiders(told, seen)}"
        return "; ".join([f"{says}visible", *(_beside(told, j, t) for j, t in seen.beside)])
    if quantity in ("id", "visibility"):
        return f"{says}{exact}" + (f" at t = {show(primary.t, 1.0)}" if primary.t is not None else "")
    off = f"off by {number(difference.error)}"
    if quantity == "normal" and all(abs(a + b.value) < 1e-3 for a, b in zip(values, truth, strict=True)):
        off = "it points the other way"
    allowed = "" if difference.unbounded else f", where {number(difference.tolerance)} is allowed"
    return f"{says}{exact}: {off}{allowed}"


def _edge(told: Explanation, drawn: Drawn, difference: Difference) -> str:
    """Why the pixel is an edge for a renderer; "" where it is not."""
    why = []
    for kind, margin, least in difference.edge:
        # A margin is worked out in floating point: of what is exactly even its own rounding is left.
        if margin < UNIT_ROUNDOFF["f64"] and any(KINDS[tie.key.what] == kind for tie in told.ties if tie.proved):
            margin = 0.0
        below = f"its {kind} margin {number(margin)} is below the {number(least)} that it can tell"
        why.append(below if least < 1 else f"it claims to tell no {kind} decision here")
    if difference.unbounded:
        why.append("it has no bound for its values here")
    return f"An edge, where {drawn.renderer} may differ: {'; '.join(why)}." if why else ""
