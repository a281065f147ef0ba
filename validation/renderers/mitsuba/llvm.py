"""Finds an LLVM library that Mitsuba's compiling variants work with."""

from __future__ import annotations

import functools
import os
import re
import subprocess
import sys
from pathlib import Path

#: Where LLVM libraries lie, or below.
FOLDERS = ("/usr/lib", "/usr/lib64", "/usr/local/lib", "/opt/homebrew/opt/llvm/lib")


@functools.cache
def find() -> tuple[str | None, str]:
    """The newest LLVM library that Mitsuba works with and its version, or None and the reason.

    Some versions end the whole process, so each is tried in a process of its own.
    """
    asked = os.environ.get("DRJIT_LIBLLVM_PATH")
    candidates = [asked] if asked else _libraries()
    reason = "no LLVM library was found"
    for path in candidates:
        try:
            result = subprocess.run(
                [sys.executable, "-c", _PROBE],
                env={**os.environ, "DRJIT_LIBLLVM_PATH": path},
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        except subprocess.TimeoutExpired:
            reason = f"Mitsuba hangs with {path}"
            continue
        if result.returncode == 0:
            return path, result.stdout.strip()
        reason = f"Mitsuba does not work with {path}"
    return None, f"{reason}: apt-get install libllvm19"


_PROBE = """
import drjit, mitsuba
mitsuba.set_variant("llvm_ad_rgb")
drjit.eval(drjit.minimum(drjit.arange(mitsuba.Float, 3), 1))
scene = mitsuba.load_dict({"type": "scene", "shape": {"type": "sphere"}})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, 3), mitsuba.Vector3f(0, 0, drjit.arange(mitsuba.Float, 3) - 1))
assert list(scene.ray_intersect_preliminary(ray).t)[:1] == [2.0]
print(".".join(map(str, drjit.detail.llvm_version())))
"""


def _libraries() -> list[str]:
    """LLVM libraries where distributions put them, newest first, without those that Mitsuba refuses or that abort."""
    found: dict[Path, int] = {}
    for folder in FOLDERS:
        for pattern in ("libLLVM*", "*-linux-gnu/libLLVM*", "llvm*/lib/libLLVM*"):
            for path in Path(folder).glob(pattern):
                # libLLVM-19.so, libLLVM.so.19.1, libLLVM.dylib; a number is 0 where the name has none.
                path = path.resolve()
                if path.is_file() and re.fullmatch(r"libLLVM[-.\d]*(so|dylib)[.\d]*", path.name):
                    found[path] = int((re.findall(r"\d+", path.name) or ["0"])[0])
    newest = sorted(found, key=lambda path: found[path], reverse=True)
    return [str(path) for path in newest if found[path] not in range(1, 17)]
