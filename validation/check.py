"""For the author of a ray tracer: which conventions an image was made with, and what they do not explain.

Where in a pixel its ray goes, whether rows count from the top, and what becomes of a colour on its way to a byte are
conventions that programs differ in, and each changes thousands of pixels of a right image. So they are fitted first:
those that explain the most pixels. Where a known mistake hides most of the image, truth that makes the mistake tells
what the bytes of those pixels mean.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import tracer
from tracer.passes import SAMPLES, Passes, Sample
from validation import images, records
from validation.encoding import QUANTISATIONS, Encoding
from validation.records import Record
from validation.renderers import Settings, Uncertainty, floats
from validation.renderers.command import PREFIX, Command, Limits, WholeImageError
from validation.run import (
    ANALYSIS_MAX_PIXELS,
    MOST_VERDICTS,
    InputError,
    Note,
    Rendered,
    RendererError,
    Validation,
    draw,
    shrink,
    validate,
)

Colors: TypeAlias = NDArray[np.float64]

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.follow import Follower
    from validation.verdict import Verdict

    _Counts: TypeAlias = dict["Convention", int]

#: What an image is held against: it draws every scene, exactly enough for any number of levels.
REFERENCE = "native-f64"

#: Pixels that are looked at of larger images, drawn at random: enough to tell conventions apart.
MOST = 400_000
#: More than this share of pixels left over, and mistakes are tried; at so many of them, and at as many contours.
TELLING, ASKED = 1e-3, 200
#: So many pixels of an image tell whether a fault of its layout is worth a look at all of them: they may be off by this
#: share, which is more than four times what chance makes of so few.
PROBED, CHANCE = 2000, 0.05
#: The least share of pixels that a convention explains which is taken for the one.
KNOWN = 0.05
#: Of those a mistake that makes less than half of the first few is none.
FIRST = 16

#: No more pixels are judged than so many of an image if these all come to the same, unless more are asked for.
FIRST_ALIKE = 12

#: Unless more are asked for so many seconds are spent on judging, over all images, of which each has its share; a part
#: of that is enough for FIRST_ALIKE pixels with one mistake. So many pixels are judged whatever that takes.
SECONDS, NAMED, FEW = 20.0, 0.25, 3

#: How a verdict names a mistake, and the share of the pixels judged that have to show one.
MISTAKE, LIKELY = "truth makes this pixel if it ", 5

#: Conventions that explain an image equally well and are named.
MOST_ALIKE = 3

#: What files are found to be made of, by how to undo it: faults of writing, which make every pixel wrong.
LAYOUTS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "red and blue are swapped": lambda levels: levels[:, :, ::-1],
    "the first column of the file is the rightmost": lambda levels: levels[:, ::-1],
    "rows and columns are swapped": lambda levels: levels.transpose(1, 0, 2),
    "the image is one pixel too far to the right": lambda levels: np.roll(levels, -1, axis=1),
    "the image is one pixel too far to the left": lambda levels: np.roll(levels, 1, axis=1),
    "the image is one pixel too low": lambda levels: np.roll(levels, -1, axis=0),
    "the image is one pixel too high": lambda levels: np.roll(levels, 1, axis=0),
}

#: Where each sample point lies, in words.
PLACES: dict[Sample, str] = {
    "corner": "the top-left corner of the pixels",
    "center": "the centre of the pixels",
    "bottom-left": "the bottom-left corner of the pixels",
    "top-right": "the top-right corner of the pixels",
    "inclusive": "the first to the last pixel, both on the border",
}


@dataclass(frozen=True)
class Picture:
    """An image of a scene: levels (rows, columns, 3) from 0 to `steps`."""

    label: str
    scene: Scene
    levels: NDArray[Any]
    steps: int = 255
    ending: str = ""  # how the program ended, if not well, as a clause: "ended with exit status 1"
    told: str = ""  # all that there is to say about that


@dataclass(frozen=True)
class Convention:
    """How an image was made: `sample` as in the settings, `flipped` if the first row of the file is the lowest.

    `fault`: what is wrong with the layout of its pixels, a key of LAYOUTS, or "".
    """

    sample: Sample = "corner"
    flipped: bool = False
    quantisation: str = "truncate"
    fault: str = ""

    def encoding(self, steps: int = 255) -> Encoding:
        """How its levels stand for colours."""
        return Encoding(self.quantisation, steps)

    def upright(self, levels: NDArray[Any]) -> NDArray[Any]:
        """An image with its first row on top, and without the fault."""
        levels = levels[::-1] if self.flipped else levels
        return LAYOUTS[self.fault](levels) if self.fault else levels

    @property
    def specified(self) -> bool:
        """Whether it is the specification's."""
        return self == SPECIFIED

    @property
    def says(self) -> tuple[str, ...]:
        """In words: sampling, quantisation, and the order of rows where it is not the specification's."""
        return self.in_words()

    @property
    def short(self) -> str:
        """As the options and the result file name it."""
        return ", ".join([self.sample, self.quantisation, *(["flipped"] if self.flipped else [])])

    def in_words(self, steps: int = 255) -> tuple[str, ...]:
        """The same, of so many levels above 0."""
        rows = ("the first row of the file is the lowest",) if self.flipped else ()
        return (f"samples at {PLACES[self.sample]}", self.encoding(steps).says, *rows)


