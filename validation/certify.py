"""Certifies renderers: holds single pixels of what they draw against the proved values of the specification."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from flint import arb, ctx, fmpq
from numpy.typing import NDArray

from tracer.margins import EDGE_ROUNDINGS
from tracer.passes import Passes, lookup, names
from validation import metrics, records, renderers
from validation.compare import Judge, Mask
from validation.proofs import Pixel, choose, proved_or_not, split
from validation.records import Record, json_value
from validation.renderers import Renderer, Settings, Uncertainty
from validation.renderers.floats import UNIT_ROUNDOFF, FloatRenderer
from validation.run import (
    ANALYSIS_MAX_PIXELS,
    Note,
    Outcome,
    RendererError,
    analyse,
    blaming,
    draw,
    explain_command,
    resized,
    shrink,
    versions,
    why_not,
)
from validation.terminal import (
    NARROW,
    TOO_MANY,
    colorful,
    console,
    counted,
    fits,
    number,
    paths,
    print_failures,
    print_notes,
    room_for_names,
)
from validation.timing import TimeLeft
from validation.truth import BITS, UnprovedError

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from validation.truth import Truth

Array = NDArray[np.float64]

#: How many random pixels, and how many of the smallest margins, unless told.
PIXELS, EDGES = 2000, 500
#: The other side of every comparison here: it is not off.
PROVED = Uncertainty(0.0, 0.0, 0.0, 0.0, 0.0)
#: So many wrong pixels are told.
TOLD = 10


@dataclass(frozen=True)
class Proof:
    """Proved pixels of a scene, N of them.

    The exact value of a channel is within `radius` of `value` + `rest`, by pass (N, channels) each.
    """

    scene: Scene
    settings: Settings
    analysis: Analysis
    x: NDArray[np.intp]
    y: NDArray[np.intp]
    random: Mask  # chosen at random
    edge: Mask  # chosen as one of the smallest margins of the image
    unsettled: Mask  # the specification leaves a tie open
    value: dict[str, Array]
    rest: dict[str, Array]
    radius: dict[str, Array]
    lit: list[Mask]  # by light: N.L > 0
    unproved: tuple[Pixel, ...] = ()  # of which truth cannot be had; not among the N


def hardest(analysis: Analysis, count: int) -> list[Pixel]:
    """The pixels (column, row) of the smallest margins, those with a margin at all."""
    margin = np.minimum.reduce(list(analysis.margins.values())).ravel()
    margin = np.where(np.isnan(margin), 0.0, margin)
    places = np.flatnonzero(np.isfinite(margin))
    columns = analysis.ids.shape[1]
    chosen = places[np.argsort(margin[places], kind="stable")[:count]]
    return [(int(place) % columns, int(place) // columns) for place in chosen]


def prove_scene(
    scene: Scene,
    settings: Settings | None = None,
    *,
    pixels: int = PIXELS,
    edges: int = EDGES,
    seed: int = 0,
    jobs: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Proof:
    """Prove random pixels of a scene, and those of the smallest margins.

    Raises:
        truth.UnprovedError: no pixel could be proved.
    """
    settings = settings or Settings()
    analysis = analyse(scene, settings)
    random, edge = choose(scene, pixels, seed), hardest(analysis, edges)
    every = sorted({*random, *edge}, key=lambda pixel: pixel[::-1])
    fields = [
        (name, max(1, len(lookup(name).channels)))
        for name in names(len(scene.lights), settings.max_reflections, margins=False)
    ]
    value, rest, radius = ({name: np.zeros((len(every), channels)) for name, channels in fields} for _ in range(3))
    lit = [np.zeros(len(every), bool) for _ in scene.lights]
    unsettled = np.zeros(len(every), bool)
    had = np.ones(len(every), bool)
    left = TimeLeft(len(every))
    with closing(proved_or_not(scene, every, settings, jobs=jobs)) as found:
        for place, truth in enumerate(found):
            if progress and place % 100 == 0:
                progress(f"{place} of {len(every)} pixels proved{left.says(place)}")
            if truth is None:
                had[place] = False
                continue
            for name, balls in truth.values.items():
                for channel, ball in enumerate(balls):
                    value[name][place, channel], rest[name][place, channel] = split(ball)
                    radius[name][place, channel] = ball.radius
            unsettled[place] = any(not tie.settled for tie in truth.ties)
            if truth.id >= 0:
                for light, mask in zip(scene.lights, lit, strict=True):
                    mask[place] = faces(truth, light.position)
    if not had.any():
        raise UnprovedError("no pixel could be proved")
    x, y = (np.array([pixel[k] for pixel in every], dtype=np.intp)[had] for k in (0, 1))
    chosen_random, chosen_edge = (
        np.array([p in chosen for p in every], bool)[had] for chosen in (set(random), set(edge))
    )
    value, rest, radius = ({name: array[had] for name, array in of.items()} for of in (value, rest, radius))
    return Proof(
        scene,
        settings,
        analysis,
        x,
        y,
        chosen_random,
        chosen_edge,
        unsettled[had],
        value,
        rest,
        radius,
        [mask[had] for mask in lit],
        tuple(pixel for pixel, proven in zip(every, had, strict=True) if not proven),
    )


def faces(truth: Truth, light: Iterable[float | fmpq]) -> bool:
    """Whether N.L > 0 where a pixel's ray hits, of a light in that place; where it is 0, and its ball holds 0, not."""
    terms = zip(truth.values["normal"], truth.values["position"], light, strict=True)
    with ctx.workprec(4 * BITS):
        return bool(sum((n.arb() * (arb(p) - x.arb()) for n, x, p in terms), arb(0)) > 0)


