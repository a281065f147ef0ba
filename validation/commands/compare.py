"""`whitted compare`: two files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from validation import records
from validation.commands.errors import DIFFERENT, CommandError, errors
from validation.commands.help import Command
from validation.commands.inputs import IMAGES, PASS_FILES, check_flip, refuse_pass
from validation.commands.outputs import command_line, writable
from validation.options import json_option, names_option, positive
from validation.terminal import print_comparisons

if TYPE_CHECKING:
    from tracer.passes import Passes


@click.command(
    cls=Command,
    short_help="Compare two files of passes, or two images.",
    examples=[
        "whitted render scenes/gallery/lantern.txt -o a.exr --passes beauty,depth",
        "whitted render scenes/gallery/lantern.txt -o b.npz --renderer numpy-f64",
        "whitted compare a.exr b.npz --passes depth --tolerance 0.001",
    ],
    statuses={0: "equal within the tolerance", 1: "different"},
)
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@names_option("--passes", help="Passes to compare; default: all that both files have.")
@click.option(
    "--tolerance",
    type=float,
    default=0.0,
    show_default=True,
    callback=positive,
    metavar="T",
    help="Largest difference that counts as equal.",
)
@click.option("--flip", is_flag=True, help="Measure FLIP of beauty for --json: pip install 'whitted[flip]'.")
@json_option
@click.option("-q", "--quiet", is_flag=True, help="Print nothing: the exit status says it.")
@click.pass_context
def compare(
    ctx: click.Context,
    /,
    a: Path,
    b: Path,
    passes: tuple[str, ...] | None,
    tolerance: float,
    flip: bool,
    json_file: Path | None,
    quiet: bool,
) -> None:
    """Compare two files of passes (.exr, .npz) or two images (.png, .ppm; values are levels
    from 0 to the maximum of the file).
    """
    from fnmatch import fnmatchcase

    from validation.compare import compare_plain

    with errors():
        check_flip(wanted=flip)
        if json_file:
            writable(json_file)
        first, second = _read(a), _read(b)
        images = [path.suffix.lower() in IMAGES for path in (a, b)]
        if images[0] != images[1]:
            hint = "compare two files of passes (.exr, .npz) or two images (.png, .ppm)"
            steps = first.metadata["levels"] if images[0] else second.metadata["levels"]
            image = "an 8-bit image" if steps == "255" else f"an image of levels up to {steps}"
            raise CommandError(f"{a} and {b}: one holds passes, the other is {image}", hint)
        most = [side.metadata["levels"] for side in (first, second) if images[0]]
        if len(set(most)) > 1:
            message = f"{a} has levels from 0 to {most[0]}, {b} from 0 to {most[1]}: they cannot be compared"
            raise CommandError(message, "write both with the same maximum, or compare float files (.exr, .npz)")
        both = [name for name in first if name in second]
        for name in passes or ():
            for path, side in ((a, first), (b, second)):
                if not any(fnmatchcase(have, name) for have in side):
                    refuse_pass(name, str(path), list(side), [*first, *second])
        if not both:
            raise CommandError(f"{a} and {b} have no pass in common", f"{', '.join(first)} and {', '.join(second)}")
        chosen = [name for name in both if not passes or any(fnmatchcase(name, wanted) for wanted in passes)]
        if not chosen:
            raise CommandError(f"{a} and {b} have none of {', '.join(passes or ())} in common", f"{', '.join(both)}")
        labels: dict[str, Any] = {"renderer": str(a), "reference": str(b), "visual": not images[0], "flip": flip}
        found = [compare_plain(first, second, name, tolerance, **labels) for name in chosen]
        equal = all(comparison.ok for comparison in found)
        if quiet:
            pass
        elif first.shape == second.shape:
            print_comparisons(found, levels=images[0])
        else:
            sizes = [f"{path} is {side.shape[1]}x{side.shape[0]}" for path, side in ((a, first), (b, second))]
            click.echo(f"DIFFERENT: {', '.join(sizes)} pixels: no pixel was compared")
        alone = [name for name in [*first, *second] if name not in both]
        if alone and not passes and not quiet:
            click.echo(f"note: only in one of the two, not compared: {', '.join(alone)}")
        if json_file:
            fields = {
                "ok": equal,
                "command": command_line(),
                "comparisons": [comparison.record() for comparison in found],
            }
            records.write(json_file, records.result("compare", fields))
    ctx.exit(0 if equal else DIFFERENT)


def _read(path: Path) -> Passes:
    """A file of passes; an image becomes its levels under the name `beauty`, their number above 0 in the metadata."""
    import numpy as np

    from tracer.passes import Passes
    from validation.images import ImageError, decode, ppm_size

    ending = path.suffix.lower()
    try:
        if ending in PASS_FILES:
            return Passes.load(path)
        if ending not in IMAGES:
            raise CommandError(f"{path}: unknown file ending '{ending}'", "expected .exr, .npz, .png or .ppm")
        from PIL import Image

        deep = _bits(path)
        if deep > 8 and ending == ".ppm":
            data = path.read_bytes()
            found = decode(data, ppm_size(data))
            return Passes({"beauty": found.levels.astype(np.float64)}, {"levels": str(found.steps)})
        if deep > 8:
            hint = "compare float files (.exr, .npz), or convert it to a PPM or to 8 bits"
            raise CommandError(f"{path}: an image of {deep} bits a channel, expected 8", hint)
        with Image.open(path) as image:
            if image.mode not in ("RGB", "RGBA", "L", "P", "1", "LA"):
                raise CommandError(f"{path}: an image of mode {image.mode}, expected 8 bits a channel")
            levels = np.asarray(image.convert("RGB")).astype(np.float64)
            return Passes({"beauty": levels}, {"levels": "255"})
    except CommandError:
        raise
    except FileNotFoundError as error:
        raise CommandError(f"{path}: no such file") from error
    except ImageError as error:
        raise CommandError(f"{path}: {error.message}", error.hint) from error
    except (ValueError, SyntaxError) as error:
        text = str(error)
        raise CommandError(text if str(path) in text else f"{path}: {text}") from error
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror or 'not a readable image'}") from error


def _bits(path: Path) -> int:
    """Bits a channel of a PNG or PPM file, which Pillow would reduce to 8 without a word; 0: neither."""
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return head[24] if len(head) > 24 else 0
    words = re.sub(rb"#[^\n]*", b"", head).split(maxsplit=4)
    if len(words) > 3 and re.fullmatch(rb"P[2356]", words[0]) and words[3].isdigit():
        return int(words[3][:9]).bit_length()
    return 0
