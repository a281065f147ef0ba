"""The diagrams of docs/specification.md: every point in them is computed, so that they show what the page says."""

from __future__ import annotations

import math
from pathlib import Path

Point = tuple[float, float]

INK, SOFT, RED, BLUE, GREEN, GOLD = "#222", "#888", "#c0392b", "#2a6fb0", "#2e8b57", "#b8860b"
FILL = "#f3e2d3"


class Drawing:
    """An SVG of which one unit is `scale` pixels, y upwards."""

    def __init__(self, width: float, height: float, scale: float, origin: Point, title: str) -> None:
        self.scale, self.origin = scale, origin
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
            f'height="{height:g}" font-family="Helvetica, Arial, sans-serif" font-size="13" role="img">',
            f"<title>{title}</title>",
            f'<rect width="{width:g}" height="{height:g}" fill="#fff"/>',
        ]

    def at(self, point: Point) -> str:
        x, y = self.screen(point)
        return f"{x:.1f},{y:.1f}"

    def screen(self, point: Point) -> Point:
        return self.origin[0] + self.scale * point[0], self.origin[1] - self.scale * point[1]

    def line(self, *points: Point, color: str = INK, width: float = 1.5, dash: str = "", arrow: bool = False) -> None:
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        path = " ".join(self.at(point) for point in points)
        self.parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="{width:g}"{dashed}/>')
        if arrow:
            (ax, ay), (bx, by) = self.screen(points[-2]), self.screen(points[-1])
            angle = math.atan2(by - ay, bx - ax)
            corners = [(bx - 9 * math.cos(angle + turn), by - 9 * math.sin(angle + turn)) for turn in (-0.35, 0.35)]
            head = " ".join(f"{x:.1f},{y:.1f}" for x, y in ((bx, by), *corners))
            self.parts.append(f'<polygon points="{head}" fill="{color}"/>')

    def ellipse(self, center: Point, rx: float, ry: float, fill: str = FILL, color: str = INK, dash: str = "") -> None:
        x, y = self.screen(center)
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(
            f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{rx * self.scale:.1f}" ry="{ry * self.scale:.1f}" fill="{fill}" '
            f'stroke="{color}"{dashed}/>'
        )

    def dot(self, point: Point, color: str = INK, radius: float = 3.5, hollow: bool = False) -> None:
        x, y = self.screen(point)
        paint = f'fill="#fff" stroke="{color}" stroke-width="1.5"' if hollow else f'fill="{color}"'
        self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" {paint}/>')

    def text(
        self, point: Point, words: str, dx: float = 0, dy: float = 0, color: str = INK, anchor: str = "start"
    ) -> None:
        x, y = self.screen(point)
        words = words.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        self.parts.append(
            f'<text x="{x + dx:.1f}" y="{y + dy:.1f}" fill="{color}" text-anchor="{anchor}">{words}</text>'
        )

    def write(self, path: Path) -> None:
        path.write_text("\n".join([*self.parts, "</svg>", ""]), encoding="utf-8")


def add(a: Point, b: Point, t: float = 1) -> Point:
    return a[0] + t * b[0], a[1] + t * b[1]


def minus(a: Point, b: Point) -> Point:
    return add(a, b, -1)


def dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1]


def unit(a: Point) -> Point:
    length = math.hypot(*a)
    return a[0] / length, a[1] / length


def roots(origin: Point, direction: Point, center: Point, scaling: Point = (1, 1)) -> Point:
    """Both t at which a ray meets an ellipse."""
    (ox, oy), (sx, sy) = minus(origin, center), scaling
    o, d = (ox / sx, oy / sy), (direction[0] / sx, direction[1] / sy)
    a, b, c = dot(d, d), dot(o, d), dot(o, o) - 1
    root = math.sqrt(b * b - a * c)
    return (-b - root) / a, (-b + root) / a


