"""Proves pixels of scenes and tells what came out: which pixels, in blocks and sums, as JSON and as an image."""

from __future__ import annotations

import decimal
import json
import os
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.passes import Passes, lookup, names, write_beside
from validation import records
from validation.explain import of_light, of_sphere
from validation.explain_text import vector, wrapped
from validation.follow import KINDS, Key
from validation.processes import deferred
from validation.records import Record, json_value
from validation.run import versions
from validation.terminal import number
from validation.timing import TimeLeft
from validation.truth import NOWHERE, Ball, Prover, Tie, Truth, prove

if TYPE_CHECKING:
    from tracer import Scene
    from validation.renderers import Settings

Pixel: TypeAlias = tuple[int, int]

#: As a number of pixels: all that there are.
ALL = sys.maxsize
#: How many are proved unless told.
PROVED = 10
#: So many pixels are shown one by one.
SHOWN = 20
#: Digits of a colour: as they are printed, and as they are written.
PRINTED_DIGITS, WRITTEN_DIGITS = 30, 40
#: Columns before what is said about a pixel.
INDENT = 10
#: Other processes take a second to start: they are worth it where the rest of the pixels takes several.
TRIED, WORTH_SECONDS = 512, 3.0


def choose(scene: Scene, pixels: int, seed: int = 0) -> list[Pixel]:
    """That many different pixels (column, row), uniformly random over the image, by rows; all if it has no more."""
    columns, total = scene.view.columns, scene.view.columns * scene.view.rows
    if pixels >= total:
        return [(x, y) for y in range(scene.view.rows) for x in range(columns)]
    places = np.sort(np.random.default_rng(seed).choice(total, pixels, replace=False))
    return [(int(place) % columns, int(place) // columns) for place in places]


def proved_or_not(
    scene: Scene, pixels: Sequence[Pixel], settings: Settings | None = None, *, jobs: int | None = None
) -> Generator[Truth | None]:
    """As `proved`, with None for a pixel of which truth cannot be had."""
    done = 0
    while done < len(pixels):
        try:
            with closing(proved(scene, pixels[done:], settings, jobs=jobs)) as found:
                for truth in found:
                    done += 1
                    yield truth
        except NOWHERE:
            # The next pixel, or one soon after it: other processes take several at once.
            prover, last = Prover(scene, settings), False
            while done < len(pixels) and not last:
                try:
                    one: Truth | None = prover.pixel(*pixels[done])
                except NOWHERE:
                    one, last = None, True
                done += 1
                yield one


def proved(
    scene: Scene, pixels: Sequence[Pixel], settings: Settings | None = None, *, jobs: int | None = None
) -> Generator[Truth]:
    """Prove pixels, in their order: in this process where that is quicker, else in `jobs` (None: one a core)."""
    first, rest = pixels[:TRIED], pixels[TRIED:]
    start = time.perf_counter()
    yield from prove(scene, first, settings, jobs=1)
    if rest:
        seconds = (time.perf_counter() - start) * len(rest) / len(first)
        yield from prove(scene, rest, settings, jobs=jobs if seconds > WORTH_SECONDS else 1)


def split(ball: Ball) -> tuple[float, float]:
    """The float64 nearest to the middle of a ball, and what is left."""
    value = ball.value
    if ball.mantissa is None or value in (np.inf, -np.inf):
        return value, 0.0
    p, q = value.as_integer_ratio()
    if ball.exponent >= 0:
        return value, float((ball.mantissa << ball.exponent) * q - p)
    return value, (ball.mantissa * q - (p << -ball.exponent)) / (q << -ball.exponent)


def decimals(ball: Ball, digits: int) -> tuple[str, float]:
    """The middle of a ball as a decimal number of at most that many digits, and how far it may be from the value."""
    if ball.mantissa is None:
        return "inf", 0.0
    context = decimal.Context(prec=digits, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN)
    if ball.exponent >= 0:
        found = context.create_decimal(ball.mantissa << ball.exponent)
    else:
        found = context.divide(decimal.Decimal(ball.mantissa), decimal.Decimal(1 << -ball.exponent))
    if not context.flags[decimal.Inexact]:
        return str(found), ball.radius
    return str(found), ball.radius + float(decimal.Decimal((0, (1,), found.adjusted() - digits + 1))) / 2


def at_most(value: float) -> str:
    """Two digits, rounded up."""
    context = decimal.Context(prec=2, rounding=decimal.ROUND_UP)
    return f"{context.create_decimal_from_float(value):.2g}"


def words(key: Key, scene: Scene) -> str:
    """A decision that is a tie, as a sentence without its end."""
    ray = f"reflected ray {key.bounce}" if key.bounce else "the primary ray"
    if key.light >= 0:
        lamp = of_light(scene, key.light)
        place = f"hit {key.bounce}" if key.bounce else "the primary hit"
        ray = f"the shadow ray from {place} to {lamp}"
        if key.what in ("faces", "shines"):
            return f"{'N.L' if key.what == 'faces' else 'R.V'} = 0 at {place} for {lamp}"
    touched = of_sphere(scene, key.sphere)
    if key.what == "order":
        return f"{ray} hits {touched} and {of_sphere(scene, key.other)} at the same t"
    return {
        "meets": f"{ray} touches {touched}",
        "start": f"{ray} meets {touched} just where it begins to count",
        "ahead": f"{ray} touches {touched} just where it begins to count",
        "end": f"{ray} meets {touched} at the light",
        "at": f"{ray} has no length",
    }[key.what]


def tie_record(tie: Tie, scene: Scene) -> Record:
    """A tie for JSON."""
    return {
        "text": words(tie.key, scene),
        **tie.key._asdict(),
        "kind": KINDS[tie.key.what],
        "proved": tie.proved,
        "settled": tie.settled,
        "outcomes": tie.outcomes,
    }


def pixel_record(truth: Truth, scene: Scene) -> Record:
    """Everything about a pixel for JSON: of each channel the nearest float64 and the radius about the middle."""
    return {
        "x": truth.x,
        "y": truth.y,
        "id": truth.id,
        "bits": truth.bits,
        "beauty": [decimals(ball, WRITTEN_DIGITS)[0] for ball in truth.values["beauty"]],
        "values": {
            name: {"value": [ball.value for ball in balls], "radius": [ball.radius for ball in balls]}
            for name, balls in truth.values.items()
        },
        "ties": [tie_record(tie, scene) for tie in truth.ties],
    }


def block(truth: Truth, scene: Scene) -> Iterator[str]:
    """The lines about one pixel."""
    yield f"pixel {truth.x} {truth.y}"
    yield "  id      " + (of_sphere(scene, truth.id) if truth.id >= 0 else "-1, nothing")
    for place, (channel, ball) in enumerate(zip("RGB", truth.values["beauty"], strict=True)):
        text, error = decimals(ball, PRINTED_DIGITS)
        yield f"  {'' if place else 'beauty':<7} {channel} {text} " + (f"+/- {at_most(error)}" if error else "exactly")
    yield f"  bits    {truth.bits}"
    for tie in truth.ties:
        what = words(tie.key, scene) if tie.proved else f"{words(tie.key, scene)}, or almost"
        what += f": {tie.settled or 'the specification does not settle this'}"
        yield from (line for line, _ in wrapped("tie", what, indent=INDENT))
        if len(tie.outcomes) == 1:
            yield " " * INDENT + "makes no difference to beauty"
        for outcome in tie.outcomes if len(tie.outcomes) > 1 else ():
            yield " " * INDENT + f"beauty {vector(outcome)}" + " or" * (outcome is not tie.outcomes[-1])


@dataclass
class Summary:
    """What many pixels have in common."""

    pixels: int = 0
    hits: int = 0
    radius: dict[str, float] = field(default_factory=dict)
    bits: Counter[int] = field(default_factory=Counter)
    ties: Counter[tuple[str, bool]] = field(default_factory=Counter)
    unsettled: int = 0
    seconds: float = 0.0

    def add(self, truth: Truth) -> None:
        """Count a pixel."""
        self.pixels += 1
        self.hits += truth.id >= 0
        self.bits[truth.bits] += 1
        for name, balls in truth.values.items():
            self.radius[name] = max(self.radius.get(name, 0.0), *(ball.radius for ball in balls))
        self.ties.update((KINDS[tie.key.what], bool(tie.settled)) for tie in truth.ties)
        self.unsettled += any(not tie.settled for tie in truth.ties)

    @property
    def speed(self) -> float:
        """Pixels a second of one core."""
        return self.pixels / self.seconds if self.seconds else 0.0

    def record(self) -> Record:
        """The same for JSON."""
        return {
            "pixels": self.pixels,
            "hits": self.hits,
            "radius": self.radius,
            "bits": {str(bits): count for bits, count in sorted(self.bits.items())},
            "ties": [
                {"kind": kind, "settled": settled, "count": count}
                for (kind, settled), count in sorted(self.ties.items())
            ],
            "unsettled": self.unsettled,
            "seconds": self.seconds,
        }

    def lines(self) -> Iterator[str]:
        """To print."""
        yield f"  proved         {self.pixels} pixels: {self.hits} hit, {self.pixels - self.hits} background"
        largest = max(self.radius.values(), default=0.0)
        yield f"  largest radius {number(self.radius.get('beauty'))} (beauty), {number(largest)} (any pass)"
        yield "  bits           " + ", ".join(f"{bits}: {count}" for bits, count in sorted(self.bits.items()))
        ties = [
            f"{kind} {count} ({'settled' if settled else 'not settled'})"
            for (kind, settled), count in sorted(self.ties.items())
        ]
        yield "  ties           " + (", ".join(ties) or "none")
        yield f"  speed          {self.speed:.0f} pixels a second a core"


class Image:
    """Proved pixels, rounded to the nearest float64, as passes."""

    def __init__(self, scene: Scene, settings: Settings) -> None:
        """Blank, every pass of the scene."""
        shape = scene.view.rows, scene.view.columns
        self.arrays: dict[str, NDArray[Any]] = {}
        for name in names(len(scene.lights), settings.max_reflections, margins=False):
            row = lookup(name)
            kind: type[Any] = np.int32 if row.quantity == "id" else np.float64
            self.arrays[name] = np.zeros((*shape, len(row.channels)) if row.channels else shape, kind)

    def add(self, truth: Truth) -> None:
        """Fill in a pixel."""
        for name, balls in truth.values.items():
            values = [ball.value for ball in balls]
            self.arrays[name][truth.y, truth.x] = values if lookup(name).channels else values[0]


@dataclass
class Told:
    """What `tell` has told: lines to print, how many pixels are proved of how many, and the files that are written."""

    asked: int
    lines: list[str] = field(default_factory=list)
    proved: int = 0
    files: list[Path] = field(default_factory=list)
    interrupted: bool = False

    @property
    def progress(self) -> str:
        """How far it went."""
        return f"{self.proved} of {self.asked} pixels"


def tell(
    scenes: Mapping[str, Scene],
    pixels: int | Sequence[Pixel],
    settings: Settings,
    *,
    seed: int = 0,
    jobs: int | None = None,
    json_file: Path | None = None,
    output: Path | None = None,
    command: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
) -> Told:
    """Prove pixels of scenes, that many random ones or those named, and tell what they are.

    `output` takes the image of the one scene. Ctrl-C ends it with what there is, but for the image, which would lack
    some.

    Raises:
        truth.UnprovedError: a pixel that could not be proved.
        OSError: a file cannot be written.
    """
    sizes = [scene.view.columns * scene.view.rows for scene in scenes.values()]
    counts = [min(pixels, size) if isinstance(pixels, int) else len(pixels) for size in sizes]
    told, by = Told(sum(counts)), versions(())
    with ExitStack() as stack:
        file = None
        if json_file:
            # A line a pixel, as they come: whole images do not have to fit into the memory.
            file = stack.enter_context(stack.enter_context(write_beside(json_file)).open("w", encoding="utf-8"))
            told.files.append(json_file)

        def write(text: str) -> None:
            if file:
                file.write(text)

        fields = {"command": list(command), "settings": vars(settings).copy(), "versions": by, "seed": seed}
        write(_json(records.result("truth", fields)).removesuffix("}") + ',\n"scenes": [')
        for place, (label, scene) in enumerate(scenes.items()):
            at = choose(scene, pixels, seed) if isinstance(pixels, int) else pixels
            image = Image(scene, settings) if output else None
            opening = _json({"scene": label, "size": [scene.view.columns, scene.view.rows]}).removesuffix("}")
            write("," * bool(place) + f'\n{opening}, "pixels": [')
            start, left = _busy(), TimeLeft(len(at))
            with closing(proved(scene, at, settings, jobs=jobs)) as found:
                shown = _shown(found, progress, label, len(at), left)
                summary = _tell_scene(told, label, scene, at, shown, image, write if file else None)
            summary.seconds = _busy() - start
            if len(at) > SHOWN:
                told.lines += summary.lines()
            write(f'],\n"summary": {_json(summary.record())}}}')
            if told.interrupted:
                break
            if image and output:
                metadata = {"renderer": "truth", "scene": scene.text(), "command": shlex.join(command)}
                metadata |= {f"version of {key}": value for key, value in by.items()}
                Passes(image.arrays, metadata).save(output)
                told.files.append(output)
        write(f'],\n"interrupted": {_json(told.interrupted)}}}\n')
    return told


def _shown(
    found: Iterable[Truth], progress: Callable[[str], None] | None, label: str, count: int, left: TimeLeft
) -> Iterator[Truth]:
    """The same, with progress."""
    for place, truth in enumerate(found):
        if progress and place % 100 == 0:
            progress(f"{label}: {place} of {count} pixels proved{left.says(place)}")
        yield truth


def _tell_scene(
    told: Told,
    label: str,
    scene: Scene,
    at: Sequence[Pixel],
    found: Iterable[Truth],
    image: Image | None,
    write: Callable[[str], None] | None,
) -> Summary:
    """The pixels of one scene, as they come."""
    summary, columns, rows = Summary(), scene.view.columns, scene.view.rows
    told.lines.append(f"{label} {columns}x{rows}" + ", every pixel" * (len(at) == columns * rows))
    try:
        for truth in found:
            # A pixel is told as a whole, or not at all.
            with deferred():
                if write:
                    write("," * bool(summary.pixels) + "\n" + _json(pixel_record(truth, scene)))
                summary.add(truth)
                told.proved += 1
                if image:
                    image.add(truth)
                if len(at) <= SHOWN:
                    told.lines += block(truth, scene)
    except KeyboardInterrupt:
        if not told.proved:
            raise
        told.interrupted = True
    return summary


def _json(value: Any) -> str:
    return json.dumps(json_value(value), allow_nan=False)


def _busy() -> float:
    """Seconds of processor time of this process and those that it has waited for."""
    return time.process_time() + sum(os.times()[2:4])