@dataclass(frozen=True)
class Miss:
    """A pixel (column x, row y) of a pass in its worst channel: what was drawn, what is right.

    `margin`: the smallest of the decisions behind the pass; `claim`: that over the renderer's uncertainty, so that from
    1 on there is no excuse.
    """

    x: int
    y: int
    pass_name: str
    channel: str
    drawn: float
    exact: float
    error: float
    tolerance: float
    margin: float
    claim: float


@dataclass(frozen=True)
class PassCertificate:
    """One pass of the proved pixels.

    Pixels whose margins are above the renderer's uncertainty are `interior`; the `_over` are those over tolerance.
    `error` is the largest of all pixels, `ratio` the largest error over tolerance of interior ones.
    """

    pass_name: str
    interior: int
    interior_over: int
    edge: int
    edge_over: int
    error: float
    interior_error: float
    ratio: float


@dataclass(frozen=True)
class Certificate:
    """What the proved pixels of a scene say about a renderer.

    `random` and `edge` count pixels, which may be the same; `exempt` those among both that the specification leaves
    open; of the `unproved` truth could not be had, and they are in no other number. `wrong` counts pixels with a
    decision, or a value beyond its tolerance, other than proved; `wrong_margin` is the largest margin of these,
    `wrong_claim` the largest over the renderer's uncertainty; both None where nothing is wrong. `unit` is
    the unit roundoff of a renderer that keeps to the specification in floating point, else None.
    `edge_pixels`: of the pass that has most of them, the pixels of the whole image that may be decided either way;
    `edge_cap`: how many may be. `explain`: the command that explains the worst pixel, "" where none is wrong.
    """

    scene: str
    size: tuple[int, int]
    renderer: str
    seed: int
    random: int
    edge: int
    proved: int
    exempt: int
    passes: tuple[PassCertificate, ...]
    missing: tuple[str, ...]
    wrong: int
    wrong_margin: float | None
    wrong_claim: float | None
    unit: float | None
    edge_pixels: int
    edge_cap: int
    unproved: tuple[Pixel, ...]
    explain: str
    misses: tuple[Miss, ...] = field(repr=False)

    @property
    def ratio(self) -> float:
        """The largest error over tolerance of interior pixels."""
        return max((entry.ratio for entry in self.passes), default=0.0)

    @property
    def error(self) -> float | None:
        """The largest error of `beauty` over all pixels."""
        return next((entry.error for entry in self.passes if entry.pass_name == "beauty"), None)

    @property
    def over(self) -> int:
        """Interior pixels over tolerance, in any pass; those of several count several times."""
        return sum(entry.interior_over for entry in self.passes)

    @property
    def too_many_edges(self) -> bool:
        """Whether it claims to tell so little that its edges are no excuse; as in a comparison."""
        return self.edge_pixels > self.edge_cap

    @property
    def ok(self) -> bool:
        """Whether the renderer holds what it claims, and claims enough."""
        return not self.over and not self.too_many_edges and (self.wrong_claim is None or self.wrong_claim < 1)

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        entry = {
            "scene": self.scene,
            "size": self.size,
            "renderer": self.renderer,
            "ok": self.ok,
            "seed": self.seed,
            "random": self.random,
            "edge": self.edge,
            "proved": self.proved,
            "exempt": self.exempt,
            "ratio": self.ratio,
            "error": self.error,
            "over": self.over,
            "wrong": self.wrong,
            "wrong_margin": self.wrong_margin,
            "wrong_claim": self.wrong_claim,
            "unit": self.unit,
            "edge_pixels": self.edge_pixels,
            "edge_cap": self.edge_cap,
            "unproved": self.unproved,
            "explain": self.explain,
            "passes": [_named(vars(entry)) for entry in self.passes],
            "missing": self.missing,
            "misses": [_named(vars(miss)) for miss in self.misses],
        }
        strict: Record = json_value(entry)
        return strict