def camera(folder: Path) -> None:
    """The frustum from the side, and the window with its pixels."""
    draw = Drawing(820, 330, 70, (40, 170), "The camera: the frustum from the side, and the window with its pixels")
    eye, near = (0.0, 0.0), 2.0
    low, high = -1.0, 1.4
    for y in (low, high):
        draw.line(eye, (near * 1.45, y * 1.45), color=SOFT, dash="4 3")
    draw.ellipse((2.55, 0.1), 1.05, 0.95)
    draw.line((near, low), (near, high), color=BLUE, width=3)
    draw.text((-0.4, 2.15), "the window: z = -NEAR, t = 1", color=BLUE)
    draw.text((near, high), "TOP", dx=-36, dy=4, color=BLUE)
    draw.text((near, low), "BOTTOM", dx=-64, dy=12, color=BLUE)
    d = (near, 0.45)
    first, second = roots(eye, d, (2.55, 0.1), (1.05, 0.95))
    draw.line(eye, add(eye, d, second), color=RED, arrow=True)
    draw.dot(add(eye, d, first), RED, hollow=True)
    draw.dot(add(eye, d, second), RED)
    draw.text(add(eye, d, second), f"t = {second:.2f}: seen,", dx=10, dy=-4, color=RED)
    draw.text(add(eye, d, second), "from inside", dx=10, dy=12, color=RED)
    draw.text((2.2, -1.75), f"hollow: t = {first:.2f} is before the window and does not count", dx=-40, dy=4, color=RED)
    draw.dot(eye)
    draw.text(eye, "eye, the origin", dx=-30, dy=36)
    draw.line((0, -1.75), (1.0, -1.75), arrow=True, color=SOFT)
    draw.text((1.0, -1.75), "-z", dx=6, dy=4, color=SOFT)

    grid = Drawing(0, 0, 60, (500, 60), "")
    grid.parts = draw.parts
    columns, rows = 4, 3
    for c in range(columns + 1):
        grid.line((c, 0), (c, -rows), color=BLUE, width=1)
    for j in range(rows + 1):
        grid.line((0, -j), (columns, -j), color=BLUE, width=1)
    grid.line((0, 0), (columns, 0), (columns, -rows), (0, -rows), (0, 0), color=BLUE, width=3)
    for c in range(columns):
        for j in range(rows):
            grid.dot((c, -j), RED)
            grid.dot((c + 0.5, -j - 0.5), GREEN, 3)
    grid.text((0, 0), "row 0", dx=-10, dy=34, anchor="end")
    grid.text((0, 0), "column 0", dx=4, dy=-12)
    grid.text((columns, 0), "RIGHT", dy=-12, color=BLUE, anchor="middle")
    grid.text((0, -rows), "LEFT", dy=22, color=BLUE, anchor="middle")
    grid.text((1, -rows), "corner, the default: ox = oy = 0", dy=22, dx=-6, color=RED)
    grid.text((1, -rows), "center: ox = oy = 0.5", dy=40, dx=-6, color=GREEN)
    draw.write(folder / "camera.svg")


def ranges(folder: Path) -> None:
    """Which t count, for the three kinds of rays."""
    draw = Drawing(
        820,
        272,
        150,
        (170, 60),
        "Which t count: primary rays above 1, shadow rays from 0.0001 to 1, reflected rays above 0",
    )
    rows = (
        ("primary ray", BLUE, 1.0, None, "t > 1: beyond the image plane"),
        ("shadow ray", RED, 0.12, 1.0, "0.0001 < t < 1: before the light"),
        ("reflected ray", GREEN, 0.0, None, "t > 0, and not the root where it starts"),
    )
    for place, (name, color, low, high, says) in enumerate(rows):
        y = -0.45 * place
        draw.line((-0.3, y), (3.9, y), color=SOFT, width=1, arrow=True)
        end = 3.75 if high is None else high
        draw.line((low, y), (end, y), color=color, width=5)
        for x in (low, high):
            if x is not None:
                draw.dot((x, y), color, 4.5, hollow=True)
        draw.text((-0.4, y), name, dy=4, anchor="end", color=color)
        draw.text((1.35, y), says, dy=-9, color=color)
    for x, label in ((0.0, "0"), (0.12, "0.0001"), (1.0, "1")):
        draw.line((x, 0.12), (x, -1.05), color=SOFT, width=0.8, dash="2 3")
        draw.text((x, -1.05), label, dy=16, dx=12 if label == "0.0001" else 0, anchor="middle")
    draw.text((0.0, -1.05), "start of the ray", dy=36, anchor="middle", color=SOFT)
    draw.text((1.0, -1.05), "image plane, or light", dy=36, anchor="middle", color=SOFT)
    draw.text((3.9, 0), "t", dx=8, dy=4)
    draw.text((-0.3, 0.22), "hollow: the end itself does not count; 0 to 0.0001 is drawn larger than it is", color=SOFT)
    draw.write(folder / "ranges.svg")


