"""Signs of numbers made of square roots, against digits: 200 of them, and identities that no digits prove."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, TypeAlias

import mpmath
import pytest
from flint import arb, ctx, fmpq
from hypothesis import given
from hypothesis import strategies as st

from validation import exact
from validation.exact import Lazy, TooLargeError, Tower, add, invert, multiply, negate, sign, subtract

#: An expression: a rational, or ("+", a, b), ("-", a, b), ("*", a, b), ("/", a, b), ("sqrt", a).
Tree: TypeAlias = Any

DIGITS = 200


def root(tower: Tower, square: int | fmpq | exact.Element) -> exact.Element:
    """A root in a tower."""
    return tower.sqrt(fmpq(square) if isinstance(square, int) else square)


def number(tree: Tree) -> mpmath.mpf:
    """An expression in 200 digits."""
    if not isinstance(tree, tuple):
        return mpmath.mpf(tree.numerator) / tree.denominator
    if tree[0] == "sqrt":
        return mpmath.sqrt(number(tree[1]))
    a, b = number(tree[1]), number(tree[2])
    return {"+": lambda: a + b, "-": lambda: a - b, "*": lambda: a * b, "/": lambda: a / b}[tree[0]]()


def element(tree: Tree, tower: Tower) -> exact.Element:
    """An expression in the tower; ZeroDivisionError and ValueError where it has no value."""
    if not isinstance(tree, tuple):
        return fmpq(tree.numerator, tree.denominator)
    if tree[0] == "sqrt":
        square = element(tree[1], tower)
        if sign(square) < 0:
            raise ValueError("the root of a negative number")
        return fmpq(0) if sign(square) == 0 else tower.sqrt(square)
    a, b = element(tree[1], tower), element(tree[2], tower)
    operations: dict[str, Callable[[], exact.Element]] = {
        "+": lambda: add(a, b),
        "-": lambda: subtract(a, b),
        "*": lambda: multiply(a, b),
        "/": lambda: multiply(a, invert(b)),
    }
    return operations[tree[0]]()


def lazy(tree: Tree, tower: Tower) -> Lazy:
    """An expression that is worked out exactly only where its ball does not tell."""
    if not isinstance(tree, tuple):
        return Lazy.rational(tower, fmpq(tree.numerator, tree.denominator))
    if tree[0] == "sqrt":
        return lazy(tree[1], tower).sqrt()
    a, b = lazy(tree[1], tower), lazy(tree[2], tower)
    operations: dict[str, Callable[[], Lazy]] = {
        "+": lambda: a + b,
        "-": lambda: a - b,
        "*": lambda: a * b,
        "/": lambda: a / b,
    }
    return operations[tree[0]]()


rationals = st.builds(Fraction, st.integers(-9, 9), st.integers(1, 5))


naturals = st.builds(Fraction, st.integers(1, 12))


def trees() -> st.SearchStrategy[Tree]:
    """Expressions with roots in roots, also of squares."""
    leaves = rationals | st.tuples(st.just("sqrt"), naturals)

    def more(smaller: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
        pairs = st.tuples(st.sampled_from("+-*/"), smaller, smaller)
        squares = smaller.map(lambda tree: ("sqrt", ("*", tree, tree)))
        above = st.builds(lambda tree, least: ("sqrt", ("+", ("*", tree, tree), least)), smaller, naturals)
        return pairs | squares | above

    return st.recursive(leaves, more, max_leaves=5)


@given(trees())
def test_signs_are_those_of_200_digits(tree: Tree) -> None:
    tower = Tower()
    try:
        found = sign(element(tree, tower))
    except (ZeroDivisionError, ValueError):
        return
    with mpmath.workdps(DIGITS):
        value = number(tree)
    # With so few leaves what is not 0 is far from it: conjugates and heights are small.
    assert found == (0 if abs(value) < mpmath.mpf(10) ** (10 - DIGITS) else mpmath.sign(value))


@given(trees())
def test_lazy_numbers_have_the_same_signs_at_any_precision(tree: Tree) -> None:
    try:
        expected = sign(element(tree, Tower()))
    except (ZeroDivisionError, ValueError):
        return
    before = ctx.prec
    try:
        for bits in (4, 53, 400):
            ctx.prec = bits
            assert lazy(tree, Tower()).sign() == expected
    finally:
        ctx.prec = before


@given(trees(), trees())
def test_the_field(a: Tree, b: Tree) -> None:
    tower = Tower()
    try:
        x, y = element(a, tower), element(b, tower)
    except (ZeroDivisionError, ValueError):
        return
    assert sign(subtract(add(x, y), add(y, x))) == 0
    assert sign(subtract(multiply(x, y), multiply(y, x))) == 0
    assert sign(add(x, negate(x))) == 0
    assert sign(subtract(x, y)) == -sign(subtract(y, x))
    assert sign(multiply(x, y)) == sign(x) * sign(y)
    if sign(y):
        assert sign(subtract(multiply(multiply(x, invert(y)), y), x)) == 0


@given(rationals, rationals, st.integers(1, 30), st.integers(1, 30))
def test_roots_of_perfect_squares_are_found_equal(a: Fraction, b: Fraction, m: int, n: int) -> None:
    """(a + b sqrt(m))^2 has the root |a + b sqrt(m)|, which the tower may write as a new root: the difference is 0."""
    tower = Tower()
    base = add(fmpq(a.numerator, a.denominator), multiply(fmpq(b.numerator, b.denominator), root(tower, m)))
    base = add(base, root(tower, n))
    if sign(base) == 0:
        return
    again = tower.sqrt(multiply(base, base))
    size = base if sign(base) > 0 else negate(base)
    assert sign(subtract(again, size)) == 0
    assert sign(again) == 1


def test_the_root_of_a_sum_of_roots() -> None:
    """sqrt(5 + 2 sqrt(6)) = sqrt(2) + sqrt(3), whichever comes first."""
    for order in ((2, 3, 6), (6, 3, 2), (3, 6, 2)):
        tower = Tower()
        roots = {square: root(tower, square) for square in order}
        nested = tower.sqrt(add(fmpq(5), multiply(fmpq(2), roots[6])))
        difference = subtract(nested, add(roots[2], roots[3]))
        assert sign(difference) == 0
        tiny = fmpq(1, 10**300)
        assert sign(add(difference, tiny)) == 1
        assert sign(subtract(difference, tiny)) == -1


def test_a_root_that_depends_on_others() -> None:
    tower = Tower()
    assert sign(subtract(multiply(root(tower, 2), root(tower, 3)), root(tower, 6))) == 0
    assert sign(subtract(root(tower, 8), multiply(fmpq(2), root(tower, 2)))) == 0
    # sqrt(2) + sqrt(5 - 2 sqrt(6)) = sqrt(3), and its inverse is that of sqrt(3).
    inner = tower.sqrt(subtract(fmpq(5), multiply(fmpq(2), root(tower, 6))))
    total = add(root(tower, 2), inner)
    assert sign(subtract(total, root(tower, 3))) == 0
    assert sign(subtract(multiply(fmpq(3), invert(total)), root(tower, 3))) == 0


def test_division_where_the_conjugate_is_zero() -> None:
    """The number sqrt(2) sqrt(3) + sqrt(6) is 2 sqrt(6), but a - b sqrt(D) of its form is 0: so is the norm."""
    tower = Tower()
    product = multiply(root(tower, 2), root(tower, 3))
    x = add(product, root(tower, 6))
    assert not isinstance(x, fmpq)
    assert sign(exact._norm(x)) == 0
    assert sign(x) == 1
    assert sign(subtract(multiply(x, invert(x)), fmpq(1))) == 0
    assert sign(subtract(multiply(x, x), fmpq(24))) == 0
    zero = subtract(product, root(tower, 6))
    assert not isinstance(zero, fmpq)
    with pytest.raises(ZeroDivisionError):
        invert(zero)
    with pytest.raises(ZeroDivisionError):
        invert(fmpq(0))


def test_squares_are_no_new_roots() -> None:
    tower = Tower()
    assert root(tower, 9) == fmpq(3)
    assert root(tower, fmpq(4, 25)) == fmpq(2, 5)
    assert root(tower, 0) == fmpq(0)
    assert tower.roots == []
    first, second = root(tower, 7), root(tower, 7)
    assert len(tower.roots) == 1
    assert sign(subtract(first, second)) == 0


def test_the_root_of_what_is_zero_in_another_form() -> None:
    tower = Tower()
    zero = subtract(multiply(root(tower, 2), root(tower, 3)), root(tower, 6))
    assert sign(tower.sqrt(zero)) == 0


def test_numbers_that_nearly_agree() -> None:
    """Sums of roots that differ in the 40th digit only are told apart, by the ball and exactly."""
    tower = Tower()
    almost = fmpq(1414213562373095048801688724209698078569, 10**39)
    assert sign(subtract(root(tower, 2), almost)) == 1
    assert sign(subtract(root(tower, 2), almost + fmpq(1, 10**39))) == -1
    before = ctx.prec
    try:
        ctx.prec = 64
        close = Lazy.rational(tower, fmpq(2)).sqrt() - Lazy.rational(tower, almost)
        assert not close > 0
        assert not close < 0
        assert close.sign() == 1
        assert (-close).sign() == -1
        assert (1 - close).sign() == 1
        assert (2 * close - 1).sign() == -1
        assert (close / close).sign() == 1
    finally:
        ctx.prec = before


def test_a_ball_that_tells_is_enough() -> None:
    """Nothing is worked out where the ball does not hold 0."""

    def never(*_: Any) -> exact.Element:
        raise AssertionError

    tower = Tower()
    assert Lazy(tower, arb(3, 1), never).sign() == 1
    assert Lazy(tower, arb(-3, 1), never).sign() == -1


def test_what_would_grow_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "LARGEST", 64)
    tower = Tower()
    long = fmpq(10**15 + 37, 10**14 + 31)
    with pytest.raises(TooLargeError):
        multiply(long, long)
    number_ = Lazy.rational(tower, long) * Lazy.rational(tower, long) - Lazy.rational(tower, long * long)
    with pytest.raises(TooLargeError):
        number_.sign()
    monkeypatch.undo()
    assert number_.sign() == 0
