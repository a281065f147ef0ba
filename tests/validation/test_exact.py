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
from validation.exact import Lazy, TooLargeError, Tower

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
        if tower.sign(square) < 0:
            raise ValueError("the root of a negative number")
        return fmpq(0) if tower.sign(square) == 0 else tower.sqrt(square)
    a, b = element(tree[1], tower), element(tree[2], tower)
    operations: dict[str, Callable[[], exact.Element]] = {
        "+": lambda: tower.add(a, b),
        "-": lambda: tower.subtract(a, b),
        "*": lambda: tower.multiply(a, b),
        "/": lambda: tower.multiply(a, tower.invert(b)),
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
        found = tower.sign(element(tree, tower))
    except (ZeroDivisionError, ValueError):
        return
    with mpmath.workdps(DIGITS):
        value = number(tree)
    # With so few leaves what is not 0 is far from it: conjugates and heights are small.
    assert found == (0 if abs(value) < mpmath.mpf(10) ** (10 - DIGITS) else mpmath.sign(value))


@given(trees())
def test_lazy_numbers_have_the_same_signs_at_any_precision(tree: Tree) -> None:
    tower = Tower()
    try:
        expected = tower.sign(element(tree, tower))
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
    assert tower.sign(tower.subtract(tower.add(x, y), tower.add(y, x))) == 0
    assert tower.sign(tower.subtract(tower.multiply(x, y), tower.multiply(y, x))) == 0
    assert tower.sign(tower.add(x, tower.negate(x))) == 0
    assert tower.sign(tower.subtract(x, y)) == -tower.sign(tower.subtract(y, x))
    assert tower.sign(tower.multiply(x, y)) == tower.sign(x) * tower.sign(y)
    if tower.sign(y):
        assert tower.sign(tower.subtract(tower.multiply(tower.multiply(x, tower.invert(y)), y), x)) == 0


@given(rationals, rationals, st.integers(1, 30), st.integers(1, 30))
def test_roots_of_perfect_squares_are_found_equal(a: Fraction, b: Fraction, m: int, n: int) -> None:
    """(a + b sqrt(m))^2 has the root |a + b sqrt(m)|, which the tower may write as a new root: the difference is 0."""
    tower = Tower()
    base = tower.add(fmpq(a.numerator, a.denominator), tower.multiply(fmpq(b.numerator, b.denominator), root(tower, m)))
    base = tower.add(base, root(tower, n))
    if tower.sign(base) == 0:
        return
    again = tower.sqrt(tower.multiply(base, base))
    size = base if tower.sign(base) > 0 else tower.negate(base)
    assert tower.sign(tower.subtract(again, size)) == 0
    assert tower.sign(again) == 1


def test_the_root_of_a_sum_of_roots() -> None:
    """sqrt(5 + 2 sqrt(6)) = sqrt(2) + sqrt(3), whichever comes first."""
    for order in ((2, 3, 6), (6, 3, 2), (3, 6, 2)):
        tower = Tower()
        roots = {square: root(tower, square) for square in order}
        nested = tower.sqrt(tower.add(fmpq(5), tower.multiply(fmpq(2), roots[6])))
        difference = tower.subtract(nested, tower.add(roots[2], roots[3]))
        assert tower.sign(difference) == 0
        tiny = fmpq(1, 10**300)
        assert tower.sign(tower.add(difference, tiny)) == 1
        assert tower.sign(tower.subtract(difference, tiny)) == -1


def test_a_root_that_depends_on_others() -> None:
    tower = Tower()
    assert tower.sign(tower.subtract(tower.multiply(root(tower, 2), root(tower, 3)), root(tower, 6))) == 0
    assert tower.sign(tower.subtract(root(tower, 8), tower.multiply(fmpq(2), root(tower, 2)))) == 0
    # sqrt(2) + sqrt(5 - 2 sqrt(6)) = sqrt(3), and its inverse is that of sqrt(3).
    inner = tower.sqrt(tower.subtract(fmpq(5), tower.multiply(fmpq(2), root(tower, 6))))
    total = tower.add(root(tower, 2), inner)
    assert tower.sign(tower.subtract(total, root(tower, 3))) == 0
    assert tower.sign(tower.subtract(tower.multiply(fmpq(3), tower.invert(total)), root(tower, 3))) == 0


def test_division_where_the_conjugate_is_zero() -> None:
    """The number sqrt(2) sqrt(3) + sqrt(6) is 2 sqrt(6), but a - b sqrt(D) of its form is 0: so is the norm."""
    tower = Tower()
    product = tower.multiply(root(tower, 2), root(tower, 3))
    x = tower.add(product, root(tower, 6))
    assert not isinstance(x, fmpq)
    assert tower.sign(tower.norm(x)) == 0
    assert tower.sign(x) == 1
    assert tower.sign(tower.subtract(tower.multiply(x, tower.invert(x)), fmpq(1))) == 0
    assert tower.sign(tower.subtract(tower.multiply(x, x), fmpq(24))) == 0
    zero = tower.subtract(product, root(tower, 6))
    assert not isinstance(zero, fmpq)
    with pytest.raises(ZeroDivisionError):
        tower.invert(zero)
    with pytest.raises(ZeroDivisionError):
        tower.invert(fmpq(0))


def test_squares_are_no_new_roots() -> None:
    tower = Tower()
    assert root(tower, 9) == fmpq(3)
    assert root(tower, fmpq(4, 25)) == fmpq(2, 5)
    assert root(tower, 0) == fmpq(0)
    assert tower.roots == []
    first, second = root(tower, 7), root(tower, 7)
    assert len(tower.roots) == 1
    assert tower.sign(tower.subtract(first, second)) == 0


def test_the_root_of_what_is_zero_in_another_form() -> None:
    tower = Tower()
    zero = tower.subtract(tower.multiply(root(tower, 2), root(tower, 3)), root(tower, 6))
    assert tower.sign(tower.sqrt(zero)) == 0


def test_numbers_that_nearly_agree() -> None:
    """Sums of roots that differ in the 40th digit only are told apart, by the ball and exactly."""
    tower = Tower()
    almost = fmpq(1414213562373095048801688724209698078569, 10**39)
    assert tower.sign(tower.subtract(root(tower, 2), almost)) == 1
    assert tower.sign(tower.subtract(root(tower, 2), almost + fmpq(1, 10**39))) == -1
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
        tower.multiply(long, long)
    number_ = Lazy.rational(tower, long) * Lazy.rational(tower, long) - Lazy.rational(tower, long * long)
    with pytest.raises(TooLargeError):
        number_.sign()
    monkeypatch.undo()
    assert number_.sign() == 0


def test_work_ends_with_the_budget() -> None:
    """The inverse of a sum of n roots takes four times as long with every root: without a budget 16 take hours."""
    tower = Tower()
    total: exact.Element = fmpq(0)
    for square in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53):
        total = tower.add(total, root(tower, square))
    with pytest.raises(TooLargeError):
        tower.invert(total)
    # Nothing more after that, however little.
    with pytest.raises(TooLargeError):
        tower.add(fmpq(1), fmpq(1))
    assert Tower().add(fmpq(1), fmpq(1)) == 2


def test_a_sum_or_product_takes_what_its_bits_are() -> None:
    tower = Tower(2 * exact.OPERATION + 4 + 8)
    assert tower.multiply(fmpq(3), fmpq(5)) == 15
    assert tower.add(fmpq(100), fmpq(100, 1)) == 200
    assert tower.budget == 0
    with pytest.raises(TooLargeError):
        tower.negate(fmpq(1))
