"""power.hpp, the (R.V)^n of the kernels, against mpmath."""

from __future__ import annotations

import math
import random
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import mpmath
import numpy as np
import pytest
from programs import build, installation

from tracer.passes import Precision

UNIT = {"f64": 2.0**-53, "f32": 2.0**-24}
SMALLEST = {"f64": 2.0**-1022, "f32": 2.0**-126}  # of the normal numbers
SUBNORMAL = {"f64": 2.0**-1074, "f32": 2.0**-149}

Powers = Callable[[Precision, Sequence[tuple[float, float]]], list[float]]


@pytest.fixture(scope="module")
def powers(need: Callable[[object, str], None]) -> Powers:
    """The powers of pairs (x, n); n is multiplied out where a kernel does that."""
    folder = installation(need)
    build(folder, "powers", need=need)
    program: Path = folder / "powers"

    def run(precision: Precision, pairs: Sequence[tuple[float, float]]) -> list[float]:
        lines = []
        for x, n in pairs:
            integer = int(n) if n <= 1024 and n == int(n) else -1
            lines.append(f"{precision} {x.hex()} {n.hex()} {integer}\n")
        result = subprocess.run([program], input="".join(lines), capture_output=True, text=True, check=True)
        values = [float.fromhex(line) for line in result.stdout.split()]
        assert len(values) == len(pairs)
        return values

    return run


def fit(precision: Precision, x: float) -> float:
    return float(np.float32(x)) if precision == "f32" else float(x)


def bases(precision: Precision, generator: random.Random, count: int) -> list[float]:
    """Numbers of (0, 1]: anywhere, of all magnitudes of normal numbers, just below 1."""
    u, smallest = UNIT[precision], SMALLEST[precision]
    found = [1.0, 1 - u, 1 - 2 * u, 0.5, 0.5 + u, math.sqrt(0.5), smallest, smallest * (1 + 2 * u), 3 * smallest]
    for _ in range(count):
        found.append(generator.uniform(0, 1) or 1.0)
        found.append(smallest ** generator.uniform(0, 1))
        found.append(1 - u ** generator.uniform(0, 1))
        found.append(math.sqrt(0.5) * (1 + generator.uniform(-8, 8) * u))  # where the logarithm's pieces meet
    return [min(max(fit(precision, x), smallest), 1.0) for x in found]


def check(precision: Precision, powers: Powers, pairs: list[tuple[float, float]]) -> list[tuple[mpmath.mpf, float]]:
    """For each pair the exact power, and how far off it is, in u."""
    found = []
    with mpmath.workdps(50):
        for (x, n), value in zip(pairs, powers(precision, pairs), strict=True):
            power = mpmath.power(mpmath.mpf(x), mpmath.mpf(n))
            found.append((power, float(abs(value - power) / UNIT[precision])))
    return found


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_logarithm_and_an_exponential(precision: Precision, powers: Powers) -> None:
    """Off by (7 |n ln x| + 3) u of the power: by less than 8 u."""
    generator = random.Random(1)
    pairs = []
    for x in bases(precision, generator, 700):
        scale = -1 / math.log(x) if x < 1 else 1e6
        # Powers from nearly 1 to nearly 0, and any.
        some = (scale * 10 ** generator.uniform(-2, 1), 10 ** generator.uniform(-2, 6), generator.uniform(0.01, 3))
        for n in (*some, generator.randint(1025, 10**6)):
            rounded = fit(precision, min(max(n, 0.01), 1e6))
            if rounded > 1024 or rounded != int(rounded):
                pairs.append((x, rounded))
    assert len(pairs) > 9000
    found = check(precision, powers, pairs)
    assert max(off for _, off in found) < 8
    for (x, n), (power, off) in zip(pairs, found, strict=True):
        if power > 4 * SMALLEST[precision]:  # below it becomes 0
            assert off < float(power) * (7 * n * -math.log(x) + 3), (x, n)
    middle = [off for power, off in found if 0.01 < power < 0.99]
    assert len(middle) > 1500
    assert max(middle) > 0.4  # some are not what is nearest: the judge is more exact than what it judges


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_an_exponent_that_is_multiplied_out(precision: Precision, powers: Powers) -> None:
    """Off by n - 1 roundings of the power at most, in whatever order."""
    generator = random.Random(2)
    u, smallest = UNIT[precision], SMALLEST[precision]
    exponents = (*range(1, 33), 63, 64, 65, 127, 255, 500, 511, 512, 513, 767, 1000, 1023, 1024)
    pairs = []
    for n in exponents:
        pairs += [(x, float(n)) for x in (1.0, 1 - u, smallest, SUBNORMAL[precision])]
        for _ in range(100):
            x = math.exp(-generator.uniform(0, 6) / n)
            pairs += [(fit(precision, x), float(n)), (fit(precision, generator.random()), float(n))]
    for (x, n), (power, off) in zip(pairs, check(precision, powers, pairs), strict=True):
        assert off <= float(power) * math.expm1((n - 1) * math.log1p(u)) / u + smallest / u, (x, n)
    assert powers(precision, [(x, 0.0) for x in (1.0, 0.3, SUBNORMAL[precision])]) == [1.0] * 3


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_what_is_no_normal_number_counts_as_the_smallest(precision: Precision, powers: Powers) -> None:
    """Where n is not below 1 that is nothing to see; else a change of R.V by its last digit turns it over."""
    subnormal = [SUBNORMAL[precision], 3 * SUBNORMAL[precision], SMALLEST[precision] / 2]
    for n in (0.01, 0.5, 0.99, 1.01, 2.5, 33.3, 1025.0):
        number = fit(precision, n)
        expected = powers(precision, [(SMALLEST[precision], number)]) * 3
        assert powers(precision, [(x, number) for x in subnormal]) == expected
        if n > 1:
            assert expected[0] <= SMALLEST[precision]
