"""How a comparison shows itself in a notebook: what came out, the numbers, and the map of the errors."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

from validation.terminal import number, worst_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from validation.compare import Comparison

#: Notebooks would set numbers to the right.
LEFT = 'style="text-align:left"'


def comparison_html(comparison: Comparison) -> str:
    """A table, and where the maps are still there the errors on a logarithmic scale."""
    rows = "".join(
        f"<tr><th {LEFT}>{html.escape(name)}</th><td {LEFT}>{html.escape(text)}</td></tr>"
        for name, text in _rows(comparison)
    )
    return f"<div><table>{rows}</table>{_picture(comparison)}</div>"


def _rows(comparison: Comparison) -> Iterator[tuple[str, str]]:
    columns, lines = comparison.size
    scene = f"{comparison.scene} " * bool(comparison.scene)
    yield comparison.pass_name, f"{scene}{columns}×{lines}: {comparison.renderer} against {comparison.reference}"
    yield "result", "✓ agree" if comparison.ok else f"✗ DIFFER: {'; '.join(comparison.reasons)}"
    if comparison.max is None:
        return
    yield "max error", number(comparison.max)
    yield "RMSE", number(comparison.rmse)
    yield "p99.9", number(comparison.p999)
    yield "interior", f"{comparison.interior_over} of {comparison.interior} pixels over tolerance"
    if comparison.edge:
        yield "edge", f"{comparison.edge_over} of {comparison.edge} pixels over tolerance"
    if comparison.ratio is not None:
        yield "error/tolerance", number(comparison.ratio)
    if comparison.worst:
        yield "worst pixel", worst_of(comparison).removeprefix("; worst pixel ")
    if comparison.psnr is not None and comparison.ciede2000:
        yield "PSNR", f"{comparison.psnr:.1f} dB"
        yield "CIEDE2000", f"up to {number(comparison.ciede2000.max)}, mean {number(comparison.ciede2000.mean)}"
    if comparison.flip:
        yield "FLIP", f"up to {number(comparison.flip.max)}, mean {number(comparison.flip.mean)}"


def _picture(comparison: Comparison) -> str:
    from validation.report import pictures

    maps = comparison.maps
    heatmap = pictures.heatmap(maps.error, maps.compared, maps.edge) if maps else None
    if heatmap is None:
        return ""
    ticks = ", ".join(text for _, text in heatmap.ticks)
    alt = html.escape(f"errors of {comparison.pass_name}, up to {number(comparison.max)}")
    return (
        f'<figure style="margin:0"><img src="{heatmap.picture.uri}" alt="{alt}" '
        f'style="min-width:{min(400, 4 * heatmap.picture.columns)}px;image-rendering:pixelated">'
        f"<figcaption>error, dark to bright: {html.escape(ticks)}</figcaption></figure>"
    )