#: What the specification asks for.
SPECIFIED = Convention()


def explain_words(convention: Convention) -> list[str]:
    """Options of `whitted explain` that tell it of a convention; where it samples is a setting."""
    words = [] if convention.quantisation == SPECIFIED.quantisation else ["--quantisation", convention.quantisation]
    return words + ["--flipped"] * convention.flipped


@dataclass(frozen=True)
class Fit:
    """The convention that explains images best.

    `explained`: pixels whose bytes it makes, of `pixels` that were looked at. `plain`: those that the specification's
    makes. `alike`: others that explain as many. `wraps`: colours above 1 were not clamped but begin again at 0.
    `mistake`: the known mistake with which the bytes make sense, as a clause. `known`: False if no convention explains
    enough to be taken for the one; it is the specification's then.
    """

    convention: Convention
    pixels: int
    explained: int
    plain: int
    alike: tuple[Convention, ...] = ()
    wraps: bool = False
    mistake: str = ""
    known: bool = True


@dataclass
class _Candidate:
    convention: Convention
    wraps: bool
    places: list[NDArray[np.bool_]] = field(default_factory=list)  # by picture, where

    @functools.cached_property
    def explained(self) -> int:
        """How many pixels of all pictures; asked for when `places` is complete."""
        return sum(int(same.sum()) for same in self.places)


def _explained(candidate: _Candidate) -> int:
    return candidate.explained


