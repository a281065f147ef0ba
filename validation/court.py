"""Finds out about one pixel of one renderer: whether it is off, on which decision it parted from truth, and the cause.

A cause counts only if truth, changed the way that cause says, makes the renderer's pixel: every pass that was
compared, within the renderer's tolerance. Three causes explain a difference: rounding (truth with every number and the
ray changed by no more than the renderer claims for this kind of decision), a documented rule of the renderer, and a tie
that the specification does not settle. A known mistake that makes the pixel is named, but excuses nothing; the rest is
unexplained.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import math
import random
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tracer.margins import EDGE_ROUNDINGS, VALUE_ROUNDINGS
from tracer.passes import MARGINS, lookup
from validation import flips, parting
from validation.compare import STEEP, Judge
from validation.encoding import Encoding
from validation.follow import Follower, Hit, Key
from validation.parting import Decision, light_name
from validation.renderers import PerPixel, Renderer, Settings, Uncertainty
from validation.rules import Rule, mistakes
from validation.run import RendererError, blaming
from validation.truth import NOWHERE, Allowance, Ball, Prover, Truth

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from tracer.passes import Passes

#: The largest change that counts as rounding: the 32 roundings of a careful renderer in half precision, u = 2^-11, the
#: least precise format there is. Numbers that change by more are another scene, whatever a renderer claims.
LARGEST = 32 * 2.0**-11
#: The least that numbers are changed beyond a decision, as a share of the unit by which values may be off.
NEAREST = 2.0**-20
#: Changes grow by this factor, and where one comes near to the pixel, others around it are tried.
GROWTH, AROUND = 4.0, 6
#: A decision may be taken otherwise with all numbers as they are up to this margin in units of the values: the same
#: roundings that are counted in a value are counted in a decision. If it takes more, values tell.
TELLS = EDGE_ROUNDINGS / VALUE_ROUNDINGS
#: Sensitivities are what takes time: of a pixel and renderer so many at most, and as many again for several decisions.
SENSITIVITIES = 64
#: Of what makes a pixel in part so many are looked at further.
HALFWAY = 6
#: Of a pixel and renderer so many sets of decisions are looked at, each for one more; of all that its rules make of the
#: pixel in part as many again.
SETS = 64
#: Of a rule that leaves decisions open so many ways to take them.
CHOICES = 64
#: Decisions that are forced, whatever they would take, to say which one must have been taken otherwise.
FORCED = 64

#: What is off by more, in bits, is off by as much.
BITS = 64.0

#: Other pixels that are asked before a mistake is believed, and by how many tolerances one of them has to differ.
WITNESSES, CLEARLY = 64, 100

#: What a cause is worth: the first three explain a difference.
EXPLAINED = ("rounding", "rule", "tie")


@dataclass(frozen=True)
class Side:
    """One renderer and what it drew."""

    renderer: Renderer
    passes: Passes
    claim: Uncertainty
    encoding: Encoding | None = None


@dataclass(frozen=True)
class Finding:
    """One renderer at one pixel.

    `errors`: by pass how far it is from the exact value at most, of those that are off by more than its tolerance;
    empty for a renderer that is right. `cause`: "rounding", "rule", "tie", "mistake", "unexplained", or "" for one that
    is right. `change`: the relative change with which truth makes the same pixel, of a rounding.
    """

    renderer: str
    errors: Mapping[str, float] = field(default_factory=dict)
    decision: Decision | None = None
    cause: str = ""
    because: str = ""
    change: float | None = None

    @property
    def right(self) -> bool:
        """Whether every pass is within the tolerance of truth."""
        return not self.errors

    @property
    def explained(self) -> bool:
        """Whether the specification and the renderer's documents leave room for what it did."""
        return self.right or self.cause in EXPLAINED


class RulesError(RendererError):
    """The documented rules of `renderer`, a name, did what no rules may do."""

    def __init__(self, renderer: str, message: str) -> None:
        super().__init__(message)
        self.renderer = renderer


@contextmanager
def _blaming(renderer: Renderer, rules: Sequence[Rule]) -> Iterator[None]:
    """What is raised in the code of its rules is the renderer's failure, what is raised in ours is not."""
    theirs = {type(renderer).__module__}
    for rule in rules:
        theirs |= {getattr(code, "__module__", "") for code in (rule.follower, rule.choices, rule.settings)}
    # What a rule leaves as it is by default is ours.
    theirs -= {Follower.__module__, Rule.__module__}
    try:
        yield
    except NOWHERE:
        raise
    except Exception as error:
        frames = [frame.f_globals.get("__name__") for frame, _ in traceback.walk_tb(error.__traceback__)]
        if not theirs & {name for name in frames if name != __name__}:
            raise
        raise RulesError(renderer.name, f"its rules failed: {type(error).__name__}: {error}") from error


