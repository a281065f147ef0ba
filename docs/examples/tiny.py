"""A ray tracer as a student may have written it: python tiny.py SCENE > image.ppm. See docs/tutorial.md."""

import math
import sys
from collections import namedtuple
from pathlib import Path

Sphere = namedtuple("Sphere", "center scale color ka kd ks kr n")
Light = namedtuple("Light", "position intensity")


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def along(origin, t, direction):
    return [o + t * d for o, d in zip(origin, direction)]


def unit(a):
    return [x / math.sqrt(dot(a, a)) for x in a]


def read(path):
    view, spheres, lights = {}, [], []
    for name, *words in filter(None, map(str.split, Path(path).read_text().splitlines())):
        if name == "SPHERE":
            v = [float(word) for word in words[1:]]
            spheres.append(Sphere(v[0:3], v[3:6], v[6:9], *v[9:14]))
        elif name == "LIGHT":
            v = [float(word) for word in words[1:]]
            lights.append(Light(v[0:3], v[3:6]))
        elif name != "OUTPUT":
            view[name] = [float(word) for word in words]
    return view, spheres, lights


def roots(origin, direction, sphere):
    """Both t at which a ray meets a sphere: the ray goes to the space in which the sphere is a unit sphere."""
    o = [(x - c) / s for x, c, s in zip(origin, sphere.center, sphere.scale)]
    d = [x / s for x, s in zip(direction, sphere.scale)]
    a, b, c = dot(d, d), dot(o, d), dot(o, o) - 1
    if b * b < a * c:
        return []
    root = math.sqrt(b * b - a * c)
    return [(-b - root) / a, (-b + root) / a]


def nearest(origin, direction, spheres, least):
    hits = [(t, sphere) for sphere in spheres for t in roots(origin, direction, sphere) if t > least]
    return min(hits, key=lambda hit: hit[0], default=None)


def color(scene, origin, direction, least, bounces):
    view, spheres, lights = scene
    hit = nearest(origin, direction, spheres, least)
    if hit is None:
        return view["BACK"] if bounces == 0 else [0, 0, 0]
    t, sphere = hit
    x = along(origin, t, direction)
    N = unit([(a - c) / s for a, c, s in zip(x, sphere.center, sphere.scale)])
    if dot(N, direction) > 0:
        N = [-a for a in N]
    V = unit([-a for a in direction])
    result = [sphere.ka * i * o for i, o in zip(view["AMBIENT"], sphere.color)]
    for light in lights:
        to_light = [a - b for a, b in zip(light.position, x)]
        if any(0.0001 < t < 1 for s in spheres for t in roots(x, to_light, s)):
            continue
        L = unit(to_light)
        NL = dot(N, L)
        if NL > 0:
            RV = max(0, 2 * NL * dot(N, V) - dot(L, V))
            highlight = sphere.ks * RV**sphere.n
            result = [
                r + i * (sphere.kd * NL * o + highlight) for r, i, o in zip(result, light.intensity, sphere.color)
            ]
    if sphere.kr > 0 and bounces < 3:
        reflected = along(direction, -2 * dot(direction, N), N)
        more = color(scene, x, reflected, 1e-6, bounces + 1)
        result = [r + sphere.kr * m for r, m in zip(result, more)]
    return result


def main():
    scene = read(sys.argv[1])
    view = scene[0]
    (near,), (left,), (right,), (bottom,), (top,) = (view[name] for name in ("NEAR", "LEFT", "RIGHT", "BOTTOM", "TOP"))
    columns, rows = map(int, view["RES"])
    image = bytearray()
    for row in range(rows):
        for column in range(columns):
            direction = [
                left + (right - left) * (column + 0.5) / columns,
                top - (top - bottom) * (row + 0.5) / rows,
                -near,
            ]
            for value in color(scene, [0, 0, 0], direction, 1, 0):
                image.append(int(255 * min(max(value, 0), 1) + 0.5))
    sys.stdout.buffer.write(b"P6\n%d %d\n255\n" % (columns, rows) + image)


main()
