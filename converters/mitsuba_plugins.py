"""What stock Mitsuba plugins cannot say: Phong's model with a mirror, lights without falloff, a frustum.

Mitsuba's classes belong to a variant, so the plugins are made and registered for the variant that is set: call
`register()` after every `mitsuba.set_variant`.

All of them keep Mitsuba's unit of light, in which the stock `diffuse` reflects reflectance / pi: `whitted_point` emits
pi times the specification's intensity, and `whitted_phong` divides by pi. So both work beside stock plugins.
"""

# Mitsuba calls the methods with fixed arguments, needed or not.
# ruff: noqa: ARG002

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Iterator
from typing import Any

#: The names under which `register` makes the plugins known, for scene files.
PHONG = "whitted_phong"
POINT = "whitted_point"
FRUSTUM = "whitted_frustum"
AMBIENT = "whitted_ambient"
EVERYWHERE = "whitted_everywhere"

#: What a light of intensity 1 sends in Mitsuba's unit.
LIGHT_SCALE = math.pi


def register() -> None:
    """Make the plugins known to the variant of Mitsuba that is set.

    Raises:
        RuntimeError: no variant is set.
    """
    import mitsuba as mi

    current = mi.variant()
    if current is None:
        raise RuntimeError("no variant of Mitsuba is set: call mitsuba.set_variant before register")
    phong, point, frustum, ambient, everywhere = _classes(current)
    mi.register_bsdf(PHONG, phong)
    mi.register_emitter(POINT, point)
    mi.register_sensor(FRUSTUM, frustum)
    mi.register_bsdf(AMBIENT, ambient)
    mi.register_emitter(EVERYWHERE, everywhere)


@contextlib.contextmanager
def variant(name: str) -> Iterator[None]:
    """Set a variant of Mitsuba with the plugins registered, quiet, and set the former one again at the end."""
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant(name)
    # Standard output is for data: what goes wrong is raised as an exception anyway.
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        register()
        yield
    finally:
        mi.set_log_level(level)
        if before is not None and before != name:
            mi.set_variant(before)