def _named(entry: Mapping[str, Any]) -> Record:
    return {"pass" if name == "pass_name" else name: value for name, value in entry.items()}


def certify(
    scene: Scene,
    renderer: str | Renderer,
    settings: Settings | None = None,
    *,
    pixels: int = PIXELS,
    edges: int = EDGES,
    seed: int = 0,
    jobs: int | None = None,
    proof: Proof | None = None,
    label: str = "",
) -> Certificate:
    """Hold random pixels of a renderer, and those of the smallest margins, against their proved values.

    `proof`: such pixels that were proved before, with the scene and the settings they belong to.

    Raises:
        InputError: the scene is not one that the renderer can be asked to draw.
        RendererError: it failed.
        renderers.UnknownRendererError: no renderer has that name.
        truth.UnprovedError: no pixel could be proved.
    """
    if isinstance(renderer, str):
        renderer = renderers.get(renderer)
    if proof is None:
        proof = prove_scene(scene, settings, pixels=pixels, edges=edges, seed=seed, jobs=jobs)
    scene, settings = proof.scene, proof.settings
    with blaming():
        delivers = tuple(renderer.passes(scene, settings))
    wanted = [name for name in proof.value if name in delivers]
    drawn = draw(renderer, label, scene, wanted, settings)
    with blaming():
        judge = Judge(scene, settings, proof.analysis, renderer.uncertainty(scene, settings, proof.analysis), PROVED)
    return hold(drawn, renderer, proof, judge, wanted, seed=seed, label=label)


def hold(
    drawn: Passes, renderer: Renderer, proof: Proof, judge: Judge, wanted: Sequence[str], *, seed: int, label: str
) -> Certificate:
    """Hold what a renderer has drawn against proved pixels.

    Raises:
        RendererError: it drew something else than asked for.
    """
    rows, columns = proof.analysis.ids.shape
    for name in wanted:
        if name not in drawn:
            raise RendererError(f"did not deliver the pass '{name}'")
        if drawn[name].shape[:2] != (rows, columns):
            found = f"{drawn[name].shape[1]}x{drawn[name].shape[0]}"
            raise RendererError(f"delivered {found} pixels, expected {columns}x{rows}")
    at = proof.y, proof.x
    counted = ~proof.unsettled
    right = proof.value["id"][:, 0]
    seen = np.asarray(drawn["id"])[at] if "id" in wanted else right
    same = (seen >= 0) == (right >= 0)
    passes: list[PassCertificate] = []
    misses: list[Miss] = []
    wrong = np.zeros(len(counted), bool)
    edge_pixels = 0
    for name in wanted:
        row = lookup(name)
        compared = counted.copy()
        if row.quantity not in ("id", "color"):
            compared &= same
        if row.quantity == "visibility":
            compared &= proof.lit[int(name.removeprefix("shadow.L"))]
        values = np.asarray(drawn[name][at], dtype=np.float64).reshape(len(counted), -1)
        differences = errors(values, proof, name)
        error = differences.max(axis=-1)
        if row.quantity == "normal":
            error = np.sqrt(np.square(differences).sum(axis=-1))
        edges = judge.edge(name)
        edge_pixels = max(edge_pixels, int(edges.sum()))
        edge = edges[at]
        tolerance = bound(judge, name)[at]
        over = compared & ~(error <= tolerance)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ratio = np.where(error == 0, 0.0, error / tolerance)
        interior = compared & ~edge
        passes.append(
            PassCertificate(
                name,
                int(interior.sum()),
                int((interior & over).sum()),
                int((compared & edge).sum()),
                int((compared & edge & over).sum()),
                metrics.maximum(error[compared]),
                metrics.maximum(error[interior]),
                metrics.maximum(ratio[interior]),
            )
        )
        wrong |= over
        margin, claim = margins(judge, name, at)
        for place in np.flatnonzero(over):
            channel = int(differences[place].argmax())
            misses.append(
                Miss(
                    int(proof.x[place]),
                    int(proof.y[place]),
                    name,
                    row.channels[channel] if row.channels else "",
                    float(values[place, channel]),
                    float(proof.value[name][place, channel]),
                    float(error[place]),
                    float(tolerance[place]),
                    float(margin[place]),
                    float(claim[place]),
                )
            )
    # Of a pixel that pass whose decisions have the least excuse.
    misses.sort(key=lambda miss: (-miss.claim, miss.y, miss.x))
    worst = [(miss.x, miss.y) for miss in misses[:1]]
    told: dict[Pixel, Miss] = {}
    for miss in misses:
        told.setdefault((miss.x, miss.y), miss)
    return Certificate(
        label,
        (columns, rows),
        renderer.name,
        seed,
        int(proof.random.sum()),
        int(proof.edge.sum()),
        len(counted),
        int(proof.unsettled.sum()),
        tuple(passes),
        tuple(name for name in proof.value if name not in wanted),
        int(wrong.sum()),
        max((miss.margin for miss in misses), default=None),
        max((miss.claim for miss in misses), default=None),
        UNIT_ROUNDOFF[renderer.precision] if isinstance(renderer, FloatRenderer) else None,
        edge_pixels,
        judge.edge_cap(),
        proof.unproved,
        "".join(explain_command(label, proof.scene, proof.settings, x, y, [renderer.name]) for x, y in worst),
        tuple(told.values())[:TOLD],
    )