class Court:
    """Judges pixels of one scene."""

    def __init__(self, scene: Scene, settings: Settings, analysis: Analysis) -> None:
        """What all pixels share.

        `analysis`: margins and sensitivities at this size, with these settings.
        """
        self.scene, self.settings, self.analysis = scene, settings, analysis
        #: What may be worked out exactly for a pixel, over all that is asked about it.
        self.allowance = Allowance()
        self.prover = Prover(scene, settings, allowance=self.allowance)
        self._truths: dict[tuple[int, int], Truth] = {}
        self._found: dict[tuple[str, int, int, tuple[str, ...]], Finding] = {}
        self._bounds: dict[tuple[str, str], float] = {}
        self._rules: dict[Rule, Prover] = {}
        self._documented: dict[str, Sequence[Rule]] = {}
        self._mistakes = list(mistakes(scene, settings))
        self._against: dict[tuple[Rule, str], int] = {}

    def truth(self, x: int, y: int) -> Truth:
        """The pixel; a renderer of several pairs may be asked about it several times.

        Raises:
            truth.UnprovedError: no precision is enough.
        """
        if (x, y) not in self._truths:
            self.allowance.restore()
            self._truths[x, y] = self.prover.pixel(x, y)
        return self._truths[x, y]

    def find(self, truth: Truth, side: Side, compared: Sequence[str]) -> Finding:
        """Whether one renderer is off at a pixel, and why.

        Raises:
            RulesError: its documented rules failed.
        """
        key = side.renderer.name, truth.x, truth.y, tuple(compared)
        if key not in self._found:
            self._found[key] = self._find(truth, side, compared)
        return self._found[key]

    def bound(self, side: Side, name: str) -> float:
        """What a pixel without a finite tolerance is held to: the largest tolerance of the interior."""
        key = side.renderer.name, name
        if key not in self._bounds:
            exact = Uncertainty(0.0, 0.0, 0.0, 0.0, 0.0)
            judge = Judge(self.scene, self.settings, self.analysis, side.claim, exact)
            self._bounds[key] = float(judge.tolerance(name)[~judge.edge(name)].max(initial=0.0))
        return self._bounds[key]

    def _find(self, truth: Truth, side: Side, compared: Sequence[str]) -> Finding:
        self.allowance.restore()
        pixel = Pixel(self, truth, side, compared)
        name, errors = side.renderer.name, pixel.errors
        if not errors:
            return Finding(name)
        # A rule is a third party's code.
        with _blaming(side.renderer, self.documented(side.renderer)):
            for possible in self.causes(pixel):
                return Finding(
                    name, errors, self.parted(pixel, possible), possible.cause, possible.because, possible.change
                )
        return Finding(
            name, errors, pixel.seen(), "unexplained", "no rule, no rounding within its claim makes this pixel"
        )

    def causes(self, pixel: Pixel) -> Iterator[Possible]:
        """What made a pixel, the likeliest first."""
        x, y = pixel.truth.x, pixel.truth.y
        ways = [
            Possible("rule", f"as documented, it {rule.says}", pixel.made(prover))
            for rule in self.documented(pixel.side.renderer)
            for prover in self.following(rule, x, y)
        ]
        yield from pixel.makers(ways)
        ties = [tie.key for tie in pixel.truth.ties if not tie.settled and tie.proved]
        even = "an exact tie that the specification does not settle"
        yield from pixel.makers(
            [Possible("tie", even, pixel.made(self.prover.forcing({key: sign}))) for key in ties for sign in (-1, 1)]
        )
        yield from self.roundings(pixel, self.prover)
        for way in pixel.promising(ways):
            yield from self.roundings(pixel, way.made.prover, f"; {way.because}")
        suspected = getattr(pixel.side.renderer, "suspected", "")
        for rule in sorted(self._mistakes, key=lambda rule: rule.says != suspected):
            because = f"truth makes this pixel if it {rule.says}"
            made = [
                Possible("mistake", because, pixel.following(rule, prover)) for prover in self.following(rule, x, y)
            ]
            for possible in pixel.makers(made, within=CLEARLY**2, sensitivities=1):
                if not self.refuted(rule, pixel):
                    # Of several that make a pixel the one that made the last.
                    self._mistakes.remove(rule)
                    self._mistakes.insert(0, rule)
                    yield possible
        yield from self.inexcusable(pixel)

    def inexcusable(self, pixel: Pixel) -> Iterator[Possible]:
        """The single decision that must have been taken otherwise, whatever that takes: named, but no excuse."""
        found: list[Possible] = []
        for flip in _decisions(self.prover, pixel.truth.x, pixel.truth.y):
            if len(found) < FORCED and pixel.concerns([flip]):
                claim = pixel.at(getattr(pixel.side.claim, flip.kind))
                takes = f"numbers changed by {flip.margin:.2g}" if math.isfinite(flip.margin) else "other numbers"
                because = f"nothing explains it: to decide so takes {takes}, and it {_may(claim)}"
                made = pixel.made(self.prover.forcing({flip.key: flip.forced}))
                found.append(Possible("unexplained", because, made, None, flip, flip.kind))
        yield from pixel.makers(found, sensitivities=4)

    def refuted(self, rule: Rule, pixel: Pixel) -> bool:
        """Whether a renderer is right where that mistake would show: then it does not make it.

        A single pixel may look like a mistake by chance; so its neighbours are asked, and others all over the image.
        """
        view, name = self.scene.view, pixel.side.renderer.name

        def asked(places: Iterable[tuple[int, int]], enough: int) -> int:
            """How many of them speak against it, or `enough`."""
            against = 0
            for x, y in places:
                try:
                    truth = self.prover.pixel(x, y, ties=False)
                except NOWHERE:  # it cannot say
                    continue
                beside = Pixel(self, truth, pixel.side, pixel.compared)
                if beside.errors:
                    continue
                made = [beside.following(rule, other) for other in self.following(rule, x, y)]
                if made and all(entry.values is not None for entry in made):
                    against += all(beside.score(entry) > CLEARLY for entry in made)
                if against >= enough:
                    break
            return against

        # One may lie where the mistake makes no difference but for rounding.
        enough = 2
        if (rule, name) not in self._against:
            count = view.columns * view.rows
            chosen = random.Random(0).sample(range(count), min(WITNESSES, count))
            places = [(index % view.columns, index // view.columns) for index in chosen]
            self._against[rule, name] = asked(places, enough)
        x, y = pixel.truth.x, pixel.truth.y
        around = [
            (x + dx, y + dy)
            for dy in range(-2, 3)
            for dx in range(-2, 3)
            if (dx or dy) and 0 <= x + dx < view.columns and 0 <= y + dy < view.rows
        ]
        against = self._against[rule, name]
        return against + (asked(around, enough - against) if against < enough else 0) >= enough

    def roundings(self, pixel: Pixel, prover: Prover, besides: str = "") -> Iterator[Possible]:
        """Truth with one decision flipped by numbers changed no more than the renderer claims, or with several."""
        x, y = pixel.truth.x, pixel.truth.y
        # Where no bound is claimed, roundings are what values are off by; the rest is for rules.
        claims = {
            kind: claim if math.isfinite(claim) else TELLS * pixel.unit
            for kind in MARGINS
            for claim in [pixel.at(getattr(pixel.side.claim, kind))]
        }
        # The margins are the specification's: a rule has decisions of its own.
        if prover is self.prover and not self.near(x, y, claims):
            return
        within = [flip for flip in _decisions(prover, x, y) if flip.margin <= min(claims[flip.kind], LARGEST)]
        singles = [
            possible
            for flip in within
            if pixel.concerns([flip])
            for possible in self.changes(pixel, State(pixel.made(prover)), flip, claims)
        ]
        yield from pixel.makers([state.possible(claims, besides) for state in singles])
        if prover is self.prover:
            pixel.left = SENSITIVITIES
        yield from self.several(pixel, prover, claims, besides)

    def several(
        self,
        pixel: Pixel,
        prover: Prover,
        claims: Mapping[str, float],
        besides: str,
    ) -> Iterator[Possible]:
        """Truth with any number of decisions within the claim taken otherwise: a renderer rounds each by itself.

        The set that makes most of the pixel is looked at first: of its passes the first, in the order of the ray, that
        it does not make yet says which decisions may be the next to be taken otherwise, all numbers as they are. Values
        next to an outline are had by changing the numbers with all decisions near them held as they are.
        """
        limits = {kind: min(claim, TELLS * pixel.unit, LARGEST) for kind, claim in claims.items()}
        count = itertools.count()
        waiting: list[tuple[tuple[int, int, float], int, State]] = []
        seen: set[tuple[Made | None, frozenset[tuple[Key, int]]]] = set()

        def wait(states: Iterable[State], than: State | None = None) -> None:
            for state in states:
                entry = state.numbers, frozenset(state.made.prover.forced.items())
                same = than is not None and state.made.path == than.made.path
                if state.made.values is not None and entry not in seen and not same:
                    seen.add(entry)
                    unmade, off = pixel.rank(state.made)
                    heapq.heappush(waiting, ((unmade, state.steps, off), next(count), state))

        wait([State(pixel.made(prover, limits["range"]))])
        for _ in range(SETS if prover is self.prover else SETS // HALFWAY):
            if not waiting:
                return
            *_, state = heapq.heappop(waiting)
            wanting = pixel.wanting(state.made)
            if not wanting:
                if state.steps or state.made.free:
                    yield state.possible(claims, besides)
                continue
            near = state.near(limits)
            for flip in near:
                if flip.forced != flip.sign and _changes(flip.key, wanting):
                    other = state.forcing(flip)
                    wait([other], state)
                    if flip.key.light >= 0:
                        wait(self.unhidden(other, flip.key, limits), state)
            for flip in state.made.decisions:
                # Of values behind a decision those count where its quantity is above 0.
                moved = flip.key in {each.key for each in state.moved}
                steep = flip.key in state.made.steep and not moved and _changes(flip.key, wanting)
                if steep and (flip.sign or flip.other > 0) and lookup(wanting).quantity not in ("id", "visibility"):
                    held = state.holding(near, flip)
                    wait(self.changes(pixel, held, flip, claims, [1 if flip.other > 0 else -1]))

    def unhidden(self, state: State, asked: Key, limits: Mapping[str, float]) -> list[State]:
        """The same with nothing before the light that a decision is about: what hides it may be several spheres."""
        while blockers := state.made.blockers(asked.bounce, asked.light):
            ways = [
                state.forcing(flip)
                for flip in state.near(limits)
                if flip.key[1:4] == (asked.bounce, asked.light, blockers[0]) and flip.key != asked
            ]
            fewer = (way for way in ways if blockers[0] not in way.made.blockers(asked.bounce, asked.light))
            found = next(fewer, None)
            if found is None:
                return []
            state = found
        return [state]

    def changes(
        self,
        pixel: Pixel,
        state: State,
        flip: flips.Flip,
        claims: Mapping[str, float],
        sides: Sequence[int] = (1, -1),
    ) -> list[State]:
        """Truth of numbers changed to either side of a decision, by no more than is claimed.

        Of those that make the same passes the one that comes nearest to a pixel.
        """
        most, first = min(claims[flip.kind], LARGEST) - state.change, NEAREST * pixel.unit
        if flip.margin > most:
            return []
        margin, prover = flip.margin, state.made.prover

        def changed(delta: float) -> Made:
            return pixel.made(flips.changed(prover, pixel.truth.x, pixel.truth.y, flip, delta), state.made.least)

        found = []
        for side in sides:
            tried = [
                (pixel.rank(made), gap, made)
                for gap in _gaps(margin, most, first, side)
                for made in [changed(margin + side * gap)]
                if made.values is not None
            ]
            best: dict[int, tuple[tuple[int, float], float, Made]] = {}
            for entry in tried:
                kept = best.get(entry[0][0])
                if kept is None or entry[0] < kept[0]:
                    best[entry[0][0]] = entry
            for entry in best.values():
                for step in range(1, AROUND // 2 + 1) if entry[0][1] > 0 else ():
                    for gap in (entry[1] * GROWTH**sign for sign in (2.0**-step, -(2.0**-step))):
                        if abs(margin + side * gap) <= most:
                            made = changed(margin + side * gap)
                            if made.values is not None:
                                entry = min(entry, (pixel.rank(made), gap, made), key=lambda each: each[0])
                _, gap, made = entry
                delta, beyond = margin + side * gap, margin + side * pixel.unit
                if gap < pixel.unit:
                    made.beyond = changed(beyond if abs(beyond) <= most else side * most)
                found.append(state.changing(flip, abs(delta), made))
        return found

    def near(self, x: int, y: int, claims: Mapping[str, float]) -> bool:
        """Whether any decision of a pixel is within what is claimed: otherwise there is nothing to look for."""
        return any(self.analysis.margins[kind][y, x] <= claim for kind, claim in claims.items())

    def documented(self, renderer: Renderer) -> Sequence[Rule]:
        """Where a renderer says that it decides by rules of its own."""
        if renderer.name not in self._documented:
            rules = getattr(renderer, "rules", None)
            try:
                with blaming():
                    self._documented[renderer.name] = tuple(rules(self.scene, self.settings)) if rules else ()
            except RendererError as error:
                raise RulesError(renderer.name, f"its rules {error}") from error
        return self._documented[renderer.name]

    def following(self, rule: Rule, x: int, y: int) -> Iterator[Prover]:
        """Truth that follows another rule, in every way that the rule leaves open at a pixel."""
        if rule.choices is not None:
            for follower in itertools.islice(rule.choices(x, y), CHOICES):
                yield self._prover(rule, follower)
            return
        if rule not in self._rules:
            self._rules[rule] = self._prover(rule, rule.follower)
        yield self._rules[rule]

    def _prover(self, rule: Rule, follower: type[Follower]) -> Prover:
        return Prover(self.scene, rule.settings(self.settings), follower=follower, allowance=self.allowance)

    def parted(self, pixel: Pixel, possible: Possible) -> Decision:
        """The first decision that truth and what made the pixel took otherwise."""
        try:
            decision = parting.part(self.prover, possible.made.prover, pixel.truth.x, pixel.truth.y)
        except NOWHERE:
            decision = None
        if decision is None:
            return pixel.seen(possible.flip)
        return replace(decision, kind=possible.kind) if possible.kind else decision


@dataclass(frozen=True)
class Possible:
    """What may have made a pixel: cause, sentence, truth that follows it, and of a rounding what it changes."""

    cause: str
    because: str
    made: Made
    change: float | None = None
    flip: flips.Flip | None = None
    kind: str = ""


@dataclass(frozen=True)
class State:
    """Truth with numbers changed, and decisions taken otherwise."""

    made: Made
    change: float = 0.0
    flip: flips.Flip | None = None  # the first decision by which numbers are changed, or that is forced
    forced: tuple[flips.Flip, ...] = ()
    moved: tuple[flips.Flip, ...] = ()  # the decisions by which numbers are changed
    numbers: Made | None = None  # the same without forced decisions; None: as they are

    @property
    def steps(self) -> int:
        """What is done to truth."""
        return len(self.forced) + len(self.moved)

    def near(self, limits: Mapping[str, float]) -> list[flips.Flip]:
        """The decisions that may be taken otherwise besides."""
        taken = {flip.key for flip in self.forced}
        near = (flip for flip in self.made.decisions if self.change + flip.margin <= limits[flip.kind])
        return [flip for flip in near if flip.key not in taken]

    def forcing(self, flip: flips.Flip) -> State:
        """With one more decision otherwise."""
        taken = {flip.key: flip.forced}
        made = self.made.otherwise(taken)
        return replace(self, made=made, forced=(*self.forced, flip), flip=self.flip or flip)

    def changing(self, flip: flips.Flip, change: float, made: Made) -> State:
        """With numbers changed by so much more."""
        moved, flip = (*self.moved, flip), self.flip or flip
        return replace(self, made=made, change=self.change + change, flip=flip, moved=moved, numbers=made)

    def holding(self, near: Iterable[flips.Flip], but: flips.Flip) -> State:
        """With all decisions that are near, but for one, as they are, however numbers change."""
        return replace(self, made=self.made.otherwise({flip.key: flip.sign for flip in near if flip.key != but.key}))

    def possible(self, claims: Mapping[str, float], besides: str) -> Possible:
        """As a cause."""
        kinds = {flip.kind for flip in (*self.moved, *self.forced)} or {"range"}
        count = len(self.forced)
        change = max([self.change, *(flip.margin for flip in self.forced)])
        numbers = f"changing the scene's numbers by {self.change:.2g} (relative)" if self.change else ""
        decisions = f"{count} decision{'s' * (count > 1)} within its claim taken otherwise" if count else ""
        does = (
            f"{numbers}, with {decisions},"
            if numbers and count
            else numbers or "truth" + f" with {decisions}" * (count > 0)
        )
        if self.made.free:
            lights = (light_name(self.made.prover.scene, of.light) for of in self.made.free)
            direction = f"any direction to {', '.join(dict.fromkeys(lights))}, which is at the point itself,"
            does = f"{does} and {direction}" if self.steps else f"truth with {direction}"
        may = _may(min(claims[kind] for kind in kinds))
        kind = "" if count > 1 or (count and self.change) or self.flip is None else self.flip.kind
        return Possible(
            "rounding", f"rounding: {does} makes this pixel, and it {may}{besides}", self.made, change, self.flip, kind
        )


@dataclass(frozen=True)
class Free:
    """A light at a point itself: for rounding its direction may be any, so it gives a share of all that it can give."""

    bounce: int
    light: int
    diffuse: tuple[float, ...]  # the whole of it, as the pixel shows it
    specular: tuple[float, ...]

    def parts(self, name: str) -> list[tuple[float, ...]]:
        """Of a pass: what of it there may be any share of."""
        if name in ("diffuse", "specular", "direct"):
            parts = {"diffuse": [self.diffuse], "specular": [self.specular]}
            return parts.get(name, [self.diffuse, self.specular]) if self.bounce == 0 else []
        if name == "beauty" or (name == "reflection" and self.bounce) or name == f"reflection.{self.bounce}":
            return [self.diffuse, self.specular]
        return []


class Made:
    """A pixel of truth that is changed somehow; `beyond`: of a decision that flips, the same farther off.

    `least`: lights nearer to a point, relative to both, have any direction.
    """

    def __init__(self, prover: Prover, x: int, y: int, encoding: Encoding | None, least: float = -1.0) -> None:
        self.prover, self.x, self.y, self.encoding, self.least = prover, x, y, encoding, least
        self.beyond: Made | None = None

    def otherwise(self, forced: Mapping[Key, int]) -> Made:
        """The same with decisions taken otherwise."""
        other = Made(self.prover.forcing(forced), self.x, self.y, self.encoding, self.least)
        if self.beyond is not None:
            other.beyond = self.beyond.otherwise(forced)
        return other

    @functools.cached_property
    def _examined(self) -> tuple[Sequence[Hit], Mapping[Key, Any]]:
        try:
            return self.prover.examine(self.x, self.y)
        except NOWHERE:
            return [], {}

    @property
    def hits(self) -> Sequence[Hit]:
        """Those of the chain, with every sphere that hides a light; none where that cannot be had."""
        return self._examined[0]

    @functools.cached_property
    def path(self) -> object:
        """What comes of all decisions."""
        return [
            (
                hit.sphere,
                hit.inside,
                hit.touches,
                [(seen.faces, bool(seen.blockers), seen.specular is None) for seen in hit.sights],
            )
            for hit in self.hits
        ]

    def blockers(self, bounce: int, light: int) -> tuple[int, ...]:
        """The spheres that hide a light which a hit faces."""
        sights = (seen for hit in self.hits if hit.bounce == bounce for seen in hit.sights)
        return next((seen.blockers for seen in sights if seen.light == light and seen.faces > 0), ())

    @functools.cached_property
    def free(self) -> Sequence[Free]:
        """The lights that are at a point of the chain itself."""
        found = []
        scene = self.prover.scene
        for hit in self.hits if self.least >= 0 else ():
            sphere, point = scene.spheres[hit.sphere], [float(value.mid()) for value in hit.point]
            weight = 1.0 if hit.weight is None else float(hit.weight.mid())
            for light, lamp in enumerate(scene.lights):
                size = math.hypot(*point) + math.hypot(*lamp.position) + max(map(abs, sphere.scaling))
                if math.dist(point, lamp.position) <= self.least * size:
                    diffuse = (weight * sphere.kd * a * b for a, b in zip(lamp.intensity, sphere.color, strict=True))
                    specular = (weight * sphere.ks * a for a in lamp.intensity)
                    found.append(Free(hit.bounce, light, tuple(diffuse), tuple(specular)))
        return found

    def share(self, name: str, values: Sequence[float]) -> tuple[float, float]:
        """How far values are from the best share of what lights at the point itself may give, and the size of that."""
        parts = np.array([part for of in self.free for part in of.parts(name) if any(part)])
        exact = np.array([ball.value for ball in self.value(name)])
        if not parts.size or self.encoding or not np.isfinite([*exact, *values]).all():
            return math.inf, 0.0
        from scipy.optimize import lsq_linear

        shares = lsq_linear(parts.T, values - exact, (0, 1)).x
        return float(np.abs(parts.T @ shares + exact - values).max()), float(np.abs(parts).max() + np.abs(exact).max())

    @functools.cached_property
    def decisions(self) -> Sequence[flips.Flip]:
        """Those with the smallest margins first; none where that cannot be had."""
        return _decisions(self.prover, self.x, self.y)

    @functools.cached_property
    def steep(self) -> frozenset[Key]:
        """The decisions next to which slopes have no bound.

        Whether a ray of the chain meets what it hits, or R.V above 0 where n < 1.
        """
        steep = {Key("meets", hit.bounce, -1, hit.sphere) for hit in self.hits}
        exponents = [sphere.exponent for sphere in self.prover.scene.spheres]
        steep |= {
            Key("shines", hit.bounce, sight.light, hit.sphere)
            for hit in self.hits
            for sight in hit.sights
            if 0 < exponents[hit.sphere] < 1
        }
        # A ray that is held to touch has no root.
        return frozenset(key for key in steep if self.prover.forced.get(key) != 0)

    def gap(self, name: str) -> float:
        """The change as far as which slopes bound a pass: to the nearest steep place that it depends on."""
        return min(
            (margin for key, margin in self._steeps if _changes(key, name)), default=math.inf if self.decisions else 0.0
        )

    @functools.cached_property
    def _steeps(self) -> list[tuple[Key, float]]:
        # A ray that touches exactly has no root, whose slope had no bound.
        touched = {Key("meets", hit.bounce, -1, hit.sphere) for hit in self.hits if hit.touches}
        steep = self.steep - touched
        return [*((flip.key, flip.margin) for flip in self.decisions if flip.key in steep), *self.far_roots()]

    def far_roots(self) -> Iterator[tuple[Key, float]]:
        """By how little D = B^2 - A C may come to 0 where a ray begins inside what it hits: no decision asks for it."""
        near = {flip.key: flip for flip in self.decisions}
        for hit in self.hits:
            key = Key("start", hit.bounce, -1, hit.sphere)
            if not hit.inside or key not in near:
                continue
            scaling = self.prover.scene.spheres[hit.sphere].scaling
            A = sum((float(d.mid()) / s) ** 2 for d, s in zip(hit.direction, scaling, strict=True))
            # From where the ray begins to count: C is what decides there, and t a root of A t^2 + 2 B t + C.
            C, t = float(self._examined[1][key].mid()), float(hit.t.mid()) - (hit.bounce == 0)
            B = (A * t * t + C) / (2 * t) if t else 0.0
            # D moves with C, as far as that moves.
            size = A * near[key].moves
            yield key, max(B * B - A * C, 0.0) / size if size > 0 else 0.0

    @functools.cached_property
    def values(self) -> Mapping[str, tuple[Ball, ...]] | None:
        """By pass; None where that cannot be had."""
        try:
            return self.prover.pixel(self.x, self.y, ties=False).values
        except NOWHERE:
            return None

    def value(self, name: str) -> tuple[Ball, ...]:
        """A pass; it may reflect less often than the renderer."""
        return (self.values or {}).get(name, (Ball(0, 0, 0.0),) * 3)

    def size(self, name: str) -> float:
        """The largest channel."""
        size = max(abs(ball.value) for ball in self.value(name))
        return size if math.isfinite(size) else 0.0

    @functools.cached_property
    def facing(self) -> frozenset[int]:
        """The lights that the primary hit faces; where that cannot be had all: nothing is let pass."""
        try:
            hits, _ = self.prover.examine(self.x, self.y)
        except NOWHERE:
            return frozenset(range(len(self.prover.scene.lights)))
        return frozenset(sight.light for hit in hits[:1] for sight in hit.sights if sight.faces > 0)

    def sees(self, name: str, value: float) -> bool:
        """Whether an id or a visibility is the same, or means nothing as the light is behind the surface."""
        if self.value(name)[0].value == value:
            return True
        if name == "id":
            return False
        light = int(name.removeprefix("shadow.L"))
        return light not in self.facing or any(of.light == light and of.bounce == 0 for of in self.free)

    @functools.cached_property
    def moves(self) -> Mapping[str, float]:
        """Sensitivities: the largest, a bound of every channel."""
        try:
            found = flips.sensitivity(self.prover, self.x, self.y)
        except NOWHERE:
            return {}
        return {name: max(channels) for name, channels in found.items()}


class Pixel:
    """What a renderer drew at one pixel, beside truth."""

    def __init__(self, court: Court, truth: Truth, side: Side, compared: Sequence[str]) -> None:
        self.court, self.truth, self.side, self.compared = court, truth, side, compared
        self.left = SENSITIVITIES
        x, y = truth.x, truth.y
        self.values: dict[str, list[float]] = {}
        drawn = [name for name in ("id",) if name in side.passes and name not in compared]
        hit = truth.id >= 0 and ("id" not in side.passes or bool(side.passes["id"][y, x] >= 0))
        for name in (*drawn, *compared):
            row = lookup(name)
            if row.quantity in ("length", "position", "normal", "visibility") and not hit:
                continue
            if row.quantity == "visibility" and not court.analysis.lit[int(name.removeprefix("shadow.L"))][y, x]:
                continue
            self.values[name] = [float(value) for value in np.atleast_1d(side.passes[name][y, x])]
        unit = self.at(side.claim.unit)
        # Where it claims nothing, truth has to come as near as anywhere else to be taken for the cause.
        self.unit = unit if math.isfinite(unit) else float(np.min(side.claim.unit))
        self.in_order = sorted(self.values, key=_place)
        self.errors = self.off()

    def at(self, value: PerPixel) -> float:
        """A number that may depend on the pixel."""
        return float(np.broadcast_to(value, self.court.analysis.ids.shape)[self.truth.y, self.truth.x])

    def tolerance(self, name: str, sensitivity: float, size: float) -> float:
        """How far this renderer's value may be from the exact one."""
        quantity = lookup(name).quantity
        if quantity in ("id", "visibility"):
            return 0.0
        absolute = self.at(self.side.claim.absolute_of(name))
        if quantity == "normal":
            absolute += self.unit
        moves = self.unit * (sensitivity + size) if sensitivity + size else 0.0
        return moves + absolute

    def sensitivity(self, name: str) -> float:
        """Of the exact value, in float64."""
        return float(self.court.analysis.sensitivity[name][self.truth.y, self.truth.x])

    def off(self) -> dict[str, float]:
        """By pass the error, where it is above the tolerance."""
        found = {}
        for name, values in self.values.items():
            error = distance(name, values, self.truth.values[name], self.side.encoding)
            tolerance = self.tolerance(name, self.sensitivity(name), 0.0)
            behind = self.court.analysis.behind(name)
            nearest = min(float(behind[kind][self.truth.y, self.truth.x]) for kind in STEEP)
            told = math.isfinite(tolerance) and nearest > self.unit
            if not error <= (tolerance if told else self.court.bound(self.side, name)):
                found[name] = error
        # In float64 a decision of the pixel may have gone the other way, and its sensitivities with it.
        margin = min(float(margins[self.truth.y, self.truth.x]) for margins in self.court.analysis.margins.values())
        if found and margin <= self.unit:
            made = self.made(self.court.prover)
            found = {name: error for name, error in found.items() if not self.agrees(name, self.values[name], made)}
        return found

    def concerns(self, together: Sequence[flips.Flip]) -> bool:
        """Whether decisions can change all that is off, and each of them some of it."""
        changed = [{name for name in self.errors if _changes(flip.key, name)} for flip in together]
        return all(changed) and len(set[str]().union(*changed)) == len(self.errors)

    def made(self, prover: Prover, least: float = -1.0) -> Made:
        """The same pixel of changed truth; `least`: see `Made`."""
        return Made(prover, self.truth.x, self.truth.y, self.side.encoding, least)

    def following(self, rule: Rule, prover: Prover) -> Made:
        """The same of truth that follows a rule, which may be one about files."""
        encoding = self.side.encoding
        if rule.wraps and encoding:
            encoding = replace(encoding, wraps=True)
        return Made(prover, self.truth.x, self.truth.y, encoding)

    def makers(
        self, possible: Sequence[Possible], *, within: float = math.inf, sensitivities: int | None = None
    ) -> Iterator[Possible]:
        """Of several those that make this pixel, the nearest first.

        `within`: in rough tolerances, what is no more worth a look; `sensitivities`: how many may be worked out, where
        that is not what is left.
        """
        if sensitivities is not None:
            self.left = sensitivities
        scores = [(self.score(entry.made), self.unsaid(entry.made), entry) for entry in possible]
        for score, _, entry in sorted(scores, key=lambda each: each[:2]):
            if score < math.inf and score <= within and not self.idle(entry) and self.made_by(entry.made):
                yield entry

    def unsaid(self, made: Made) -> int:
        """How many lights it sees otherwise, if only where that means nothing."""
        seen = (name for name in self.values if lookup(name).quantity == "visibility")
        return sum(made.value(name)[0].value != self.values[name][0] for name in seen)

    def idle(self, possible: Possible) -> bool:
        """Whether something that is no rounding is nothing but truth in all that is off: then it is not the cause."""
        made = possible.made
        if possible.cause == "rounding" or made.encoding != self.side.encoding:
            return False
        same = all(made.value(name) == self.truth.values[name] for name in self.errors)
        return same and not any(
            lookup(name).quantity == "visibility" and int(name.removeprefix("shadow.L")) not in made.facing
            for name in self.errors
        )

    def promising(self, possible: Sequence[Possible]) -> list[Possible]:
        """Of several that make this pixel in part at most, those that make the most of what is off."""

        def missed(entry: Possible) -> int:
            return sum(self.far(name, self.values[name], entry.made) > CLEARLY for name in self.errors)

        ranked = sorted((missed(entry), place) for place, entry in enumerate(possible) if entry.made.values is not None)
        return [possible[place] for _, place in ranked[:HALFWAY]]

    def rank(self, made: Made) -> tuple[int, float]:
        """How many passes changed truth does not make, from the first of them on, and how far off it is: roughly.

        Next to an outline a value may be off by a root of the unit.
        """
        unmade, off = 0, 0.0
        for place, name in enumerate(self.in_order):
            values, row = self.values[name], lookup(name)
            if row.quantity in ("id", "visibility"):
                error, size, least = 0.0 if made.sees(name, values[0]) else math.inf, 1.0, 0.0
            else:
                exact, size = made.value(name), made.size(name)
                if made.encoding and name == "beauty":
                    error = distance(name, values, exact, made.encoding)
                else:
                    error = max(abs(value - ball.value) for value, ball in zip(values, exact, strict=True))
                least = self.tolerance(name, 0.0, size)
            if not error <= max(least, 4 * math.sqrt(self.unit) * (1 + size)):
                unmade = unmade or 2 ** (len(self.in_order) - place)
                unmade += 1
            if not error <= least:
                off += min(math.log2(error / least), BITS) if least > 0 and error < math.inf else BITS
        return unmade, off

    def score(self, made: Made) -> float:
        """How far changed truth is from this pixel, in rough tolerances; inf: another id or visibility."""
        if made.values is None:
            return math.inf
        return max((self.far(name, values, made) for name, values in self.values.items()), default=0.0)

    def far(self, name: str, values: Sequence[float], made: Made) -> float:
        """The same of one pass; 0 within the tolerance."""
        if lookup(name).quantity in ("id", "visibility"):
            return 0.0 if made.sees(name, values[0]) else math.inf
        error = distance(name, values, made.value(name), made.encoding)
        sensitivity = self.sensitivity(name)
        allowed = self.tolerance(name, sensitivity if math.isfinite(sensitivity) else 1.0, made.size(name))
        return 0.0 if error <= allowed else error / allowed if allowed else math.inf

    def made_by(self, made: Made) -> bool:
        """Whether changed truth makes every value of this pixel within the renderer's tolerance there."""
        return not self.wanting(made)

    def wanting(self, made: Made) -> str:
        """The first pass along the ray that changed truth does not make; "": it makes all."""
        return next((name for name in self.in_order if not self.agrees(name, self.values[name], made)), "")

    def agrees(self, name: str, values: Sequence[float], made: Made) -> bool:
        """Whether one pass does."""
        if lookup(name).quantity in ("id", "visibility"):
            return made.sees(name, values[0])
        error, size = distance(name, values, made.value(name), made.encoding), made.size(name)
        if error <= self.tolerance(name, 0.0, size):
            return True
        left, size = made.share(name, values) if made.free else (math.inf, size)
        if left <= self.tolerance(name, 0.0, size):
            return True
        # What the first order says of a value next to a decision holds as far as the decision: just behind an outline
        # the slope has no bound. Beyond the gap the slope that counts is the one farther off.
        for truth in (made, made.beyond):
            if truth is None:
                continue
            if "moves" not in vars(truth):
                if not self.left:
                    return False
                self.left -= 1
            share = min(1.0, truth.gap(name) / self.unit)
            if error <= self.tolerance(name, share * truth.moves.get(name, 0.0), size):
                return True
        return False

    def seen(self, flip: flips.Flip | None = None) -> Decision:
        """What can be told from the values alone; `flip`: the decision they are near to."""
        return parting.seen(self.court.scene, self.truth.id, self.values, self.errors, flip)


def _decisions(prover: Prover, x: int, y: int) -> list[flips.Flip]:
    """Of changed truth at a pixel, those with the smallest margins first; none where that cannot be had."""
    try:
        return flips.flips(prover, x, y)
    except NOWHERE:
        return []


def _may(claim: float) -> str:
    """What a renderer claims, as a clause."""
    return f"may be off by {claim:.2g}" if claim < 1 else "claims no bound here"


def _changes(key: Key, name: str) -> bool:
    """Whether a decision can change a pass."""
    if name in ("beauty", "reflection") or name.startswith("reflection."):
        bounce = int(name.removeprefix("reflection.")) if "." in name else None
        if bounce is None:
            return name == "beauty" or key.bounce > 0 or key.light < 0
        return bounce == key.bounce or (key.light < 0 and bounce > key.bounce)
    if key.light < 0 or key.bounce:
        return key.bounce == 0
    if key.what == "shines":
        return name in ("specular", "direct")
    # Where N.L is not above 0 visibility means nothing.
    return name in ("diffuse", "specular", "direct", f"shadow.L{key.light}")


def _place(name: str) -> tuple[int, str]:
    """Where a pass comes along the ray: what is seen, the lights, then what is reflected, at last sums."""
    if name in ("beauty", "reflection"):
        return 5, name
    if name.startswith("reflection."):
        return 4, name
    if name in ("diffuse", "specular", "direct"):
        return 3, name
    return (0 if name == "id" else 2 if lookup(name).quantity == "visibility" else 1), name


def _gaps(margin: float, claim: float, first: float, side: int) -> list[float]:
    """How far beyond a decision numbers are changed, to that side: from `first` to where the claim ends."""
    last = claim - margin if side > 0 else claim + margin
    if not first <= last:
        return [last] if last > 0 else []
    count = math.ceil(math.log(last / first, GROWTH))
    return [min(first * GROWTH**k, last) for k in range(count + 1)]


def distance(name: str, values: Sequence[float], exact: Sequence[Ball], encoding: Encoding | None = None) -> float:
    """The error of a pass at a pixel: its largest channel; of a normal the length of the difference.

    Of an image that is encoded as far as the colours that its levels stand for.
    """
    if encoding and name == "beauty":
        levels = np.rint(np.array(values) * encoding.steps)
        return float(encoding.distance(levels, np.array([ball.value for ball in exact])).max())
    errors = [ball.error(value) for value, ball in zip(values, exact, strict=True)]
    if any(math.isnan(error) for error in errors):
        return math.inf
    return math.hypot(*errors) if lookup(name).quantity == "normal" else max(errors)