def ellipsoid(folder: Path) -> None:
    """The same ray in the world and in the space where the ellipsoid is a unit sphere."""
    draw = Drawing(
        820, 300, 66, (110, 150), "An ellipsoid in the world, and as a unit sphere: the roots t are the same"
    )
    center, s = (3.0, 0.0), (1.7, 0.8)
    origin, d = (0.2, 0.9), (1.0, -0.25)
    for shift, scaling, p, name in (
        (0.0, (1.0, 1.0), center, "world: |(x - p) / s| = 1"),
        (8.3 - center[0] / s[0] + 0.4, s, (center[0] / s[0], 0.0), "unit space: divided by s"),
    ):

        def to(point: Point, shift: float = shift, scaling: Point = scaling) -> Point:
            return point[0] / scaling[0] + shift, point[1] / scaling[1]

        draw.ellipse((p[0] + shift, 0), s[0] / scaling[0], s[1] / scaling[1])
        t0, t1 = roots(origin, d, center, s)
        hit = add(origin, d, t0)
        draw.line(to(origin), to(add(origin, d, t1 + 0.6)), color=BLUE, arrow=True)
        for t, label in ((t0, "t"), (t1, "t'")):
            draw.dot(to(add(origin, d, t)), BLUE)
            draw.text(
                to(add(origin, d, t)),
                f"{label} = {t:.2f}",
                dx=-6 if t == t0 else 6,
                dy=20 if t == t0 else -8,
                color=BLUE,
                anchor="end" if t == t0 else "start",
            )
        draw.dot((p[0] + shift, 0))
        draw.text((p[0] + shift, 0), "p", dx=7, dy=5)
        x, y = minus(hit, center)
        gradient = unit((x / s[0] ** 2, y / s[1] ** 2))
        wrong = unit((x / s[0], y / s[1]))
        if scaling == (1.0, 1.0):
            draw.line(hit, add(hit, gradient, 1.1), color=GREEN, width=2, arrow=True)
            draw.text(add(hit, gradient, 1.1), "N ~ (x - p) / s²", dx=8, dy=4, color=GREEN)
            draw.line(hit, add(hit, wrong, 0.9), color=SOFT, dash="3 3")
            draw.text(add(hit, wrong, 0.9), "(x - p) / s is no normal", dx=-6, dy=-4, color=SOFT, anchor="end")
        else:
            start = to(hit)
            draw.line(start, add(start, wrong, 0.8), color=SOFT, width=2, arrow=True)
            draw.text(add(start, wrong, 0.8), "(x - p) / s", dx=-6, dy=-6, color=SOFT, anchor="middle")
        draw.text((p[0] + shift, -1.55), name, anchor="middle")
    draw.write(folder / "ellipsoid.svg")


def phong(folder: Path) -> None:
    """N, L, R and V at a hit."""
    draw = Drawing(820, 300, 150, (400, 240), "The vectors of Phong's model at a hit: N, L, R = 2 (N.L) N - L and V")
    x = (0.0, 0.0)
    draw.ellipse((0, -3.0), 3.0, 3.0)
    N, L, V = (0.0, 1.0), unit((-0.8, 1.0)), unit((1.45, 0.75))
    R = minus((2 * dot(N, L) * N[0], 2 * dot(N, L) * N[1]), L)
    light = add(x, L, 1.75)
    draw.line(x, light, color=GOLD, width=1, dash="4 3")
    draw.dot(light, GOLD, 6)
    draw.text(light, "light p", dx=-12, dy=4, color=GOLD, anchor="end")
    for vector, name, color, anchor in (
        (N, "N", GREEN, "middle"),
        (L, "L = (p - x) / |p - x|", GOLD, "end"),
        (R, "R = 2 (N.L) N - L", RED, "start"),
        (V, "V = -d / |d|, to where the ray came from", BLUE, "start"),
    ):
        draw.line(x, add(x, vector), color=color, width=2, arrow=True)
        draw.text(
            add(x, vector), name, dx={"middle": 0, "end": -12, "start": 8}[anchor], dy=-6, color=color, anchor=anchor
        )
    for first, second, radius, label, color in (
        (N, L, 0.36, f"N.L = {dot(N, L):.2f}", GOLD),
        (R, V, 0.5, f"R.V = {dot(R, V):.2f}", RED),
    ):
        a, b = math.atan2(first[1], first[0]), math.atan2(second[1], second[0])
        arc = [add(x, (math.cos(a + (b - a) * k / 12), math.sin(a + (b - a) * k / 12)), radius) for k in range(13)]
        draw.line(*arc, color=color, width=1)
        draw.text(
            arc[6], label, dx=-10 if first == N else 8, dy=-4, color=color, anchor="end" if first == N else "start"
        )
    draw.dot(x)
    draw.text(x, "x", dx=-4, dy=20)
    draw.text((0, -0.32), "diffuse ~ N.L        specular ~ (R.V)^n, where N.L > 0 and R.V > 0", anchor="middle")
    draw.write(folder / "phong.svg")