def bound(judge: Judge, name: str) -> Array:
    """The tolerance of every pixel of the image.

    That of an edge pixel is the largest of its own and its neighbours': whichever way it is decided, the error of that
    side counts. Where none of them has a bound, it is the largest of the interior.
    """
    tolerance, edge = judge.tolerance(name), judge.edge(name)
    rows, columns = tolerance.shape
    framed = np.pad(np.where(np.isfinite(tolerance), tolerance, -1.0), 1, constant_values=-1.0)
    around = np.maximum.reduce([framed[y : y + rows, x : x + columns] for y in range(3) for x in range(3)])
    largest = tolerance[~edge].max(initial=0.0)
    return np.where(edge, np.where(around < 0, largest, around), tolerance)


def errors(values: Array, proof: Proof, name: str) -> Array:
    """Upper bounds of |drawn - exact| by channel: infinite for what is no number."""
    difference = metrics.difference(values, proof.value[name])
    finite = np.isfinite(values) & np.isfinite(proof.value[name])
    with np.errstate(invalid="ignore", over="ignore"):
        # The first difference is exact where it matters, near the value; two roundings otherwise.
        exact = np.abs((values - proof.value[name]) - proof.rest[name]) * (1 + 2.0**-51) + proof.radius[name]
    settled = finite & ((values != proof.value[name]) | (proof.rest[name] != 0) | (proof.radius[name] != 0))
    found = np.where(settled, exact, difference)
    return np.where(np.isnan(found), np.inf, found)


def margins(judge: Judge, name: str, at: tuple[NDArray[np.intp], NDArray[np.intp]]) -> tuple[Array, Array]:
    """Of pixels: the smallest margin behind a pass, and the smallest margin over the renderer's uncertainty."""
    behind = {kind: margin[at] for kind, margin in judge.analysis.behind(name).items()}
    margin, claim = (np.full(len(at[0]), math.inf) for _ in range(2))
    for kind, found in behind.items():
        found = np.where(np.isnan(found), 0.0, found)
        limit = np.asarray(getattr(judge.renderer, kind))
        limit = limit[at] if limit.ndim else limit
        with np.errstate(divide="ignore", invalid="ignore"):
            over = np.where(found >= limit, np.fmax(found / limit, 1.0), found / limit)
        margin, claim = np.minimum(margin, found), np.minimum(claim, np.where(limit == 0, math.inf, over))
    return margin, claim


# ---- several scenes and renderers


