"""Compares two renderings pass by pass: which pixels agree, which have no excuse, and which lie on an edge."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.passes import Pass, lookup
from validation import encoding, metrics
from validation.encoding import Encodings
from validation.records import Record, json_value
from validation.renderers import Settings, Uncertainty

if TYPE_CHECKING:
    from tracer import Scene
    from tracer.margins import Analysis
    from tracer.passes import Passes

Mask: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True)
class Worst:
    """A pixel (column x, row y) with the values of both renderings in its worst channel."""

    x: int
    y: int
    channel: str
    a: float
    b: float


@dataclass(frozen=True)
class Maps:
    """Pictures behind a comparison, (rows, columns): for the report, not for the record."""

    error: metrics.Array
    tolerance: metrics.Array
    compared: Mask
    edge: Mask
    over: Mask
    #: By kind of margin the pixels that are edges for it; an edge of no kind has no tolerance.
    kinds: Mapping[str, Mask] = field(default_factory=dict)


@dataclass(frozen=True)
class Comparison:
    """One pass of one scene, drawn by a renderer and by a reference.

    `max`, `rmse`, `p999` are over all compared pixels, None where nothing could be compared. `interior` and `edge`
    count compared pixels, the `_over` those of them over tolerance; an edge pixel without a finite tolerance is over
    when its error exceeds every tolerance of the interior. `ratio` is error over tolerance of the interior
    pixel that comes nearest to its tolerance, or of the largest error among those over; `tolerance` is the tolerance
    there. `worst` is that pixel when it is over, else the largest error of all.
    """

    scene: str
    size: tuple[int, int]
    renderer: str
    reference: str
    pass_name: str
    max: float | None = None
    rmse: float | None = None
    p999: float | None = None
    interior: int = 0
    interior_over: int = 0
    edge: int = 0
    edge_over: int = 0
    edge_cap: int | None = None
    tolerance: float | None = None
    ratio: float | None = None
    worst: Worst | None = None
    levels: metrics.Levels | None = None
    psnr: float | None = None
    ciede2000: metrics.ColorDifference | None = None
    flip: metrics.Flip | None = None
    reasons: tuple[str, ...] = ()
    maps: Maps | None = field(default=None, repr=False, compare=False)

    @property
    def ok(self) -> bool:
        """Whether the two agree."""
        return not self.reasons

    def _repr_html_(self) -> str:
        """For notebooks."""
        from validation.notebook import comparison_html

        return comparison_html(self)

    def record(self) -> Record:
        """The comparison as strictly valid JSON: numbers that JSON has no token for are strings."""
        entry: Record = {
            "scene": self.scene,
            "size": list(self.size),
            "renderer": self.renderer,
            "reference": self.reference,
            "pass": self.pass_name,
            "max": self.max,
            "rmse": self.rmse,
            "p999": self.p999,
            "interior": self.interior,
            "interior_over": self.interior_over,
            "edge": self.edge,
            "edge_over": self.edge_over,
            "edge_cap": self.edge_cap,
            "tolerance": self.tolerance,
            "ratio": self.ratio,
            "worst": None if self.worst is None else vars(self.worst).copy(),
            "ok": self.ok,
        }
        if self.levels is not None and self.ciede2000 is not None:
            entry["levels"] = vars(self.levels).copy()
            entry["psnr"] = self.psnr
            entry["ciede2000"] = vars(self.ciede2000).copy()
        if self.flip is not None:
            entry["flip"] = {"max": self.flip.max, "mean": self.flip.mean}
        if self.reasons:
            entry["reason"] = "; ".join(self.reasons)
        strict: Record = json_value(entry)
        return strict


def without_maps(comparison: Comparison) -> Comparison:
    """The numbers alone: pictures of many scenes take much memory."""
    flip = comparison.flip and replace(comparison.flip, map=np.zeros((0, 0)))
    return replace(comparison, maps=None, flip=flip)


#: The kinds of decisions next to which the first order says nothing of a value: it goes as a root there, or a power.
STEEP = ("silhouette", "terminator")


@dataclass(frozen=True)
class Judge:
    """What is known about a scene before any of its pixels is compared."""

    scene: Scene
    settings: Settings
    analysis: Analysis
    renderer: Uncertainty
    reference: Uncertainty
    #: How the levels of either one's `beauty` stand for colours; None: it holds colours.
    encodings: Encodings = (None, None)
    #: Whether FLIP of `beauty` is measured.
    flip: bool = False

    def edge(self, name: str) -> Mask:
        """Pixels of a pass with a decision that one of the two renderers may take either way, or without a bound."""
        edge = ~np.isfinite(self.tolerance(name))
        for mask in self.edges(name).values():
            edge |= mask
        return edge

    def edges(self, name: str) -> dict[str, Mask]:
        """By kind of margin the pixels of a pass with a decision that one of the two may take either way."""
        found: dict[str, Mask] = {}
        for kind, margin in self.analysis.behind(name).items():
            limit = np.maximum(getattr(self.renderer, kind), getattr(self.reference, kind))
            # Written so that a margin that is NaN makes an edge.
            found[kind] = np.asarray(~(margin >= limit))
        return found

    def tolerance(self, name: str) -> metrics.Array:
        """How far the two values of an interior pixel may lie apart: the sum of what either may be off by.

        Infinite where there is no such bound.
        """
        shape = self.analysis.ids.shape
        quantity = lookup(name).quantity
        if quantity in ("id", "visibility"):
            return np.zeros(shape)
        units = np.add(self.renderer.unit, self.reference.unit)
        absolute = np.add(self.renderer.absolute_of(name), self.reference.absolute_of(name))
        if quantity == "normal":
            # The sensitivity is about the angle; the length is off by four roundings, which one unit of each covers.
            absolute = absolute + units
        with np.errstate(invalid="ignore"):
            tolerance = units * self.analysis.sensitivity[name] + absolute
        behind = self.analysis.behind(name)
        for kind in STEEP:
            tolerance = np.where(behind[kind] > units, tolerance, np.inf)
        return np.broadcast_to(np.asarray(tolerance, dtype=np.float64), shape)

    def edge_cap(self) -> int:
        """The most edge pixels that geometry explains; more than that is a renderer that excuses itself.

        Every curve on which a decision changes lies in the picture of a sphere, directly or in a mirror, and so is
        enclosed by outlines and the frame of the image: `length` is the sum of both. A renderer is fit to check the
        scene if the bands in which it is uncertain, all those of one hit of the chain together, are no wider than a
        pixel: then they cover `length` pixels a hit. So does one straight curve along the grid, however thin its band.
        What a renderer claims does not enter. Never more than a quarter of the image, so that three quarters are
        always compared; of the smallest images one pixel may be an edge. Added are the areas whose light lies on a
        surface but for a rounding: that is the scene's doing.
        """
        rows, columns = self.analysis.ids.shape
        length = self.analysis.outline + 2.0 * (rows + columns)
        mirrors = any(sphere.kr > 0 for sphere in self.scene.spheres)
        hits = 1 + (self.settings.max_reflections if mirrors else 0)
        limit: int = math.ceil(min(length * hits, rows * columns / 4))
        return limit + int(self.analysis.beside.sum())


def compare_passes(
    a: Passes,
    b: Passes,
    names: Sequence[str],
    judge: Judge,
    *,
    scene: str = "",
    renderer: str = "a",
    reference: str = "b",
) -> Iterator[Comparison]:
    """Compare `a` (the renderer under test) with `b` (the reference), one Comparison a name."""
    rows, columns = judge.analysis.ids.shape
    cap = judge.edge_cap()
    hits = [
        np.asarray(side["id"] if _fits(side, "id", (rows, columns)) else judge.analysis.ids) >= 0 for side in (a, b)
    ]
    for name in names:
        blank = Comparison(scene, (columns, rows), renderer, reference, name, edge_cap=cap)
        reasons = [
            reason
            for label, side in ((renderer, a), (reference, b))
            for reason in _structure(label, side, name, (rows, columns))
        ]
        if reasons:
            yield replace(blank, reasons=tuple(reasons))
            continue
        row = lookup(name)
        tolerance, edge = judge.tolerance(name), judge.edge(name)
        compared = _compared(row, name, judge.analysis, hits)
        for label, side, hit in ((renderer, a, hits[0]), (reference, b, hits[1])):
            reasons += _values(label, side[name], row, hit)
        if (count := int(edge.sum())) > cap:
            reasons.append(
                f"too many edge pixels: {count} of {edge.size}, more than the {cap} that the lengths of the outlines "
                "explain; one of the two renderers decides too little of this scene"
            )
        maps = Maps(np.zeros(edge.shape), tolerance, compared, edge, ~compared, judge.edges(name))
        encodings = judge.encodings if name == "beauty" else (None, None)
        yield _measure(blank, a[name], b[name], row, maps, reasons, encodings=encodings, flip=judge.flip)


def compare_plain(
    a: Passes, b: Passes, name: str, tolerance: float, *, visual: bool = True, flip: bool = False, **labels: str
) -> Comparison:
    """Compare one pass without a scene: every pixel counts, equal means within `tolerance`, 0 the same values.

    `visual`: whether `beauty` holds linear colours, so that levels, PSNR and CIEDE2000 mean something; `flip`: whether
    FLIP is measured.
    """
    rows, columns = a.shape
    labels = {"scene": "", "renderer": "a", "reference": "b"} | labels
    blank = Comparison(size=(columns, rows), pass_name=name, **labels)  # type: ignore[arg-type]
    reasons = [
        reason
        for label, side in ((labels["renderer"], a), (labels["reference"], b))
        for reason in _structure(label, side, name, (rows, columns))
    ]
    if reasons:
        return replace(blank, reasons=tuple(reasons))
    for label, side in ((labels["renderer"], a), (labels["reference"], b)):
        reasons += _not_a_number(label, side[name])
    every = np.ones((rows, columns), dtype=bool)
    maps = Maps(np.zeros(every.shape), np.full(every.shape, tolerance), every, ~every, ~every)
    return _measure(blank, a[name], b[name], lookup(name), maps, reasons, visual=visual, flip=flip)


def _fits(side: Passes, name: str, shape: tuple[int, int]) -> bool:
    return name in side and side[name].shape[:2] == shape


def _structure(label: str, side: Passes, name: str, shape: tuple[int, int]) -> Iterator[str]:
    if name not in side:
        yield f"{label} did not deliver the pass '{name}'"
    elif side[name].shape[:2] != shape:
        rows, columns = side[name].shape[:2]
        yield f"{label} delivered {columns}x{rows} pixels, expected {shape[1]}x{shape[0]}"


def _compared(row: Pass, name: str, analysis: Analysis, hits: Sequence[Mask]) -> Mask:
    """Where a pass has a value to compare: hit masks come first, by `id`."""
    if row.quantity in ("id", "color"):
        return np.ones(hits[0].shape, dtype=bool)
    both: Mask = hits[0] & hits[1]
    if row.quantity == "visibility":
        lit: Mask = np.asarray(analysis.lit[int(name.removeprefix("shadow.L"))], dtype=bool)
        return both & lit
    return both


def _not_a_number(label: str, array: NDArray[Any]) -> Iterator[str]:
    if array.dtype.kind == "f" and (found := np.isnan(array)).any():
        y, x = (int(index) for index in np.argwhere(found)[0][:2])
        yield f"{label} delivered NaN, first at x {x}, y {y}"


def _values(label: str, array: NDArray[Any], row: Pass, hit: Mask) -> Iterator[str]:
    """What no value of a pass may be, compared or not."""
    yield from _not_a_number(label, array)
    planes = array if array.ndim == 3 else array[..., None]
    infinite = np.isinf(planes).any(axis=-1)
    if row.quantity == "length":
        infinite &= hit
    if infinite.any():
        y, x = (int(index) for index in np.argwhere(infinite)[0])
        yield f"{label} delivered an infinite value, first at x {x}, y {y}"
    if row.quantity == "visibility" and not np.isin(array, (0, 1)).all():
        yield f"{label} delivered a visibility that is neither 0 nor 1"
    if row.quantity in ("length", "position", "normal", "visibility"):
        wrong = ~hit & (planes != row.miss).any(axis=-1) & ~np.isnan(planes).any(axis=-1)
        if wrong.any():
            y, x = (int(index) for index in np.argwhere(wrong)[0])
            expected = f"{row.miss:g}"
            yield f"{label} delivered a value other than {expected} where its ray hits nothing, first at x {x}, y {y}"


def _measure(
    blank: Comparison,
    a: NDArray[Any],
    b: NDArray[Any],
    row: Pass,
    maps: Maps,
    reasons: list[str],
    *,
    visual: bool = True,
    encodings: Encodings = (None, None),
    flip: bool = False,
) -> Comparison:
    planes = [np.asarray(array if array.ndim == 3 else array[..., None], dtype=np.float64) for array in (a, b)]
    differences = (
        encoding.difference(planes[0], planes[1], encodings) if any(encodings) else metrics.difference(*planes)
    )
    # A value that is no number is as wrong as can be.
    differences = np.where(np.isnan(differences), np.inf, differences)
    error = differences.max(axis=-1)
    if row.quantity == "normal":
        # The chord bounds the angle from below by less than the tolerances' second order, and shows a wrong length.
        with np.errstate(invalid="ignore", over="ignore"):
            error = np.sqrt(np.square(differences).sum(axis=-1))
    compared, tolerance = maps.compared, maps.tolerance
    interior, edge = compared & ~maps.edge, compared & maps.edge
    # An edge pixel without a bound of its own is held to the largest bound of the interior; so it counts, not excused.
    unbounded = edge & ~np.isfinite(tolerance)
    over = ~(error <= np.where(unbounded, tolerance[interior].max(initial=0.0), tolerance))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = np.where(error == 0, 0.0, error / tolerance)
    ratios = np.where(interior, ratios, -1.0)
    nearest = np.unravel_index(int(ratios.argmax()), ratios.shape)
    interior_over = int((interior & over).sum())
    if interior_over:
        # Of the pixels that fail the largest error: the largest ratio is often one whose value should be 0.
        nearest = np.unravel_index(int(np.where(interior & over, error, -1.0).argmax()), error.shape)
        y, x = int(nearest[0]), int(nearest[1])
        reasons.append(
            f"{interior_over} of {int(interior.sum())} interior pixels over tolerance: "
            f"{error[y, x]:.3g} where {tolerance[y, x]:.3g} is allowed"
        )
        place = nearest
    else:
        place = np.unravel_index(int(np.where(compared, error, -1.0).argmax()), error.shape)
    y, x = int(place[0]), int(place[1])
    channel = int(differences[y, x].argmax())
    worst = None
    if compared[y, x]:
        name = row.channels[channel] if row.channels else ""
        worst = Worst(x, y, name, float(planes[0][y, x, channel]), float(planes[1][y, x, channel]))
    changes: dict[str, Any] = {
        "max": metrics.maximum(error[compared]),
        "rmse": metrics.rmse(differences[compared]),
        "p999": metrics.percentile(error[compared]),
        "interior": int(interior.sum()),
        "interior_over": interior_over,
        "edge": int(edge.sum()),
        "edge_over": int((edge & over).sum()),
        "tolerance": float(tolerance[nearest]) if interior.any() else None,
        "ratio": float(ratios[nearest]) if interior.any() else None,
        "worst": worst,
        "maps": Maps(error, tolerance, compared, maps.edge, compared & over, maps.kinds),
    }
    if row.name == "beauty" and visual:
        if any(encodings):
            a, b = encoding.shown(planes[0], planes[1], encodings)
            planes = [a / 255, b / 255]
        changes["levels"] = metrics.levels(a, b)
        changes["psnr"] = metrics.psnr(*planes)
        changes["ciede2000"] = metrics.ciede2000(a, b)
        if flip:
            changes["flip"] = metrics.flip(a, b)
    return replace(blank, reasons=tuple(reasons), **changes)