@functools.cache
def _classes(name: str) -> tuple[Any, Any, Any, Any, Any]:
    """The classes of one variant, whose bases belong to it."""
    import drjit as dr
    import mitsuba as mi

    assert mi.variant() == name

    class Phong(mi.BSDF):  # type: ignore[misc]
        """Diffuse, specular and mirror terms of the specification, the same on both sides of the surface.

        Parameters: `diffuse` (rgb, Kd times the colour), `specular` (Ks), `exponent` (n), `mirror` (Kr). A term whose
        parameter is absent has no lobe. The value includes the cosine of the diffuse term; the specular term has none.
        """

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [
                lobe | both
                for name, lobe in (
                    ("diffuse", mi.BSDFFlags.DiffuseReflection),
                    ("specular", mi.BSDFFlags.GlossyReflection),
                    ("mirror", mi.BSDFFlags.DeltaReflection),
                )
                if name in props
            ]
            self.has_mirror = "mirror" in props
            self.m_flags = functools.reduce(lambda a, b: a | b, self.m_components, both)
            self.diffuse = mi.Color3f(props.get("diffuse", mi.ScalarColor3f(0.0)))
            self.specular = mi.Float(props.get("specular", 0.0))
            self.exponent = mi.Float(props.get("exponent", 1.0))
            self.mirror = mi.Float(props.get("mirror", 0.0))
            # Opaque: the numbers stay out of the compiled kernels, which then serve every scene.
            dr.make_opaque(self.diffuse, self.specular, self.exponent, self.mirror)

        def _enabled(self, ctx: Any, lobe: Any) -> bool:
            # Whether this surface has the lobe plays no part in `eval`: its coefficient is 0 then. So all surfaces run
            # the same code, which is compiled once.
            return bool(ctx.is_enabled(lobe))

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """(Kd O (N.L) + Ks (R.V)^n) / pi where N.L > 0, N on the side of V."""
            wi = si.wi
            side = dr.select(wi.z < 0, -1.0, 1.0)
            cosine = wo.z * side
            value = mi.Color3f(0.0)
            if self._enabled(ctx, mi.BSDFFlags.DiffuseReflection):
                value += self.diffuse * cosine
            if self._enabled(ctx, mi.BSDFFlags.GlossyReflection):
                # R = 2 (N.L) N - L is (-x, -y, z) of L in the frame whose z axis is N.
                r_dot_v = wo.z * wi.z - wo.x * wi.x - wo.y * wi.y
                # A power of zero would be nan for n = 0 where R.V is not positive: it is not used there.
                power = dr.power(dr.select(r_dot_v > 0, r_dot_v, 1.0), self.exponent)
                value += dr.select(r_dot_v > 0, self.specular * power, 0.0)
            return dr.select(active & (cosine > 0), value * dr.inv_pi, 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            """The mirror direction: the only lobe that makes rays."""
            mirrors = self._enabled(ctx, mi.BSDFFlags.DeltaReflection) and self.has_mirror
            bs = mi.BSDFSample3f(mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z))
            bs.eta = 1.0
            bs.pdf = dr.select(mi.Bool(active) & mirrors, mi.Float(1.0), 0.0)
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DeltaReflection)
            bs.sampled_component = mi.UInt32(len(self.m_components) - 1 if mirrors else 0)
            return bs, dr.select(mi.Bool(active) & mirrors, mi.Color3f(self.mirror), 0.0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """A given direction is never sampled."""
            return mi.Float(0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), mi.Float(0.0)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            return self.diffuse

        def traverse(self, cb: Any) -> None:
            for name in ("diffuse", "specular", "exponent", "mirror"):
                cb.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"{PHONG}[{self.diffuse}, {self.specular}, {self.exponent}, {self.mirror}]"

    class Ambient(Phong):
        """The ambient term in the light of `whitted_everywhere`, and the mirror: `diffuse` is Ka times the colour."""

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """The same from everywhere, on both sides."""
            return dr.select(active, self.diffuse * dr.inv_pi, 0.0)

    class Everywhere(mi.Emitter):  # type: ignore[misc]
        """A light for the ambient term: of the same `intensity` everywhere, hidden by nothing."""

        def __init__(self, props: Any) -> None:
            mi.Emitter.__init__(self, props)
            self.intensity = mi.Color3f(props["intensity"])
            self.m_flags = +mi.EmitterFlags.DeltaPosition
            dr.make_opaque(self.intensity)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            ds = mi.DirectionSample3f()
            # It stands nowhere: no comparison lets a ray that leads there hit anything.
            ds.p = mi.Point3f(math.nan)
            ds.n = mi.Normal3f(0.0)
            ds.uv = mi.Point2f(0.0)
            ds.time = it.time
            ds.pdf = mi.Float(1.0)
            ds.delta = mi.Bool(True)
            ds.d = mi.Vector3f(it.n)
            ds.dist = mi.Float(1.0)
            ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
            return ds, dr.select(active, mi.Color3f(self.intensity), 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Color3f(self.intensity)

        def eval(self, si: Any, active: Any = True) -> Any:
            """It is never hit."""
            return mi.Color3f(0.0)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(0.0))

        def traverse(self, cb: Any) -> None:
            cb.put("intensity", self.intensity, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"{EVERYWHERE}[{self.intensity}]"

    class Point(mi.Emitter):  # type: ignore[misc]
        """A point light whose irradiance is `intensity` at any distance. Parameters: `position`, `intensity` (rgb)."""

        def __init__(self, props: Any) -> None:
            mi.Emitter.__init__(self, props)
            self.position = mi.Point3f(props["position"])
            self.intensity = mi.Color3f(props["intensity"])
            self.m_flags = +mi.EmitterFlags.DeltaPosition
            dr.make_opaque(self.position, self.intensity)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            ds = mi.DirectionSample3f()
            ds.p = self.position
            ds.n = mi.Normal3f(0.0)
            ds.uv = mi.Point2f(0.0)
            ds.time = it.time
            ds.pdf = mi.Float(1.0)
            ds.delta = mi.Bool(True)
            ds.d = ds.p - it.p
            ds.dist = dr.norm(ds.d)
            ds.d = dr.select(ds.dist > 0, ds.d / ds.dist, 0.0)
            ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
            return ds, dr.select(active, mi.Color3f(self.intensity), 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Color3f(self.intensity)

        def eval(self, si: Any, active: Any = True) -> Any:
            """A point is never hit."""
            return mi.Color3f(0.0)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(self.position))

        def traverse(self, cb: Any) -> None:
            cb.put("position", self.position, mi.ParamFlags.NonDifferentiable)
            cb.put("intensity", self.intensity, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"{POINT}[{self.position}, {self.intensity}]"

    class Frustum(mi.Sensor):  # type: ignore[misc]
        """The specification's camera: any window of the plane z = -near, seen from the origin; pixels of any shape.

        Parameters: `near`, `left`, `right`, `bottom`, `top`, for rays through pixel centres.
        """

        def __init__(self, props: Any) -> None:
            mi.Sensor.__init__(self, props)
            near, left, right, bottom, top = (props[name] for name in ("near", "left", "right", "bottom", "top"))
            self.corner = mi.Vector3f(left, top, -near)
            self.size = mi.Vector2f(right - left, bottom - top)
            dr.make_opaque(self.corner, self.size)

        def sample_ray(self, time: Any, wavelengths: Any, position: Any, aperture: Any, active: Any = True) -> Any:
            """A ray that starts on the image plane: only what lies behind it is seen."""
            offset = position * self.size
            d = self.corner + mi.Vector3f(offset.x, offset.y, 0.0)
            ray = mi.Ray3f(mi.Point3f(d), dr.normalize(d), time, [])
            return ray, mi.Color3f(1.0)

        def sample_ray_differential(
            self, time: Any, wavelengths: Any, position: Any, aperture: Any, active: Any = True
        ) -> Any:
            ray, weight = self.sample_ray(time, wavelengths, position, aperture, active)
            return mi.RayDifferential3f(ray), weight

        def needs_aperture_sample(self) -> bool:
            return False

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(0.0))

        def to_string(self) -> str:
            return f"{FRUSTUM}[{self.corner}, {self.size}]"

    return Phong, Point, Frustum, Ambient, Everywhere
