"""The one table of passes, and Passes: named arrays of one rendering with their file formats."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from tracer.near import near

Quantity = Literal["color", "visibility", "length", "position", "normal", "id", "margin"]
Precision = Literal["f64", "f32"]
Sample = Literal["corner", "center", "bottom-left", "top-right", "inclusive"]
#: The sample point of a pixel, in pixels to the right of its top-left corner and below it; `inclusive` also stretches
#: the grid, from the first to the last column and row.
OFFSETS: dict[Sample, tuple[float, float]] = {
    "corner": (0, 0),
    "center": (0.5, 0.5),
    "bottom-left": (0, 1),
    "top-right": (1, 0),
    "inclusive": (0, 0),
}
SAMPLES: tuple[Sample, ...] = tuple(OFFSETS)
MARGINS = ("silhouette", "range", "order", "terminator")


@dataclass(frozen=True)
class Pass:
    """One row of the table: what a pass holds and where the primary ray misses.

    `name` ends in `*` for a family (`shadow.L*`: one a light; `reflection.*`: one a bounce, from 1).
    `channels` is empty for a pass of one channel, whose array has shape (rows, columns); else the array has shape
    (rows, columns, len(channels)). `miss` None means the scene's background, or "as computed" for margins.
    `exr` says how an EXR file names the channels: the pass name, with `{}` for the channel.
    """

    name: str
    channels: str
    quantity: Quantity
    miss: float | None
    exr: str

    @property
    def family(self) -> bool:
        return self.name.endswith("*")


TABLE: tuple[Pass, ...] = (
    Pass("beauty", "RGB", "color", None, "{channel}"),
    Pass("ambient", "RGB", "color", 0.0, "{name}.{channel}"),
    Pass("diffuse", "RGB", "color", 0.0, "{name}.{channel}"),
    Pass("specular", "RGB", "color", 0.0, "{name}.{channel}"),
    Pass("direct", "RGB", "color", 0.0, "{name}.{channel}"),
    Pass("shadow.L*", "", "visibility", 0.0, "{name}"),
    Pass("reflection", "RGB", "color", 0.0, "{name}.{channel}"),
    Pass("reflection.*", "RGB", "color", 0.0, "{name}.{channel}"),
    Pass("depth", "", "length", float("inf"), "{name}.Z"),
    Pass("position", "XYZ", "position", 0.0, "{name}.{channel}"),
    Pass("normal", "XYZ", "normal", 0.0, "{name}.{channel}"),
    Pass("id", "", "id", -1.0, "{name}"),
    Pass("margin.*", "", "margin", None, "{name}"),
)


def names(lights: int, max_reflections: int = 3, *, margins: bool = True) -> tuple[str, ...]:
    """Every pass of a scene with that many lights, in the order of the table, margins (if wanted) last."""
    members = {
        "shadow.L*": [f"shadow.L{i}" for i in range(lights)],
        "reflection.*": [f"reflection.{k}" for k in range(1, max_reflections + 1)],
        "margin.*": [f"margin.{kind}" for kind in MARGINS if margins],
    }
    return tuple(name for row in TABLE for name in members.get(row.name, [row.name]))


def lookup(name: str) -> Pass:
    """The row of the table for a pass name.

    Raises:
        ValueError: there is no such pass; the message names the nearest one.
    """
    for row in TABLE:
        stem = row.name.removesuffix("*")
        if name == row.name and not row.family:
            return row
        if row.family and name.startswith(stem):
            member = name.removeprefix(stem)
            first = "[1-9]" if row.quantity == "color" else "(?:0$|[1-9])"  # bounces count from 1, lights from 0
            if member in MARGINS if row.quantity == "margin" else re.fullmatch(first + "[0-9]{0,8}", member):
                return row
    meant = near(name, names(1))
    raise ValueError(f"unknown pass '{name}'" + (f" (did you mean '{meant}'?)" if meant else ""))


def quantise(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """The 8-bit image of linear colours: clamped to [0, 1], times 255, truncated; NaN becomes 0."""
    clamped = np.where(values > 0, np.where(values < 1, values, 1), 0).astype(values.dtype)
    levels: NDArray[np.uint8] = (clamped * values.dtype.type(255)).astype(np.uint8)
    return levels


def replaceable(path: Path) -> bool:
    """Whether a file may be put in its place, and again: no device, no pipe, nothing that this process has open."""
    return _descriptor(path) is None and (path.is_file() or path.is_dir() or not path.exists())


@contextlib.contextmanager
def write_beside(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the folder of `path` that is renamed to it at the end; on an error nothing is left.

    What must not be replaced by a file gets the bytes at the end: a device, a pipe, and what this process has open,
    such as /dev/stdout, whatever that leads to.
    """
    path, descriptor = Path(path), _descriptor(Path(path))
    if not replaceable(path):
        with tempfile.TemporaryDirectory(prefix="whitted-") as folder:
            yield Path(folder) / f"output{path.suffix}"
            with (Path(folder) / f"output{path.suffix}").open("rb") as made:
                _send(made, path, descriptor)
        return
    path = Path(os.path.realpath(path))  # the file behind a link is replaced, not the link
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(path.parent))
    try:
        handle, name = tempfile.mkstemp(prefix=".whitted-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        # The user knows the target, not the file beside it.
        if error.errno and error.filename in (None, name, temporary):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _descriptor(path: Path) -> int | None:
    """The number that this process has something open as, of a path such as /dev/stdout; None: it is none."""
    for _ in range(40):  # as many links as a system follows
        found = re.fullmatch(rf"(?:/dev|/proc/self|/proc/{os.getpid()})/fd/(\d+)", str(path))
        if found:
            return int(found[1])
        if not path.is_symlink():
            return None
        path = Path(os.path.normpath(path.parent / path.readlink()))
    return None


def _send(made: BinaryIO, path: Path, descriptor: int | None) -> None:
    """Bytes to what is open, or to a device or a pipe."""
    try:
        if descriptor is None:
            with path.open("wb") as out:
                shutil.copyfileobj(made, out)
            return
        sys.stdout.flush()  # what was printed comes before
        # The same open file: so it goes on where that is.
        with os.fdopen(os.dup(descriptor), "wb") as out:
            shutil.copyfileobj(made, out)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


class Passes(Mapping[str, NDArray[Any]]):
    """Named passes of one rendering, all of one size.

    Arrays have shape (rows, columns) or (rows, columns, channels), row 0 at the top; colours are linear and unclamped,
    lengths in world units, ids int32. `metadata` holds text about how they were made (renderer, versions, settings).
    """

    def __init__(self, arrays: Mapping[str, NDArray[Any]], metadata: Mapping[str, str] | None = None) -> None:
        """Raises ValueError on an unknown pass name or arrays whose shapes do not fit the table and each other."""
        self._arrays = {name: np.asarray(array) for name, array in arrays.items()}
        self.metadata = dict(metadata or {})
        size: tuple[int, ...] | None = None
        for name, array in self._arrays.items():
            channels = len(lookup(name).channels)
            if array.dtype.kind not in "biuf":
                raise ValueError(f"pass '{name}' holds {array.dtype}, expected numbers")
            if array.ndim != (3 if channels else 2) or (channels and array.shape[2] != channels):
                expected = f"(rows, columns, {channels})" if channels else "(rows, columns)"
                raise ValueError(f"pass '{name}' has shape {array.shape}, expected {expected}")
            size = size or array.shape[:2]
            if array.shape[:2] != size:
                raise ValueError(f"pass '{name}' has size {array.shape[:2]}, the others {size}")
        self.shape: tuple[int, int] = (size[0], size[1]) if size else (0, 0)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        rows, columns = self.shape
        return f"Passes({columns}x{rows}: {', '.join(self)})"

    def _repr_html_(self) -> str:
        """For notebooks."""
        from tracer.notebook import passes_html

        return passes_html(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `.exr` (float32), `.npz` (lossless), or the 8-bit beauty as `.png` or `.ppm`; by the ending.

        What float32 cannot hold is infinite in an `.exr`.

        The file is written beside and renamed, so that no half of it is ever seen.

        Raises:
            ValueError: an unknown ending, or a `.png` or `.ppm` without the pass `beauty`.
            OSError: the file cannot be written.
        """
        ending = Path(path).suffix.lower()
        writer = {".exr": _save_exr, ".npz": _save_npz, ".png": _save_image, ".ppm": _save_image}.get(ending)
        if writer is None:
            raise ValueError(f"unknown file ending '{ending}': expected .exr, .npz, .png or .ppm")
        with write_beside(path) as temporary:
            writer(self, temporary)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Passes:
        """Read what `save` wrote as `.exr` or `.npz`.

        Raises:
            ValueError: not such a file, or one with unknown passes.
            OSError: the file cannot be read.
        """
        ending = Path(path).suffix.lower()
        reader = {".exr": _load_exr, ".npz": _load_npz}.get(ending)
        if reader is None:
            raise ValueError(f"unknown file ending '{ending}': expected .exr or .npz")
        if not Path(path).is_file():
            raise FileNotFoundError(f"no such file: {path}")
        with Path(path).open("rb"):  # what cannot be opened is an OSError; from here on the content is at fault
            pass
        try:
            return reader(Path(path))
        except Exception as error:
            raise ValueError(f"{path}: not a readable {ending} file ({error})") from error


def _save_npz(passes: Passes, path: Path) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, metadata=np.array(json.dumps(passes.metadata)), **dict(passes))


def _load_npz(path: Path) -> Passes:
    with path.open("rb") as opened, zipfile.ZipFile(opened):  # np.load takes other kinds of files too
        opened.seek(0)
        with np.load(opened, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    return Passes(arrays, json.loads(str(arrays.pop("metadata", "{}"))))


def _exr_channels(name: str) -> list[str]:
    row = lookup(name)
    return [row.exr.format(name=name, channel=channel) for channel in row.channels or " "]


def _save_exr(passes: Passes, path: Path) -> None:
    import OpenEXR

    channels: dict[str, NDArray[Any]] = {}
    for name, array in passes.items():
        # EXR has no signed integers: ids are stored from 0 (nothing hit), which a viewer shows as black.
        with np.errstate(over="ignore"):
            stored = (array + 1).astype(np.uint32) if lookup(name).quantity == "id" else array.astype(np.float32)
        planes = stored[..., None] if stored.ndim == 2 else stored
        for channel, plane in zip(_exr_channels(name), np.moveaxis(planes, 2, 0), strict=True):
            channels[channel] = np.ascontiguousarray(plane)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header["whitted"] = json.dumps({"passes": list(passes), "metadata": passes.metadata})
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:  # a full disk, for example
        raise OSError(str(error)) from error


def _load_exr(path: Path) -> Passes:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        described = json.loads(file.header().get("whitted", "{}"))
        planes = {name: channel.pixels for name, channel in file.channels().items()}
    arrays: dict[str, NDArray[Any]] = {}
    for name in described.get("passes") or _guess_passes(planes):
        missing = [channel for channel in _exr_channels(name) if channel not in planes]
        if missing:
            raise ValueError(f"pass '{name}' lacks the channel '{missing[0]}'")
        stacked = np.stack([planes[channel] for channel in _exr_channels(name)], axis=-1)
        row = lookup(name)
        if row.quantity == "id":
            stacked = stacked.astype(np.int64).astype(np.int32) - np.int32(1)
        arrays[name] = stacked if row.channels else stacked[..., 0]
    return Passes(arrays, described.get("metadata"))


def _guess_passes(planes: Mapping[str, Any]) -> list[str]:
    """The passes whose channels an EXR file of another program holds."""
    candidates = names(lights=100, max_reflections=100)
    found = [name for name in candidates if all(channel in planes for channel in _exr_channels(name))]
    if not found:
        raise ValueError(f"no known pass among the channels {', '.join(sorted(planes))}")
    return found


def _save_image(passes: Passes, path: Path) -> None:
    from PIL import Image

    if "beauty" not in passes:
        raise ValueError("an image file holds the pass 'beauty', which is not among the passes: render it too")
    Image.fromarray(quantise(passes["beauty"])).save(path)