def fit(pictures: Sequence[Picture], settings: Settings) -> Fit:
    """The convention that explains the most pixels of all pictures together, the likeliest of several that do.

    `settings.sample` plays no part.
    """
    chosen = [_chosen(picture) for picture in pictures]
    colors = {
        sample: [
            _draw(picture.scene, replace(settings, sample=sample)).reshape(-1, 3)[places]
            for picture, places in zip(pictures, chosen, strict=True)
        ]
        for sample in SAMPLES
    }
    plain = _tally(pictures, chosen, colors, "")
    pixels = sum(map(len, chosen))
    best, tally = max(plain, key=_explained), plain
    left = pixels - best.explained
    specified = next(candidate.explained for candidate in plain if candidate.convention.specified)
    if left <= TELLING * pixels:
        alike = [
            candidate.convention
            for candidate in plain
            if candidate.explained == best.explained and not candidate.wraps and candidate is not best
        ]
        return Fit(best.convention, pixels, best.explained, specified, tuple(alike), best.wraps)
    # A fault of the layout has to explain most of what is left, as other pixels are the same by chance.
    square = all(picture.levels.shape[0] == picture.levels.shape[1] for picture in pictures)
    least = best.explained + left / 2
    few = [
        np.random.default_rng(0).permutation(len(places))[: math.ceil(PROBED / pixels * len(places))]
        for places in chosen
    ]
    probed = [places[some] for places, some in zip(chosen, few, strict=True)]
    of_few = {sample: [of[some] for of, some in zip(colors[sample], few, strict=True)] for sample in SAMPLES}
    enough = (least / pixels - CHANCE) * sum(map(len, probed))
    for fault in LAYOUTS:
        if not square and fault == "rows and columns are swapped":
            continue
        if max(map(_explained, _tally(pictures, probed, of_few, fault))) < enough:
            continue
        faulty = _tally(pictures, chosen, colors, fault)
        candidate = max(faulty, key=_explained)
        if candidate.explained > max(least, best.explained):
            best, tally = candidate, faulty
    if pixels - best.explained <= TELLING * pixels:
        return Fit(best.convention, pixels, best.explained, specified, (), best.wraps)
    told = _mistaken(pictures, chosen, best, settings)
    if told is None and best.explained < KNOWN * pixels:
        return Fit(SPECIFIED, pixels, specified, specified, known=False)
    if told is None:
        return Fit(best.convention, pixels, best.explained, specified, (), best.wraps)
    (convention, *others), mistake = told
    explained = next(entry.explained for entry in tally if (entry.convention, entry.wraps) == (convention, best.wraps))
    return Fit(convention, pixels, explained, specified, tuple(others), best.wraps, mistake)


def _tally(
    pictures: Sequence[Picture],
    chosen: Sequence[NDArray[np.int64]],
    colors: Mapping[Sample, Sequence[Colors]],
    fault: str,
) -> list[_Candidate]:
    """Which of the chosen pixels every convention makes, the likeliest convention first, those that wrap last."""
    found = {
        (convention, wraps): _Candidate(convention, wraps)
        for wraps in (False, True)
        for convention in conventions(fault)
    }
    for k, (picture, places) in enumerate(zip(pictures, chosen, strict=True)):
        levels = [
            Convention(flipped=flipped, fault=fault).upright(picture.levels).reshape(-1, 3)[places]
            for flipped in (False, True)
        ]
        for sample, quantisation in itertools.product(SAMPLES, QUANTISATIONS):
            drawn = colors[sample][k]
            for wraps in (False, True):
                if not wraps or (drawn > 1).any():
                    expected = Encoding(quantisation, picture.steps, wraps).either(drawn)
                for flipped in (False, True):
                    candidate = found[Convention(sample, flipped, quantisation, fault), wraps]
                    same = expected[0] == levels[flipped]
                    if len(expected) > 1:
                        same |= expected[-1] == levels[flipped]
                    candidate.places.append(same[:, 0] & same[:, 1] & same[:, 2])  # all() takes five times as long
    return list(found.values())


def conventions(fault: str = "") -> Iterator[Convention]:
    """All of them, the likeliest first."""
    for flipped, sample, quantisation in itertools.product((False, True), SAMPLES, QUANTISATIONS):
        yield Convention(sample, flipped, quantisation, fault)


def _draw(scene: Scene, settings: Settings) -> NDArray[np.float64]:
    drawn = tracer.render(
        scene,
        ("beauty",),
        threads=settings.threads,
        sample=settings.sample,
        shadow_epsilon=settings.shadow_epsilon,
        max_reflections=settings.max_reflections,
    )
    return drawn["beauty"]


def _chosen(picture: Picture) -> NDArray[np.int64]:
    """The pixels that are looked at, by index."""
    count = picture.levels.shape[0] * picture.levels.shape[1]
    if count <= MOST:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, MOST, replace=False))


