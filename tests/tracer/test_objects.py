"""What the compiler made: no function compiled for one instruction set can be linked into another's path."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from programs import build, installation

UNITS = {"x86_64": ("scalar", "sse2", "avx2", "avx512"), "aarch64": ("scalar", "neon")}.get(platform.machine(), ())
WIDE = ("avx2", "avx512")
KINDS = {"kernel": "kernels", "limits": "limits"}  # the file, and its table
# What libm rounds correctly, so that every machine has the same.
EXACT = {"ceil", "floor", "trunc", "rint", "nearbyint", "round", "frexp", "ldexp", "scalbn", "modf", "fabs", "copysign"}
EXACT |= {"sqrt", "fma", "fmod", "nextafter", "ilogb"}


@pytest.fixture(scope="module")
def built(need: Callable[[object, str], None]) -> Path:
    """The folder with the objects and the program, which still knows the names of its functions."""
    need(shutil.which("nm") and shutil.which("objdump"), "nm and objdump are not installed: apt-get install binutils")
    folder = installation(need)
    build(folder, "raytrace", need=need)
    return folder


def lines(*command: str | Path) -> list[str]:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def symbols(path: Path) -> dict[str, str]:
    """Names of an object file and what they are to the linker, as nm has it: lower case is local, W and V are weak."""
    return {line.split()[-1]: line.split()[-2] for line in lines("nm", path)}


def objects(folder: Path) -> dict[str, Path]:
    """The object files of the renderer."""
    found = {path.name.removesuffix(".cpp.o"): path for path in folder.glob("CMakeFiles/whitted_core.dir/**/*.o")}
    assert {f"{kind}_{unit}" for kind in KINDS for unit in UNITS} < set(found)
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("unit", UNITS)
def test_the_linker_sees_nothing_but_the_table(built: Path, kind: str, unit: str) -> None:
    """A weak symbol, as of an inline function, might be taken from here by all: on another processor it would end."""
    found = symbols(objects(built)[f"{kind}_{unit}"])
    seen = {name: letter for name, letter in found.items() if letter != "U" and not letter.islower()}
    table = f"{KINDS[kind]}_{unit}"
    assert list(seen.values()) in (["D"], ["R"]), seen
    assert list(seen) == [f"_ZN7whitted{len(table)}{table}E"]
    # Nor does anything of it run before main().
    assert not [name for name in found if name.startswith("_GLOBAL__sub_I")]
    # It calls nothing but this, of C.
    assert {name for name, letter in found.items() if letter == "U"} <= {"memset", "memcpy", "memmove"}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="reads the instructions of x86")
def test_only_their_own_functions_have_wide_instructions(built: Path) -> None:
    """In the program, instructions of AVX are in functions of the units for AVX, whose names no other unit has."""
    units = objects(built)
    wide = {f"{kind}_{unit}" for kind in KINDS for unit in WIDE}
    own = {name for unit in wide for name in symbols(units[unit])}
    others = {name for unit, path in units.items() if unit not in wide for name in symbols(path)}
    function = ""
    found: set[str] = set()
    for line in lines("objdump", "-d", "--no-show-raw-insn", built / "raytrace"):
        if named := re.match(r"[0-9a-f]+ <(.+)>:$", line):
            function = named[1]
        elif re.search(r"\t(v[a-z0-9]+|k[a-z]+[bwdq])\s.*%([xyz]mm|k[0-7])", line):
            found.add(function)
    assert len(found) >= 4  # a kernel for either precision
    assert found <= own - others


def test_nothing_depends_on_libm(built: Path) -> None:
    """Its sines and powers have other last digits in other versions."""
    loaded = "\n".join(lines("ldd", built / "raytrace"))
    library = re.search(r"libm\.so\S* => (\S+)", loaded)
    assert library, loaded
    libm = {line.split()[-1].split("@")[0] for line in lines("nm", "-D", "--defined-only", library[1])}
    assert {"pow", "expf", "floor"} <= libm
    inexact = libm - EXACT - {f"{name}f" for name in EXACT} - {name for name in libm if name.startswith("fe")}
    for unit, path in objects(built).items():
        assert not inexact & symbols(path).keys(), unit
