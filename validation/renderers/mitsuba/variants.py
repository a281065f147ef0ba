"""The variants of Mitsuba that a renderer may run in: which there are, whether they run here, and how to set one."""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from converters import mitsuba_plugins
from validation.renderers.mitsuba import llvm

VARIANTS = {"llvm": "llvm_ad_rgb", "scalar": "scalar_rgb", "cuda": "cuda_ad_rgb"}

#: Where the kernel says that there is an NVIDIA driver.
DRIVER = "/proc/driver/nvidia/version"


class Variant:
    """One variant of Mitsuba behind a name such as `mitsuba-path@llvm`."""

    #: The part of the name before the variant.
    family = "mitsuba"
    precision = "f32"

    def __init__(self, backend: str) -> None:
        """`backend` is a key of VARIANTS."""
        self.backend = backend
        self.name = f"{self.family}@{backend}"

    def version(self) -> str:
        """Mitsuba's version and the variant."""
        return f"{importlib.metadata.version('mitsuba')} {VARIANTS[self.backend]}"

    def versions(self) -> Mapping[str, str]:
        """Mitsuba, Dr.Jit, the variant, and the compiler or driver where there is one."""
        versions = {package: importlib.metadata.version(package) for package in ("mitsuba", "drjit")}
        versions["mitsuba variant"] = VARIANTS[self.backend]
        if self.backend == "llvm":
            path, version = llvm.find()
            versions["LLVM"] = version if path else "none"
        if self.backend == "cuda":
            versions["CUDA"] = cuda()[1] if self.unavailable() is None else "none"
        return versions

    def unavailable(self) -> str | None:
        """The scalar variant needs nothing."""
        if self.backend == "scalar":
            return None
        if self.backend == "cuda":
            works, reason = cuda()
            return None if works else reason
        path, reason = llvm.find()
        return None if path else reason

    def ready(self) -> contextlib.AbstractContextManager[None]:
        """Have the variant set."""
        if reason := self.unavailable():
            raise RuntimeError(f"{self.name} cannot run: {reason}")
        if self.backend == "llvm":
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(llvm.find()[0]))
        return mitsuba_plugins.variant(VARIANTS[self.backend])


@functools.cache
def cuda() -> tuple[bool, str]:
    """Whether Mitsuba works with a GPU here, and the name of the GPU, or why not.

    A driver that does not fit may end the whole process: so this is tried in a process of its own, and only where there
    is a driver at all.
    """
    needs = "the variant cuda needs an NVIDIA GPU with a driver of version 535 or later"
    if not Path(DRIVER).exists():
        return False, f"no NVIDIA driver was found: {needs}"
    try:
        command = [sys.executable, "-c", _PROBE]
        result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except subprocess.TimeoutExpired:
        return False, f"Mitsuba hangs with the NVIDIA driver: {needs}"
    if result.returncode == 0:
        return True, result.stdout.strip()
    return False, f"Mitsuba does not work with the NVIDIA driver: {needs}"


_PROBE = """
import drjit, mitsuba
mitsuba.set_variant("cuda_ad_rgb")
scene = mitsuba.load_dict({"type": "scene", "shape": {"type": "sphere"}})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, 3), mitsuba.Vector3f(0, 0, drjit.arange(mitsuba.Float, 3) - 1))
assert list(scene.ray_intersect_preliminary(ray).t)[:1] == [2.0]
print(".".join(map(str, drjit.detail.cuda_version())) if hasattr(drjit.detail, "cuda_version") else "CUDA")
"""