def _mistaken(
    pictures: Sequence[Picture], chosen: Sequence[NDArray[np.int64]], best: _Candidate, settings: Settings
) -> tuple[list[Convention], str] | None:
    """The conventions with which truth that makes a known mistake makes the most pixels, and the mistake; None: none.

    Of the picture of which the most is left: some of these pixels tell the mistake and the quantisation, and some
    at contours of the image the sampling.
    """
    from validation.follow import Follower
    from validation.rules import mistakes
    from validation.truth import NOWHERE, Prover

    missed = [np.flatnonzero(~same) for same in best.places]
    worst = max(range(len(pictures)), key=lambda k: len(missed[k]))
    picture = pictures[worst]
    columns, steps, wraps = picture.levels.shape[1], picture.steps, best.wraps
    upright = best.convention.upright(picture.levels)
    levels = {best.convention.flipped: upright.reshape(-1, 3)}
    samples: Sequence[Sample] = (best.convention.sample,)
    if best.explained < sum(map(len, chosen)) / 2:
        # Then it tells neither the sampling nor the order of rows.
        samples = SAMPLES
        levels[not best.convention.flipped] = upright[::-1].reshape(-1, 3)
    rng = np.random.default_rng(0)
    left = rng.permutation(chosen[worst][missed[worst]])[:ASKED]
    contours = rng.permutation(np.flatnonzero(_contours(upright)))[:ASKED]
    asked = np.concatenate([left, contours])
    settings = replace(settings, sample=best.convention.sample)

    def colors(prover: Prover, places: NDArray[np.int64]) -> Colors:
        """Of changed truth; NaN where it cannot be had, which no level stands for."""
        found = np.full((len(places), 3), np.nan)
        for k, place in enumerate(places):
            with contextlib.suppress(*NOWHERE):
                truth = prover.pixel(int(place % columns), int(place // columns), ties=False)
                found[k] = [ball.value for ball in truth.values["beauty"]]
        return found

    def same(made: Colors, places: NDArray[np.int64], quantisation: str, flipped: bool) -> int:
        encoding = Encoding(quantisation, steps, wraps)
        return int((encoding.makes(made, levels[flipped][places]) & ~np.isnan(made)).all(axis=-1).sum())

    def counted(told: Settings, follower: type[Follower], places: NDArray[np.int64], some: Sequence[Sample]) -> _Counts:
        """How many of some pixels each convention makes, of truth that follows a rule."""
        found = {}
        for sample in some:
            made = colors(Prover(picture.scene, replace(told, sample=sample), follower=follower), places)
            for quantisation, flipped in itertools.product(QUANTISATIONS, levels):
                convention = replace(best.convention, sample=sample, quantisation=quantisation, flipped=flipped)
                found[convention] = same(made, places, quantisation, flipped)
        return found

    # A mistake has to explain more than another convention does without it, by far; most of what is asked at least.
    without = max(counted(settings, Follower, asked, SAMPLES).values())
    most, result = max(len(asked) / 2, without + len(asked) / 4), None
    for rule in mistakes(picture.scene, settings):
        told = rule.settings(settings)
        if told.sample != settings.sample or rule.wraps:
            continue
        if max(counted(told, rule.follower, left[:FIRST], samples).values()) < min(FIRST, len(left)) / 2:
            continue
        found = counted(told, rule.follower, asked, SAMPLES)
        if (count := max(found.values())) > most:
            most, result = count, ([entry for entry in found if found[entry] == count], rule.says)
    return result


def _contours(levels: NDArray[Any]) -> NDArray[np.bool_]:
    """Where an image changes from a pixel to the next by more than a sixteenth of its range."""
    values = levels.astype(np.int64)
    least = (int(values.max(initial=0)) - int(values.min(initial=0))) // 16
    found = np.zeros(values.shape[:2], dtype=bool)
    across = (np.abs(np.diff(values, axis=1)) > least).any(axis=-1)
    down = (np.abs(np.diff(values, axis=0)) > least).any(axis=-1)
    found[:, 1:] |= across
    found[:, :-1] |= across
    found[1:] |= down
    found[:-1] |= down
    return found


# ---- what is left


class Pace:
    """How long judging takes: every image has its share of the time, in which its places come one by one."""

    def __init__(self, images: int, seconds: float) -> None:
        """`seconds`: over so many images."""
        self.images, self.left = images, seconds
        self.judged = 0

    def through(self, places: Sequence[tuple[int, int]], verdicts: Sequence[Verdict]) -> Iterator[tuple[int, int]]:
        """As many of the places as there is time for; `verdicts`: those that there are, which grows."""
        begin, share = time.monotonic(), self.left / max(self.images, 1)
        try:
            for k, place in enumerate(places):
                spent = time.monotonic() - begin
                over = spent > share or (spent > NAMED * share and _named(verdicts))
                if over and k and self.judged >= FEW:
                    return
                self.judged += 1
                yield place
        finally:
            self.left = max(self.left - (time.monotonic() - begin), 0.0)

    def next(self) -> None:
        """Go on to another image."""
        self.images -= 1


def _named(verdicts: Sequence[Verdict]) -> bool:
    """Whether enough of them come to one mistake."""
    found = Counter(verdict.renderer.because for verdict in verdicts if verdict.renderer.cause == "mistake")
    return max(found.values(), default=0) >= FIRST_ALIKE


class Still:
    """Images that are there already, behind the face of a renderer: each is of one scene."""

    precision = "8-bit"

    def __init__(
        self,
        name: str,
        pictures: Sequence[Picture],
        convention: Convention,
        suspected: str = "",
        pace: Pace | None = None,
    ) -> None:
        """`pictures` were made with that convention; `suspected`: the mistake that the judge tries first."""
        self.suspected, self.pace = suspected, pace
        self.name, self.pictures = name, pictures
        self.convention, self.encoding = convention, Encoding(convention.quantisation)

    def version(self) -> str:
        """Nothing is known about what made them."""
        return "unknown"

    def versions(self) -> Mapping[str, str]:
        """How they are read."""
        return {"convention": "; ".join(self.convention.says)}

    def passes(self, scene: Scene, settings: Settings) -> tuple[str, ...]:
        """The image, of the scenes that there is one of."""
        del settings
        return ("beauty",) if self._of(scene) else ()

    def refusal(self, scene: Scene) -> str:
        """Why there is none."""
        view = scene.view
        return f"it has no image of {view.columns}x{view.rows} pixels"

    def _of(self, scene: Scene) -> Picture | None:
        # Two of them may have equal scenes.
        return next((picture for picture in self.pictures if picture.scene is scene), None)

    def unavailable(self) -> str | None:
        """They are there."""
        return None

    def uncertainty(self, scene: Scene, settings: Settings, analysis: Analysis | None = None) -> Uncertainty:
        """What a careful program in float32 may be off by: nothing is known about its precision."""
        del analysis
        return floats.uncertainty("f32", scene, settings)

    def render(self, scene: Scene, passes: Sequence[str], settings: Settings) -> Passes:
        """The image of that scene, levels over their number."""
        del settings
        picture = self._of(scene)
        assert picture is not None
        beauty = self.convention.upright(picture.levels) / np.float64(picture.steps)
        told = {"levels": str(picture.steps)}
        if self.name.startswith(PREFIX):
            told["explain"] = shlex.join(explain_words(self.convention))
        return Passes(dict.fromkeys(passes, beauty), told)

    def max_pixels(self, scene: Scene, passes: Sequence[str]) -> int | None:
        """They are there."""
        del scene, passes
        return None


@dataclass(frozen=True)
class Left:
    """Pixels of one image that its convention does not explain: off by one level or by more, and at edges or not."""

    label: str
    pixels: int
    by_one: int
    by_more: int
    interior: int
    edge: int

    @property
    def off(self) -> int:
        """All of them."""
        return self.interior + self.edge


@dataclass(frozen=True)
class Checked:
    """The convention of some images, what it leaves, and the comparison and verdicts behind that."""

    fit: Fit | None  # None: there was no image
    left: Sequence[Left]
    validation: Validation
    steps: int = 255
    ending: str = ""  # how the program ended, if not well, as a clause

    @property
    def status(self) -> int:
        """The exit status: as of the comparison; a convention of its own is no fault, a layout and an ending are."""
        return self.validation.status

    @property
    def says(self) -> str:
        """What came out, in a word or a few."""
        if self.validation.failures:
            return "failed"
        if self.status:
            right = self.validation.wrong == (self.ending,) and replace(self.validation, wrong=()).ok
            return f"right, but it {self.ending}" if right else "not right"
        return "right" if self.fit is None or self.fit.convention.specified else "right but for its convention"

    @property
    def judged(self) -> int:
        """Pixels that were judged, of all images."""
        return sum(len(verdicts.verdicts) for verdicts in self.validation.verdicts)

    def likely(self) -> dict[str, int]:
        """The mistakes that most pixels show, as clauses, and how many of those that were judged."""
        found = Counter(
            verdict.renderer.because.removeprefix(MISTAKE)
            for verdicts in self.validation.verdicts
            for verdict in verdicts.verdicts
            if verdict.renderer.cause == "mistake"
        )
        # A few pixels look like many things.
        return {says: count for says, count in found.most_common() if count >= self.judged / LIKELY}

    def diagnosis(self) -> list[str]:
        """The same as sentences."""
        pixels = f"of {self.judged} pixels judged"
        return [f"most likely: it {says} ({count} {pixels})" for says, count in self.likely().items()]

    def about(self) -> list[str]:
        """The convention, what it explains, and what is left, a line each; indented: about the line before."""
        lines, likely = [], self.likely()
        if fit := self.fit:
            share = f"{fit.explained} of {fit.pixels} pixels"
            said = "; ".join(fit.convention.in_words(self.steps))
            lines.append(f"convention: {said}" if fit.known else f"no known convention explains the image; as: {said}")
            if fit.convention.fault:
                lines.append(f"wrong: {fit.convention.fault}; it is compared as if that were right")
            if fit.convention.specified and not fit.wraps:
                lines.append(f"  that of the specification; it makes {share} byte by byte")
            else:
                lines.append(f"  it makes {share} byte by byte, the specification's makes {fit.plain}")
            # Judged pixel by pixel it may turn out to be another one: a single cause is told.
            if fit.mistake and (fit.mistake in likely or not likely):
                lines.append(f"  fitted with the mistake that most of the rest shows: the program {fit.mistake}")
            if fit.alike:
                others = "; or ".join(", ".join(other.says) for other in fit.alike[:MOST_ALIKE])
                more = len(fit.alike) - MOST_ALIKE
                lines.append(f"  as many are made by: {others}" + (f", and {more} more" if more > 0 else ""))
            if fit.wraps:
                lines.append("wrong: colors above 1 are not clamped: they begin again at 0")
        if self.ending:
            lines.append(f"wrong: the program {self.ending}; what it has drawn is checked all the same")
        for entry in self.left:
            if not entry.off:
                lines.append(f"{entry.label}: nothing is left, all {entry.pixels} pixels are explained")
                continue
            levels = f"{entry.by_one} off by 1 level, {entry.by_more} by more"
            places = f"{entry.edge} at edges, {entry.interior} in the interior"
            lines.append(f"{entry.label}: {entry.off} of {entry.pixels} pixels are left: {levels}; {places}")
        return lines

    def record(self) -> Record:
        """Everything as strictly valid JSON: that of the comparison, `fit` and `left` before it."""
        fit = self.fit
        fields: Record = {
            "fit": fit
            and {
                "sample": fit.convention.sample,
                "flipped": fit.convention.flipped,
                "quantisation": fit.convention.quantisation,
                "fault": fit.convention.fault or None,
                "says": list(fit.convention.says),
                "pixels": fit.pixels,
                "explained": fit.explained,
                "explained_by_specification": fit.plain,
                "alike": [list(convention.says) for convention in fit.alike],
                "wraps": fit.wraps,
                "mistake": fit.mistake or None,
                "known": fit.known,
            },
            "left": [vars(entry).copy() for entry in self.left],
            "ending": self.ending or None,
            **self.validation.record(),
        }
        return records.result("check", fields)


def check(
    pictures: Sequence[Picture],
    settings: Settings | None = None,
    *,
    name: str = "image",
    failures: Sequence[Note] = (),
    verdicts: int | None = None,
    on_rendered: Callable[[Rendered], None] | None = None,
    progress: Callable[[str], None] | None = None,
    on_scene: Callable[[Checked], None] | None = None,
) -> Checked:
    """Fit the convention of images that one program made, and compare and judge what it leaves.

    Args:
        pictures: one a scene, labels all different.
        settings: what the program does; its `sample` is fitted.
        name: of the program, for the verdicts.
        failures: what it failed at before, of other scenes.
        verdicts: of each image so many differing pixels are judged; None: a hundred, or the first few where these all
            come to the same mistake, or to none that is known, or as many as there is time for.
        on_rendered: called with every image that was compared.
        progress: called with what is being done.
        on_scene: called after every image with what was found so far.

    Raises:
        InputError: an image that is too large.
    """
    settings = settings or Settings()
    if not pictures:
        nothing = Validation(settings=settings, failures=list(failures))
        return Checked(None, (), nothing)
    for picture in pictures:
        view = picture.scene.view
        if shrink(view.columns, view.rows, ANALYSIS_MAX_PIXELS) != (view.columns, view.rows):
            raise InputError(
                f"{picture.label}: error: an image of {view.columns}x{view.rows} pixels takes too long to be checked\n"
                f"  hint: draw the scene with at most {ANALYSIS_MAX_PIXELS} pixels"
            )
    if progress:
        progress("fitting sampling and quantisation")
    found = fit(pictures, settings)
    short = found.convention.short

    def judging(text: str) -> None:
        if progress:
            progress(f"{short}: {text}")

    pace = Pace(len(pictures), SECONDS if verdicts is None else math.inf)
    still = Still(name, pictures, found.convention, found.mistake, pace)
    left: list[Left] = []

    def rendered(entry: Rendered) -> None:
        for comparison in entry.comparisons:
            if comparison.maps is not None:
                left.append(_left(entry, comparison.maps, found.convention))
        pace.next()
        if on_rendered:
            on_rendered(entry)

    def checked(result: Validation) -> Checked:
        result.failures[:0] = failures
        # What a comparison says to who may not know of this one.
        result.notes = [note for note in result.notes if "`whitted check`" not in note.message]
        result.notes += [Note(picture.label, name, picture.told) for picture in pictures if picture.ending]
        endings = [picture.ending for picture in pictures if picture.ending]
        ending = endings[0] if endings else ""
        if ending and len(pictures) > 1:
            ending += f" in {len(endings)} of {len(pictures)} scenes"
        result.wrong = tuple(filter(None, (found.convention.fault, ending)))
        made = Checked(found, [*left], result, pictures[0].steps, ending)
        result.about = [*made.diagnosis(), *made.about()]
        return made

    def so_far(result: Validation) -> None:
        if on_scene:
            on_scene(checked(result.snapshot()))

    result = validate(
        {picture.label: picture.scene for picture in pictures},
        [still],
        [REFERENCE],
        passes=("beauty",),
        settings=replace(settings, sample=found.convention.sample),
        limits=False,
        verdicts=MOST_VERDICTS if verdicts is None else verdicts,
        first=FIRST_ALIKE if verdicts is None else 0,
        on_rendered=rendered,
        progress=judging,
        on_scene=so_far,
    )
    return checked(result)


def together(results: Mapping[str, Checked]) -> Validation:
    """What came out of several programs, by name, as one: for a report."""
    first, *_ = results.values()
    found = Validation(settings=first.validation.settings)
    for name, result in results.items():
        one = result.validation
        found.comparisons += one.comparisons
        found.verdicts += one.verdicts
        found.notes += one.notes
        found.failures += one.failures
        found.wrong += tuple(f"{name}: {fault}" for fault in one.wrong)
        found.lacking |= one.lacking
        found.versions |= one.versions
        found.about = [
            *found.about,
            f"{name}: {result.says}",
            *(f"  {line.strip()}" for line in (*result.diagnosis(), *result.about())),
        ]
    return found


def read_picture(path: Path, label: str, scene: Scene) -> Picture:
    """The image of a scene.

    Raises:
        InputError: it is not one, or not of this size.
    """
    view = scene.view
    try:
        image = images.decode(path.read_bytes(), (view.columns, view.rows))
    except images.ImageError as error:
        raise InputError(f"{path}: error: {error.message}" + f"\n  hint: {error.hint}" * bool(error.hint)) from error
    except (FileNotFoundError, IsADirectoryError) as error:
        what = "this is a folder, expected an image" if path.is_dir() else "no such file"
        raise InputError(f"{path}: error: {what}") from error
    except OSError as error:
        raise InputError(f"{path}: error: {error.strerror or error}") from error
    return Picture(label, scene, image.levels, image.steps)


def read_pictures(paths: Sequence[Path], scenes: Mapping[str, Scene]) -> list[Picture]:
    """The images of scenes, in their order.

    Raises:
        InputError: with what is wrong with each.
    """
    pictures, wrong = [], []
    for path, (label, scene) in zip(paths, scenes.items(), strict=True):
        try:
            pictures.append(read_picture(path, label, scene))
        except InputError as error:
            wrong.append(str(error))
    if wrong:
        raise InputError("\n".join(wrong))
    return pictures


def draw_pictures(
    scenes: Mapping[str, Scene],
    template: str,
    settings: Settings,
    *,
    limits: Limits | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[list[Picture], list[Note]]:
    """What a program draws of every scene within those limits, and what it failed at: to draw, not to end well.

    Raises:
        TemplateError: that is no command.
    """
    program = Command(f"{PREFIX}{template}", limits)
    pictures, failures = [], []
    for label, scene in scenes.items():
        if progress:
            progress(f"{label}: {template}")
        try:
            drawn, ending, told = draw(program, label, scene, ("beauty",), settings), "", ""
        except WholeImageError as error:
            drawn, ending, told = error.image, error.ending, str(error)
        except RendererError as error:
            failures.append(Note(label, program.name, str(error)))
            continue
        steps = int(drawn.metadata["levels"])
        levels = np.rint(drawn["beauty"] * steps).astype(np.int64)
        pictures.append(Picture(label, scene, levels, steps, ending, told))
    return pictures, failures


def _left(entry: Rendered, maps: Any, convention: Convention) -> Left:
    drawn, colors = entry.renderer["beauty"], entry.reference["beauty"]
    steps = int(entry.renderer.metadata["levels"])
    levels = np.rint(drawn * steps).astype(np.int64)
    apart = np.abs(levels - convention.encoding(steps).encode(colors)).max(axis=-1)
    off, edge = maps.over, maps.edge
    # Where no level differs and yet it is over tolerance there is none: levels are compared as what they stand for.
    return Left(
        entry.label,
        off.size,
        int((off & (apart <= 1)).sum()),
        int((off & (apart > 1)).sum()),
        int((off & ~edge).sum()),
        int((off & edge).sum()),
    )