@dataclass(kw_only=True)
class Certification(Outcome):
    """What `certify_scenes` found."""

    pixels: int
    edges: int
    seed: int
    certificates: list[Certificate] = field(default_factory=list)
    #: Whether Ctrl-C ended it: then some certificates are missing.
    asked: int = 0
    interrupted: bool = False

    @property
    def progress(self) -> str:
        """How far it went."""
        return f"{len(self.certificates)} of {self.asked} certificates"

    @property
    def status(self) -> int:
        """The exit status: 0 all hold what they claim, 1 some do not, 2 a scene is wrong, 3 a renderer failed or
        nothing could be certified.
        """
        if trouble := self.trouble(anything=bool(self.certificates)):
            return trouble
        return 0 if all(certificate.ok for certificate in self.certificates) else 1

    def record(self) -> Record:
        """Everything as strictly valid JSON."""
        return records.result(
            "certify",
            {
                "ok": self.status == 0 and not self.interrupted,
                "interrupted": self.interrupted,
                "command": list(self.command),
                "settings": vars(self.settings).copy(),
                "versions": self.versions,
                "pixels": self.pixels,
                "edges": self.edges,
                "seed": self.seed,
                "certificates": [certificate.record() for certificate in self.certificates],
                "notes": [vars(note).copy() for note in self.notes],
                "failures": [vars(note).copy() for note in self.failures],
            },
        )


