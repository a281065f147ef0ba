"""How passes show themselves in a notebook: a small picture of each, with its range."""

from __future__ import annotations

import base64
import html
import io
from typing import TYPE_CHECKING, Any

import numpy as np

from tracer.passes import lookup, quantise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tracer.passes import Pass, Passes

#: Pixels that a picture is wide or high at most.
MOST = 240


def passes_html(passes: Passes) -> str:
    """All passes, side by side."""
    rows, columns = passes.shape
    figures = "".join(_figure(name, np.asarray(array)) for name, array in passes.items())
    renderer = html.escape(passes.metadata.get("renderer", ""))
    about = f"{columns}×{rows}, {len(passes)} pass" + "es" * (len(passes) != 1) + f" by {renderer}" * bool(renderer)
    return f'<div><p>{about}</p><div style="display:flex;flex-wrap:wrap;gap:8px">{figures}</div></div>'


def _figure(name: str, array: NDArray[Any]) -> str:
    finite = array[np.isfinite(array)]
    extent = f"{finite.min():.4g} to {finite.max():.4g}" if finite.size else "no finite value"
    picture = png(_levels(lookup(name), array))
    title = html.escape(name)
    return (
        f'<figure style="margin:0"><img src="{picture}" alt="{title}, {extent}" '
        f'style="max-width:{MOST}px;max-height:{MOST}px;image-rendering:pixelated">'
        f"<figcaption><b>{title}</b> {array.dtype}, {extent}</figcaption></figure>"
    )


def png(levels: NDArray[np.uint8]) -> str:
    """A picture as an address that holds it, no larger than it is shown."""
    from PIL import Image

    step = max(1, -(-max(levels.shape[:2]) // MOST))
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(levels[::step, ::step])).save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _levels(row: Pass, array: NDArray[Any]) -> NDArray[np.uint8]:
    """What a pass looks like: colours as they are, directions around grey, ids in turn, the rest by its range."""
    values = array.astype(np.float64)
    if row.quantity in ("color", "visibility"):
        return quantise(values)
    if row.quantity == "normal":
        return quantise(0.5 + 0.5 * values)
    if row.quantity == "id":
        # Steps of the golden ratio: neighbours are never alike; black: nothing is hit.
        return quantise(np.where(values < 0, 0, 0.25 + 0.75 * (values * 0.618034 % 1)))
    finite = np.isfinite(values)
    if not finite.any():
        return quantise(np.zeros_like(values))
    low, high = values[finite].min(), values[finite].max()
    shares = (np.where(finite, values, high) - low) / (high - low if high > low else 1)
    if row.quantity == "length":  # near is bright, what is not there black
        shares = np.where(finite, 1 - 0.9 * shares, 0)
    return quantise(shares)
