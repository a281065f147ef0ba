"""The bytes of the gallery, as hashes in golden.sha256: the same on every machine and from every compiler.

python tests/golden.py            what differs from the table; exit status 1 if anything does
python tests/golden.py --write    makes the table anew, after a change that is meant to change bits
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import tracer
from tracer.passes import names

ROOT = Path(__file__).resolve().parent.parent
TABLE = Path(__file__).with_suffix(".sha256")
RAYTRACE = Path(sys.executable).parent / "raytrace"
SIZE = (93, 71)  # no multiple of any packet, and quick
GEOMETRY = ("id", "depth", "position", "normal")


def group(name: str) -> str:
    """What a pass tells of: geometry, shadows or colors, so that a table tells what has changed."""
    return "shadows" if name.startswith("shadow") else "geometry" if name in GEOMETRY else "colors"


def digests() -> dict[str, str]:
    """Scene, precision and what of it, each with its hash: groups of passes in a small size, the program's image."""
    found = {}
    for path in sorted((ROOT / "scenes" / "gallery").glob("*.txt")):
        scene = tracer.load(path)
        small = scene.replace(view=scene.view.replace(columns=SIZE[0], rows=SIZE[1]))
        for precision in ("f64", "f32"):
            groups = {name: hashlib.sha256() for name in ("geometry", "shadows", "colors")}
            drawn = tracer.render(small, names(len(scene.lights), margins=False), precision=precision)
            for name, array in drawn.items():
                groups[group(name)].update(name.encode() + array.astype(array.dtype.newbyteorder("<")).tobytes())
            command = (RAYTRACE, path, "--precision", precision, "-o-")
            image = hashlib.sha256(subprocess.run(command, check=True, capture_output=True).stdout)
            for name, digest in (*groups.items(), ("image", image)):
                found[f"{path.stem} {precision} {name}"] = digest.hexdigest()
    return found


def table() -> dict[str, str]:
    """What the file holds."""
    lines = (line.split("  ") for line in TABLE.read_text().splitlines())
    return {name: digest for digest, name in lines}


def differing(found: dict[str, str]) -> list[str]:
    """What is not as in the table, or only in one of both."""
    before = table()
    return sorted(name for name in found.keys() | before.keys() if found.get(name) != before.get(name))


def main() -> int:
    """Compare, or write."""
    found = digests()
    if sys.argv[1:] == ["--write"]:
        TABLE.write_text("".join(f"{digest}  {name}\n" for name, digest in found.items()))
        return 0
    print("\n".join(differing(found)) or f"all {len(found)} are the same")
    return bool(differing(found))


if __name__ == "__main__":
    sys.exit(main())