def shadow(folder: Path) -> None:
    """What hides a light and what does not."""
    draw = Drawing(
        820, 350, 62, (30, 230), "Shadow rays: hidden by what is between t = 0.0001 and t = 1, the own sphere included"
    )
    p = (7.2, 2.4)
    own, blocker, beyond = (2.2, -0.4), (4.9, 1.0), (9.0, 2.9)
    draw.ellipse(own, 1.3, 1.3)
    draw.ellipse(blocker, 0.55, 0.55)
    draw.ellipse(beyond, 0.6, 0.6, fill="#eee", color=SOFT)
    draw.text(beyond, "beyond the light:", dy=62, anchor="middle", color=SOFT)
    draw.text(beyond, "hides nothing", dy=78, anchor="middle", color=SOFT)
    for angle, label, hidden_by in ((100, "x", None), (45, "x'", blocker), (245, "x''", own)):
        turn = math.radians(angle)
        x = add(own, (math.cos(turn), math.sin(turn)), 1.3)
        to = minus(p, x)
        draw.dot(x)
        if hidden_by is None:
            draw.line(x, p, color=GREEN, arrow=True)
        else:
            radius = 0.55 if hidden_by is blocker else 1.3
            t0, t1 = roots(x, to, hidden_by, (radius, radius))
            t = t0 if t0 > 1e-4 else t1
            draw.line(x, add(x, to, t), color=RED, width=2)
            draw.line(add(x, to, t), p, color=RED, width=1, dash="4 3")
            draw.dot(add(x, to, t), RED)
            draw.text(
                add(x, to, t),
                f"t = {t:.2f}",
                dx=10 if hidden_by is own else -8,
                dy=16 if hidden_by is own else -10,
                color=RED,
                anchor="start" if hidden_by is own else "end",
            )
        draw.text(x, label, dx=-14, dy=6)
    draw.dot(p, GOLD, 6)
    draw.text(p, "light p, t = 1", dx=-10, dy=-12, color=GOLD, anchor="end")
    draw.text((4.6, -0.8), "the shadow ray: x + t (p - x)")
    draw.text((4.6, -0.8), "x sees the light; a sphere hides it from x';", dy=22)
    draw.text((4.6, -0.8), "x'' is on the far side: its own sphere hides it", dy=42)
    draw.write(folder / "shadow.svg")


def mirrors(folder: Path) -> None:
    """A chain of three reflected rays between two mirrors."""
    draw = Drawing(820, 365, 90, (60, 140), "A chain of three reflected rays between two mirrors")
    spheres = [((3.6, 13.2), 12.0, "A"), ((3.6, -13.2), 12.0, "B")]
    for center, radius, name in spheres:
        side = math.copysign(1, center[1])
        turns = [math.asin(x / radius) for x in (-3.9 + 0.3 * k for k in range(27))]
        edge = [add(center, (math.sin(turn), -side * math.cos(turn)), radius) for turn in turns]
        draw.line(*edge, width=2)
        draw.text((3.6, side * 1.35), f"mirror {name}", dy=4, anchor="middle")
    origin, d, own = (0.0, 0.1), unit((1.15, 1.1)), -1
    draw.dot(origin)
    draw.text(origin, "eye", dy=22, anchor="middle")
    labels = ("primary ray", "reflection.1: times Kr of A", "reflection.2: Kr A Kr B", "reflection.3: Kr A Kr B Kr A")
    for bounce in range(4):
        hits = []
        for index, (center, radius, _) in enumerate(spheres):
            if index == own:
                continue
            try:
                hits.append((roots(origin, d, center, (radius, radius))[0], index))
            except ValueError:
                continue
        hits = [hit for hit in hits if hit[0] > 0]
        color = (BLUE, GREEN, GOLD, RED)[bounce]
        if not hits:
            draw.line(origin, add(origin, d, 2.2), color=color, arrow=True)
            draw.text(add(origin, d, 1.2), "hits nothing: black", dx=8, color=color)
            break
        t, own = min(hits)
        x = add(origin, d, t)
        draw.line(origin, x, color=color, width=2, arrow=True)
        draw.dot(x, color)
        draw.text((4.0 * (bounce % 2), -2.15), labels[bounce], dy=22 * (bounce // 2), color=color)
        normal = unit(minus(x, spheres[own][0]))
        draw.line(x, add(x, normal, 0.45), color=SOFT, width=1, dash="3 2")
        origin, d = x, add(d, normal, -2 * dot(d, normal))
    else:
        draw.line(origin, add(origin, d, 0.5), color=SOFT, dash="3 3")
        draw.text(add(origin, d, 0.5), "a fourth is not sent", dx=8, color=SOFT)
    draw.write(folder / "mirrors.svg")


def main(folder: Path) -> None:
    """Draw all."""
    for figure in (camera, ranges, ellipsoid, phong, shadow, mirrors):
        figure(folder)


if __name__ == "__main__":
    main(Path(__file__).parent / "figures")
