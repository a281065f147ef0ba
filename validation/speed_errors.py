"""How far pictures are from what is proved, for `whitted speed`: errors of colours, decisions, and levels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.passes import quantise
from validation.certify import Proof, errors


@dataclass(frozen=True)
class Errors:
    """What the proved pixels say about a picture.

    `random_*`: of pixels chosen at random; `edge_*`: of those with the smallest margins. `max` and `rmse` are of the
    channels of `beauty`, over all channels of all these pixels. `random_spread`: the standard error of `random_rmse`,
    by how much other random pixels would change it. `wrong`: of all proved pixels those whose primary hit
    is another sphere, or a light is seen that is hidden there or the other way round; None: the picture does not tell.
    None where there is no such pixel.
    `levels_off`: random pixels with a channel whose byte is another, by at most `levels_max`.
    """

    random: int
    random_max: float | None
    random_rmse: float | None
    random_spread: float | None
    edge: int
    edge_max: float | None
    edge_rmse: float | None
    wrong: int | None
    levels_off: int
    levels_max: int


def measure(drawn: Mapping[str, NDArray[np.generic]], proof: Proof, *, steps: int | None = None) -> Errors:
    """Hold a picture against proved pixels; `steps`: its colours are levels of a file, over this number.

    Raises:
        ValueError: the picture has another size.
    """
    shape = proof.analysis.ids.shape
    if wrong := [name for name in drawn if drawn[name].shape[:2] != shape]:
        found = drawn[wrong[0]].shape
        raise ValueError(f"delivered {found[1]}x{found[0]} pixels, expected {shape[1]}x{shape[0]}")
    at = proof.y, proof.x
    beauty = np.asarray(drawn["beauty"][at], dtype=np.float64)
    error, value = errors(beauty, proof, "beauty"), proof.value["beauty"]
    if steps:
        # A file holds nothing beyond black and white.
        error[((value >= 1) & (beauty == 1)) | ((value <= 0) & (beauty == 0))] = 0.0
    random, edge = proof.random & ~proof.unsettled, proof.edge & ~proof.unsettled
    # Rounded: dividing and multiplying by 255 must not move a level of an 8-bit file.
    seen = np.rint(beauty * 255).astype(int) if steps == 255 else quantise(beauty).astype(int)
    off = np.abs(seen - quantise(value).astype(int)).max(axis=1)[random]
    return Errors(
        int(random.sum()),
        *_sizes(error[random]),
        _spread(error[random]),
        int(edge.sum()),
        *_sizes(error[edge]),
        _wrong(drawn, proof),
        int((off > 0).sum()),
        int(off.max(initial=0)),
    )


def _sizes(error: NDArray[np.float64]) -> tuple[float | None, float | None]:
    if not error.size:
        return None, None
    return float(error.max()), float(np.sqrt(np.mean(np.square(error))))


def _spread(error: NDArray[np.float64]) -> float | None:
    """Of the root of a mean m, to first order: its standard error over 2 sqrt(m)."""
    if not error.size:
        return None
    squares = np.square(error).mean(axis=1)
    if len(squares) < 2 or not 0 < squares.mean() < np.inf:
        return 0.0
    return float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2 * np.sqrt(squares.mean())))


def _wrong(drawn: Mapping[str, NDArray[np.generic]], proof: Proof) -> int | None:
    if "id" not in drawn:
        return None
    at = proof.y, proof.x
    right = proof.value["id"][:, 0]
    wrong = np.asarray(drawn["id"][at], dtype=np.float64) != right
    for light, lit in enumerate(proof.lit):
        name = f"shadow.L{light}"
        if name in drawn:
            seen = np.asarray(drawn[name][at], dtype=np.float64)
            wrong |= lit & (right >= 0) & (seen != proof.value[name][:, 0])
    return int((wrong & ~proof.unsettled).sum())
