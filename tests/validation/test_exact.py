"""Exact signs of nested roots: against identities, and against 200 digits."""

from __future__ import annotations

import mpmath
import pytest
from flint import fmpq
from hypothesis import given
from hypothesis import strategies as st

from validation import exact
from validation.exact import Lazy, TooLargeError, Tower


def numbers(*values: int) -> list[Lazy]:
    """Rationals of one tower."""
    tower = Tower()
    return [Lazy.rational(tower, fmpq(value)) for value in values]


def test_nested_roots_that_are_equal() -> None:
    two, three, five, six = numbers(2, 3, 5, 6)
    # sqrt(5 + 2 sqrt(6)) = sqrt(2) + sqrt(3), and by the way sqrt(2) sqrt(3) = sqrt(6).
    nested = (five + 2 * six.sqrt()).sqrt()
    assert (nested - two.sqrt() - three.sqrt()).sign() == 0
    assert (two.sqrt() * three.sqrt() - six.sqrt()).sign() == 0
    assert (nested - two.sqrt() - three.sqrt() + fmpq(1, 10**300)).sign() == 1


def test_an_inverse_whose_conjugate_is_zero() -> None:
    # sqrt(8) - 2 sqrt(2) is 0, so that its conjugate sqrt(8) + 2 sqrt(2) has no inverse by the norm.
    two, eight = numbers(2, 8)
    total = eight.sqrt() + 2 * two.sqrt()
    assert (two / total - two / (4 * two.sqrt())).sign() == 0
    with pytest.raises(ZeroDivisionError):
        exact.invert((eight.sqrt() - 2 * two.sqrt()).exact())


def test_squares_are_rational() -> None:
    tower = Tower()
    assert tower.sqrt(fmpq(49, 4)) == fmpq(7, 2)
    assert tower.sqrt(fmpq(0)) == 0
    assert not tower.roots


def test_what_grows_too_large_is_said() -> None:
    (large,) = numbers(3)
    with pytest.raises(TooLargeError):
        exact.multiply(fmpq(1 << exact.LARGEST), large.exact())


@given(st.lists(st.integers(-50, 50), min_size=6, max_size=6), st.integers(2, 60), st.integers(2, 60))
def test_signs_are_those_of_many_digits(of: list[int], first: int, second: int) -> None:
    a, b, c, d, e, f, x, y = numbers(*of, first, second)
    inner = (a + b * x.sqrt()) * (a + b * x.sqrt()) + y
    value = c + d * inner.sqrt() + e * x.sqrt() + f * (inner * x).sqrt()
    with mpmath.workdps(200):
        root = mpmath.sqrt(first)
        within = (of[0] + of[1] * root) ** 2 + second
        about = of[2] + of[3] * mpmath.sqrt(within) + of[4] * root + of[5] * mpmath.sqrt(within * first)
    expected = 0 if abs(about) < mpmath.mpf(10) ** -150 else int(mpmath.sign(about))
    assert exact.sign(value.exact()) == value.sign() == expected