def certify_scenes(
    scenes: Mapping[str, Scene],
    tested: Iterable[str | Renderer],
    settings: Settings | None = None,
    *,
    pixels: int = PIXELS,
    edges: int = EDGES,
    seed: int = 0,
    jobs: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Certification:
    """Certify every renderer on every scene; what is proved once serves all of them. Ctrl-C ends it with what there is.

    Raises:
        renderers.UnknownRendererError: no renderer has that name.
    """
    settings = settings or Settings()
    programs = [renderers.get(entry) if isinstance(entry, str) else entry for entry in tested]
    programs = list(dict.fromkeys(programs))
    result = Certification(settings=settings, pixels=pixels, edges=edges, seed=seed, versions=versions(programs))
    usable = result.usable(programs)
    result.asked = len(scenes) * len(usable)
    try:
        _certify_each(result, scenes, usable, jobs, progress)
    except KeyboardInterrupt:
        if not result.certificates:
            raise
        result.interrupted = True
    return result


def _certify_each(
    result: Certification,
    scenes: Mapping[str, Scene],
    usable: Sequence[Renderer],
    jobs: int | None,
    progress: Callable[[str], None] | None,
) -> None:
    settings, counts = result.settings, {"pixels": result.pixels, "edges": result.edges, "seed": result.seed}
    for place, (label, scene) in enumerate(scenes.items()):
        proofs: dict[tuple[int, int], Proof] = {}
        count = f"scene {place + 1} of {len(scenes)}: " * (len(scenes) > 1)
        say = functools.partial(_say, progress, f"{count}{label}")
        for program in usable:
            try:
                with result.trying(label, program):
                    with blaming():
                        at_size = _sized(result, label, scene, program)
                    if at_size is None:
                        continue
                    size = at_size.view.columns, at_size.view.rows
                    if size not in proofs:
                        say("finding the pixels of the smallest margins")
                        proofs[size] = prove_scene(at_size, settings, **counts, jobs=jobs, progress=say)
                    say(program.name)
                    result.certificates.append(
                        certify(at_size, program, settings, seed=result.seed, proof=proofs[size], label=label)
                    )
            except UnprovedError as error:
                result.fail(Note(label, "", str(error)))
                break  # nor for the other renderers


def _say(progress: Callable[[str], None] | None, label: str, what: str) -> None:
    if progress:
        progress(f"{label}: {what}")


def _sized(result: Certification, label: str, scene: Scene, program: Renderer) -> Scene | None:
    """The scene at the largest size that a renderer draws in time; None, and a note, where it cannot carry it."""
    settings = result.settings
    delivers = tuple(program.passes(scene, settings))
    if not delivers:
        why = f" ({why_not(program, scene)})".removesuffix(" ()")
        result.notes.append(Note(label, program.name, f"cannot carry this scene{why}: not certified"))
        return None
    columns, rows = scene.view.columns, scene.view.rows
    most = program.max_pixels(scene, delivers)
    small = shrink(columns, rows, ANALYSIS_MAX_PIXELS if most is None else min(most, ANALYSIS_MAX_PIXELS))
    if small != (columns, rows):
        message = f"certified at {small[0]}x{small[1]} instead of {columns}x{rows}: that would take too long"
        result.notes.append(Note(label, program.name, message))
    return resized(scene, small)


# ---- printed


def print_certification(result: Certification) -> None:
    """A table for each renderer, the wrong pixels of those that do not hold, and the sum."""
    from rich.table import Table
    from rich.text import Text

    out = console()
    for renderer in dict.fromkeys(certificate.renderer for certificate in result.certificates):
        group = [certificate for certificate in result.certificates if certificate.renderer == renderer]
        out.print(f"{renderer} against proved values", style="bold", markup=False)
        names = [f"{entry.scene} {entry.size[0]}x{entry.size[1]}" for entry in group]
        columns = {
            "random": [str(entry.random) for entry in group],
            "edge": [str(entry.edge) for entry in group],
            "/tolerance": [number(entry.ratio) for entry in group],
            "max error": [number(entry.error) for entry in group],
            "wrong": [str(entry.wrong) for entry in group],
            "at margin": [_margin(entry) for entry in group],
        }
        if out.width < NARROW:  # these were asked for
            del columns["random"], columns["edge"]
        room = room_for_names(out.width, [["result"], *([name, *of] for name, of in columns.items())])
        shown = paths(names, room)
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column("scene", overflow="fold", no_wrap=fits(shown, room))
        table.add_column("result", no_wrap=True)
        for header in columns:
            table.add_column(header, justify="right", no_wrap=True)
        for place, (name, entry) in enumerate(zip(names, group, strict=True)):
            holds = Text("holds", style="green") if entry.ok else Text("WRONG", style="bold red")
            table.add_row(shown[name], holds, *(texts[place] for texts in columns.values()))
        out.print(table)
        out.print()
    for entry in result.certificates:
        if not entry.ok:
            told = [_told(entry, miss) for miss in entry.misses]
            if entry.too_many_edges:
                told.append(_too_many(entry))
            for line in told:
                click.secho(line, fg="red", color=colorful())
            if entry.explain:
                click.echo(f"  hint: {entry.explain}")
    for entry in result.certificates:
        for text in _left_out(entry):
            click.echo(f"note: {entry.scene}: {entry.renderer}: {text}")
    print_notes(result)
    if result.certificates:
        click.echo("/tolerance: error over tolerance where all margins are above the renderer's uncertainty")
        click.echo("max error: of beauty, everywhere; wrong: pixels with a decision or a value other than proved")
        click.echo("at margin: the largest margin of a wrong pixel, in roundings u or in uncertainties of the renderer")
    if any(entry.ok and entry.wrong for entry in result.certificates):
        click.echo(
            f"holds though some are wrong: their decisions are nearer, below {EDGE_ROUNDINGS} u or 1 uncertainty, than "
            "it claims to tell"
        )
    print_failures(result)
    good, every, many = sum(entry.ok for entry in result.certificates), len(result.certificates), len(result.failures)
    total = f"{good} of {every} certificates hold" if every else "nothing was certified"
    click.echo(total + (f", {counted(many, 'failure')}" if many else ""))


def _left_out(entry: Certificate) -> Iterator[str]:
    """What was not held against the truth."""
    if entry.exempt:
        yield f"left out {counted(entry.exempt, 'pixel')} that nothing settles"
    if entry.unproved:
        count, (x, y) = len(entry.unproved), entry.unproved[0]
        yield f"{counted(count, 'pixel')} could not be proved, for example {x} {y}"
    if entry.missing:
        yield f"it lacks {', '.join(entry.missing)}"


def _too_many(entry: Certificate) -> str:
    columns, rows = entry.size
    return (
        f"{entry.scene} ({entry.renderer}): {TOO_MANY}: {entry.edge_pixels} of {columns * rows}, more than the "
        f"{entry.edge_cap} that the lengths of the outlines explain; it decides too little of this scene"
    )


def _margin(entry: Certificate) -> str:
    if entry.wrong_margin is None or entry.wrong_claim is None:
        return "-"
    return number(entry.wrong_claim) if entry.unit is None else f"{number(entry.wrong_margin / entry.unit)} u"


def _told(entry: Certificate, miss: Miss) -> str:
    margin = f"{number(miss.claim)} uncertainties" if entry.unit is None else f"{number(miss.margin / entry.unit)} u"
    channel = f" {miss.channel}" if miss.channel else ""
    return (
        f"{entry.scene}: {miss.pass_name} ({entry.renderer}): pixel x {miss.x}, y {miss.y}{channel}: "
        f"{miss.drawn!r}, exact is {miss.exact!r}: off by {miss.error:.3g} where {miss.tolerance:.3g} is allowed; "
        f"margin {margin}"
    )
