"""Real numbers made of rationals by + - * / and square roots, with their exact sign.

A `Lazy` number carries a ball that holds it and the way it was made. Its sign is that of the ball where the ball does
not hold 0. Otherwise the number is worked out exactly, in a tower of fields Q(sqrt(D1))(sqrt(D2))...: an element of a
level is a + b sqrt(D) with a, b and D of lower levels; the sign of that follows from those of a, b and a^2 - b^2 D.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from flint import arb, fmpq


class TooLargeError(ArithmeticError):
    """An exact number has grown beyond `LARGEST` bits, or work with such numbers beyond its budget."""


#: Bits of a rational in an exact number: 100 times what a tie behind three mirrors takes, and still done in seconds.
LARGEST = 1 << 22
#: What a sum or product of rationals costs however short they are, in bits that could be worked out instead.
OPERATION = 128
#: Bits of all sums and products that a question about a pixel may take, the outcomes of its ties included; the court,
#: which asks many about one pixel, has one budget for all of them. A bit takes 3 to 10 ns where
#: rationals have thousands of bits, and 95 ns where they have `LARGEST`: so exact work ends after three seconds, at
#: worst after half a minute. Of 26 000 pixels of the bundled scenes, the lines of symmetry among them, and of those of
#: the tests none takes more than a thousandth. Two spheres that a ray hits at the same t behind three mirrors, by
#: symmetry and three roots deep, take a fifth; every further mirror takes 10 to 30 times as much.
BUDGET = 1 << 28


class Root:
    """The square root of a positive element that is no square, and its place in the tower."""

    __slots__ = ("level", "square")

    def __init__(self, square: Element, level: int) -> None:
        """`level` is above all in `square`."""
        self.square, self.level = square, level


class Surd:
    """a + b sqrt(D), b not 0; a and b of lower levels than sqrt(D)."""

    __slots__ = ("a", "b", "root")

    def __init__(self, a: Element, b: Element, root: Root) -> None:
        """No reduction: use `_surd`."""
        self.a, self.b, self.root = a, b, root


Element: TypeAlias = fmpq | Surd


class Tower:
    """Arithmetic of elements. Every root gets a level of its own, in the order in which they are met.

    A number of k levels has 2^k rationals, and a sign or an inverse doubles their bits at every level on the way down:
    so the bits of all sums and products are counted, and where there are more than the budget all further work raises
    TooLargeError.
    """

    def __init__(self, budget: int = BUDGET) -> None:
        """Q alone; `budget`: bits of sums and products that are left to it."""
        self.roots: list[Root] = []
        self.budget = budget

    def sqrt(self, square: Element) -> Element:
        """The root of an element that is not negative."""
        if self.sign(square) == 0:
            return fmpq(0)
        if isinstance(square, fmpq):
            p, q = square.p, square.q
            root_p, root_q = p.isqrt(), q.isqrt()
            if root_p * root_p == p and root_q * root_q == q:
                return fmpq(root_p, root_q)
        for known in self.roots:
            if _is_zero(self.subtract(known.square, square)):
                return Surd(fmpq(0), fmpq(1), known)
        root = Root(square, 1 + len(self.roots))
        self.roots.append(root)
        return Surd(fmpq(0), fmpq(1), root)

    def add(self, x: Element, y: Element) -> Element:
        """The sum."""
        if isinstance(x, fmpq) and isinstance(y, fmpq):
            return self._paid(x + y)
        if _top(x) < _top(y):
            x, y = y, x
        assert isinstance(x, Surd)
        if isinstance(y, Surd) and y.root is x.root:
            return _surd(self.add(x.a, y.a), self.add(x.b, y.b), x.root)
        return Surd(self.add(x.a, y), x.b, x.root)

    def negate(self, x: Element) -> Element:
        """-x."""
        return self._paid(-x) if isinstance(x, fmpq) else Surd(self.negate(x.a), self.negate(x.b), x.root)

    def subtract(self, x: Element, y: Element) -> Element:
        """The difference."""
        return self.add(x, self.negate(y))

    def multiply(self, x: Element, y: Element) -> Element:
        """The product."""
        if isinstance(x, fmpq) and isinstance(y, fmpq):
            return self._paid(x * y)
        if _is_zero(x) or _is_zero(y):
            return fmpq(0)
        if _top(x) < _top(y):
            x, y = y, x
        assert isinstance(x, Surd)
        if isinstance(y, Surd) and y.root is x.root:
            a = self.add(self.multiply(x.a, y.a), self.multiply(self.multiply(x.b, y.b), x.root.square))
            return _surd(a, self.add(self.multiply(x.a, y.b), self.multiply(x.b, y.a)), x.root)
        return _surd(self.multiply(x.a, y), self.multiply(x.b, y), x.root)

    def divide(self, x: Element, y: Element) -> Element:
        """The quotient."""
        return self.multiply(x, self.invert(y))

    def invert(self, x: Element) -> Element:
        """1 / x.

        Raises:
            ZeroDivisionError: x is 0.
        """
        if isinstance(x, fmpq):
            return 1 / x
        norm = self.norm(x)
        if self.sign(norm) == 0:
            # a^2 = b^2 D: either x = 0, or a = b sqrt(D) and x = 2 a.
            if self.sign(x) == 0:
                raise ZeroDivisionError
            return self.invert(self.multiply(fmpq(2), x.a))
        inverse = self.invert(norm)
        return _surd(self.multiply(x.a, inverse), self.negate(self.multiply(x.b, inverse)), x.root)

    def norm(self, x: Surd) -> Element:
        """(a + b sqrt(D)) (a - b sqrt(D))."""
        return self.subtract(self.multiply(x.a, x.a), self.multiply(self.multiply(x.b, x.b), x.root.square))

    def sign(self, x: Element) -> int:
        """-1, 0 or 1, exactly."""
        if isinstance(x, fmpq):
            return int(x > 0) - int(x < 0)
        a, b = self.sign(x.a), self.sign(x.b)
        if a == 0 or a == b:
            return b
        if b == 0:
            return a
        # Opposite signs: whichever of a^2 and b^2 D is larger decides.
        return a * self.sign(self.norm(x))

    def _paid(self, x: fmpq) -> fmpq:
        """A rational that was worked out, if it is within the limits."""
        bits = x.height_bits()
        self.budget -= bits + OPERATION
        if bits > LARGEST or self.budget < 0:
            raise TooLargeError
        return x


def _top(x: Element) -> int:
    return 0 if isinstance(x, fmpq) else x.root.level


def _is_zero(x: Element) -> bool:
    """Whether this form is 0 by itself; an element may be 0 in other forms, which `Tower.sign` finds."""
    return isinstance(x, fmpq) and x == 0


def _surd(a: Element, b: Element, root: Root) -> Element:
    return a if _is_zero(b) else Surd(a, b, root)


class Lazy:
    """A real number: a ball that holds it, and how to work it out exactly."""

    __slots__ = ("ball", "element", "how", "of", "tower")

    def __init__(self, tower: Tower, ball: arb, how: Callable[..., Element] | None, *of: Any) -> None:
        """`how` makes the element from those of `of`."""
        self.tower, self.ball, self.how, self.of = tower, ball, how, of
        self.element: Element | None = None

    @staticmethod
    def rational(tower: Tower, value: fmpq) -> Lazy:
        """A rational."""
        number = Lazy(tower, arb(value), None)
        number.element = value
        return number

    def _other(self, value: Any) -> Lazy:
        return value if isinstance(value, Lazy) else Lazy.rational(self.tower, fmpq(value))

    def __add__(self, other: Any) -> Lazy:
        b = self._other(other)
        return Lazy(self.tower, self.ball + b.ball, self.tower.add, self, b)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Lazy:
        b = self._other(other)
        return Lazy(self.tower, self.ball - b.ball, self.tower.subtract, self, b)

    def __rsub__(self, other: Any) -> Lazy:
        return self._other(other) - self

    def __mul__(self, other: Any) -> Lazy:
        b = self._other(other)
        return Lazy(self.tower, self.ball * b.ball, self.tower.multiply, self, b)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Lazy:
        b = self._other(other)
        return Lazy(self.tower, self.ball / b.ball, self.tower.divide, self, b)

    def __neg__(self) -> Lazy:
        return Lazy(self.tower, -self.ball, self.tower.negate, self)

    def __gt__(self, other: int) -> bool:
        """Whether it is certainly larger, by the ball alone."""
        return bool(self.ball > other)

    def __lt__(self, other: int) -> bool:
        """Whether it is certainly smaller, by the ball alone."""
        return bool(self.ball < other)

    def sqrt(self) -> Lazy:
        """The root of a number that is not negative."""
        return Lazy(self.tower, self.ball.sqrt(), self.tower.sqrt, self)

    def exact(self) -> Element:
        """The element of the tower.

        Raises:
            TooLargeError: it would be too large.
        """
        if self.element is None:
            assert self.how is not None
            self.element = self.how(*(number.exact() for number in self.of))
        return self.element

    def sign(self) -> int:
        """-1, 0 or 1, exactly.

        Raises:
            TooLargeError: it would have to be worked out exactly, and is too large for that.
        """
        if self.ball > 0:
            return 1
        if self.ball < 0:
            return -1
        try:
            return self.tower.sign(self.exact())
        except RecursionError:
            raise TooLargeError from None
