// The Whitted recursion over packets of rays, in the words of the specification. Included by kernel_*.cpp only.
//
// All lanes of a packet march through their chain of mirrors together. At each bounce the lanes are taken sphere by
// sphere, so that everything about the sphere that is shaded is a constant. In a sphere's unit space, (x - p)/|s|, the
// sphere is the unit sphere, and a hit is its point n there, |n| = 1.
#pragma once

#include <type_traits>

#include "constants.hpp"
#include "power.hpp"
#include "simd.hpp"

namespace whitted {
namespace {

// Register: its bytes, so that no two instruction sets have functions of one name.
template <class Real, int Width, int Register = register_bytes>
struct Kernel {
    using P = Packet<Real, Width>;
    using Lanes = Mask<Real, Width>;

    static constexpr Real zero = 0;
    static constexpr Real one = 1;
    static constexpr Real unit_roundoff = sizeof(Real) == 8 ? Real(0x1p-53) : Real(0x1p-24);
    // The rounding bound of D and of f(1), and a bound above that of D that is cheap: 64 u max(1, |origin|).
    // docs/tolerances.md, section 2.
    static constexpr Real tangent_roundings = 16 * unit_roundoff;
    static constexpr Real touch_reach = 64 * unit_roundoff;
    // Beyond this the digits of D are lost anyway; without it a far, small sphere would grow without end.
    static constexpr Real widest_touch = Real(0.5);
    // Far above all that underflows where there is something to cut.
    static constexpr Real underflow = sizeof(Real) == 8 ? Real(1e-200) : Real(1e-30f);

    struct Vec {
        P x, y, z;
        friend WHITTED_INLINE Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
        friend WHITTED_INLINE Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
        friend WHITTED_INLINE Vec operator*(Vec a, Vec b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
        friend WHITTED_INLINE Vec operator*(Vec a, P s) { return {a.x * s, a.y * s, a.z * s}; }
        WHITTED_INLINE Vec operator-() const { return {-x, -y, -z}; }
    };
    static WHITTED_INLINE P dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
    static WHITTED_INLINE Vec absolute3(Vec a) { return {absolute(a.x), absolute(a.y), absolute(a.z)}; }
    static WHITTED_INLINE Vec select3(Lanes yes, Vec a, Vec b) {
        return {select(yes, a.x, b.x), select(yes, a.y, b.y), select(yes, a.z, b.z)};
    }
    static WHITTED_INLINE double least(P v) {
        Real lanes[Width];
        v.store(lanes);
        for (int half = Width / 2; half > 0; half /= 2)
            for (int k = 0; k < half; ++k) lanes[k] = lanes[k + half] < lanes[k] ? lanes[k + half] : lanes[k];
        return double(lanes[0]);
    }
    static WHITTED_INLINE Vec broadcast(const Real *v) { return {P(v[0]), P(v[1]), P(v[2])}; }

    // The nearest hit of each lane's ray.
    struct Hit {
        P sphere;  // its place among the existing spheres; -1: none
        P t;
        Vec n;         // the point in the sphere's unit space
        Lanes inside;  // hit on its way out: the inside is what is seen
    };

    // Where a ray meets the unit sphere: t^2 a + 2 t h + c = 0.
    struct Roots {
        Lanes real;
        P near_t, far_t;
        P half_chord;  // (far_t - near_t)/2
        Vec closest;   // the ray's point closest to the centre
    };

    // Rays whose D is below 0 by no more than its rounding bound, 16 u (1 + sum |l_k| (|o_k| + |h a_k|)): they touch.
    static WHITTED_LARGE Lanes touching(P D, Vec o, Vec closest, Vec along) {
        const P sum = absolute(closest.x) * (absolute(o.x) + absolute(along.x)) +
                      absolute(closest.y) * (absolute(o.y) + absolute(along.y)) +
                      absolute(closest.z) * (absolute(o.z) + absolute(along.z));
        return -D <= P(tangent_roundings) * (P(one) + sum);
    }

    // c = |o|^2 - 1. steep: of the sphere. reach_squared: the square of a bound above that of touching().
    static WHITTED_INLINE Roots intersect(Vec o, P c, Vec d, bool steep, P reach_squared) {
        const P a = dot(d, d);
        const P h = dot(o, d);
        const P inverse_a = P(one) / a;
        const Vec along = d * (h * inverse_a);
        Vec closest = o - along;
        // What the roundings of h/a have left along the ray: 3 u |o|, whose square would tell in D.
        if (steep) [[unlikely]]
            closest = closest - d * (dot(closest, d) * inverse_a);
        const P D = P(one) - dot(closest, closest);
        Lanes real = D > P(zero);
        const Lanes near_zero = (!real) & (D * D <= reach_squared);
        if (any(near_zero)) real = real | (near_zero & touching(D, o, closest, along));
        const P root = sqrt(maximum(D, P(zero)) * a);
        const Lanes leaving = h > P(zero);
        const P q = select(leaving, -(h + root), root - h);
        const P first = q * inverse_a;
        const P second = c / q;
        return {real, select(leaving, first, second), select(leaving, second, first), root * inverse_a, closest};
    }

    // The hit point of the near or the far root, from the point closest to the centre: exact for a tangent.
    static WHITTED_INLINE Vec unit_point(const Roots &roots, Vec d, Lanes far) {
        return roots.closest + d * select(far, roots.half_chord, -roots.half_chord);
    }

    static WHITTED_INLINE void keep_nearer(Hit &nearest, Lanes hit, P t, P sphere, Vec n, Lanes inside) {
        nearest.sphere = select(hit, sphere, nearest.sphere);
        nearest.t = select(hit, t, nearest.t);
        nearest.n = select3(hit, n, nearest.n);
        nearest.inside = select(hit, inside, nearest.inside);
    }

    static WHITTED_INLINE Hit no_hit() { return {P(-one), P(Real(__builtin_inf())), broadcast_zero(), Lanes::none()}; }
    static WHITTED_INLINE Vec broadcast_zero() { return {P(zero), P(zero), P(zero)}; }

    // The image plane, at the ray's point y = eye + d: a root of f = |y|^2 - 1 within its rounding bound of t = 1 is 1,
    // so it does not count. It is the near root where the ray runs inwards there, y.d < 0, else the far one.
    static WHITTED_LARGE void settle_plane(const SphereConstants<Real> &sphere, Vec d, Roots &roots) {
        const Vec y = broadcast(sphere.eye) + d;
        const Vec size = absolute3(y);
        const Vec reach = absolute3(d) + broadcast(sphere.plane_reach);
        const P bound = P(tangent_roundings) * (P(one) + dot(size, reach));
        const Lanes on = absolute(dot(y, y) - P(one)) <= minimum(bound, P(widest_touch));
        if (!any(on)) return;
        const Lanes inwards = dot(y, d) < -(P(tangent_roundings) * dot(size + absolute3(d), reach));
        roots.near_t = select(on, P(one), roots.near_t);
        roots.far_t = select(on & !inwards, P(one), roots.far_t);
    }

    // The primary hits of a span: planes as of Hit.
    struct Hits {
        static constexpr std::size_t size = widest_span<Real> + widest_packet;
        alignas(64) Real sphere[size];
        alignas(64) Real t[size];
        alignas(64) Real x[size];
        alignas(64) Real y[size];
        alignas(64) Real z[size];
        alignas(64) Real inside[size];  // 1 or 0

        WHITTED_INLINE Vec point(std::size_t at) const { return {P::load(x + at), P::load(y + at), P::load(z + at)}; }
        WHITTED_INLINE Hit load(std::size_t at) const {
            return {P::load(sphere + at), P::load(t + at), point(at), P::load(inside + at) > P(zero)};
        }
    };

    // The packets of a span that an outline reaches into.
    struct Reach {
        std::size_t begin, end;  // places in the span, multiples of Width from the first on
    };
    static WHITTED_INLINE Reach reach(const Outline &outline, const Span<Real> &span) {
        const std::int64_t begin = outline.begin - span.column;
        const std::int64_t end = outline.end - span.column;
        const std::int64_t count = static_cast<std::int64_t>(span.count);
        return {begin <= 0 ? 0 : static_cast<std::size_t>(begin) / Width * Width,
                end <= 0 ? 0 : static_cast<std::size_t>(end < count ? end : count)};
    }

    // Primary rays: the smallest t > 1; of equal ones the first in the file.
    static WHITTED_LARGE void first_hits(const SceneConstants<Real> &scene, const Span<Real> &span, Hits &hits) {
        for (std::size_t at = 0; at < span.count; at += Width) {
            P(-one).store(hits.sphere + at);
            P(Real(__builtin_inf())).store(hits.t + at);
            P(zero).store(hits.x + at);
            P(zero).store(hits.y + at);
            P(zero).store(hits.z + at);
            P(zero).store(hits.inside + at);
        }
        for (std::size_t k = 0; k < span.outline_count; ++k) {
            const Reach part = reach(span.outlines[k], span);
            const SphereConstants<Real> &sphere = scene.spheres[span.outlines[k].sphere];
            const P place = Real(span.outlines[k].sphere);
            const Vec inverse_scale = broadcast(sphere.inverse_scale);
            const Vec eye = broadcast(sphere.eye);
            const P c(sphere.eye_power);
            const P squared_reach = reach_squared(P(sphere.eye_distance_squared));
            const P d_y = P(span.direction_y) * inverse_scale.y;
            const P d_z = P(span.direction_z) * inverse_scale.z;
            for (std::size_t at = part.begin; at < part.end; at += Width) {
                const Vec d{P::load(span.direction_x + at) * inverse_scale.x, d_y, d_z};
                Roots roots = intersect(eye, c, d, sphere.steep, squared_reach);
                if (!any(roots.real)) continue;
                if (sphere.meets_plane) [[unlikely]]
                    settle_plane(sphere, d, roots);
                const Lanes far = !(roots.near_t > P(one));
                const P t = select(far, roots.far_t, roots.near_t);
                const P nearest_t = P::load(hits.t + at);
                const Lanes hit = roots.real & (t > P(one)) & (t < nearest_t);
                const Vec n = unit_point(roots, d, far);
                const Vec nearest_n = hits.point(at);
                select(hit, place, P::load(hits.sphere + at)).store(hits.sphere + at);
                select(hit, t, nearest_t).store(hits.t + at);
                select(hit, n.x, nearest_n.x).store(hits.x + at);
                select(hit, n.y, nearest_n.y).store(hits.y + at);
                select(hit, n.z, nearest_n.z).store(hits.z + at);
                select(hit, select(far, P(one), P(zero)), P::load(hits.inside + at)).store(hits.inside + at);
            }
        }
    }

    // For each outline in a span: what can stand between its sphere's hits there and the lights, one list a light, and
    // at the end a list of what their reflected rays can meet.
    struct SpanLists {
        static constexpr std::size_t most_lists = 64;
        static constexpr std::size_t most = 512;
        SphereList lists[most_lists];
        std::int32_t spheres[most];
    };

    // The box that the hits of a span on one sphere are in, in the sphere's unit space.
    struct Box {
        double low[3], high[3];
        bool empty;   // all hits are on others
        bool inside;  // some of them see the inside
    };
    static WHITTED_LARGE Box box(const Hits &hits, Reach part, P place) {
        const P infinity = Real(__builtin_inf());
        Vec low{infinity, infinity, infinity};
        Vec high{-infinity, -infinity, -infinity};
        Lanes inside = Lanes::none();
        for (std::size_t at = part.begin; at < part.end; at += Width) {
            const Hit hit = hits.load(at);
            const Lanes lanes = hit.sphere == place;
            inside = inside | (lanes & hit.inside);
            low = {select(lanes & (hit.n.x < low.x), hit.n.x, low.x), select(lanes & (hit.n.y < low.y), hit.n.y, low.y),
                   select(lanes & (hit.n.z < low.z), hit.n.z, low.z)};
            high = {select(lanes & (high.x < hit.n.x), hit.n.x, high.x),
                    select(lanes & (high.y < hit.n.y), hit.n.y, high.y),
                    select(lanes & (high.z < hit.n.z), hit.n.z, high.z)};
        }
        const double least_x = least(low.x);
        return {{least_x, least(low.y), least(low.z)},
                {-least(-high.x), -least(-high.y), -least(-high.z)},
                !(least_x < __builtin_inf()),
                any(inside)};
    }

    // Whether no segment from a box on sphere `own` to the light comes near `other`. middle, half: of the box, from the
    // sphere's centre in the world. In the unit space of `other` the box is in a ball about its middle: the distance of
    // the origin from the segment that starts there is more than the ball's radius and 1, and all roundings.
    static WHITTED_LARGE bool passes(const SceneConstants<Real> &scene, const Lamp<Real> &lamp, const Real *between,
                                     const SphereConstants<Real> &other, const double *middle, const double *half) {
        double a = 0, h = 0, start = 0, radius = 0, between_squared = 0;
        for (int c = 0; c < 3; ++c) {
            const double inverse = double(other.inverse_scale[c]);
            const double o = (middle[c] + double(between[c])) * inverse;
            // A point is rounded as what it is the sum of: those of a huge sphere near a small one.
            between_squared += (double(between[c]) * inverse) * (double(between[c]) * inverse);
            const double d = (double(lamp.place[c]) - middle[c]) * inverse;
            const double r = half[c] * inverse;
            a += d * d;
            h += o * d;
            start += o * o;
            radius += r * r;
        }
        const double t = h < 0 ? (-h < a ? -h / a : 1) : 0;
        const double distance = start + t * (2 * h + t * a);
        const double apart =
            1 + 8 * double(scene.doubt) * (1 + start + radius + a + between_squared) + __builtin_sqrt(radius);
        return distance > apart * apart;
    }

    // Whether `other` is below the tangent planes of sphere `own` at all points of a box, where no reflected ray goes:
    // with the gradient g = n / s of a point n, g.(y - p) < n.n = 1 for all points y of the other, and all roundings.
    static WHITTED_LARGE bool is_below(const SceneConstants<Real> &scene, const SphereConstants<Real> &own,
                                       const Real *between, const SphereConstants<Real> &other, const Box &part) {
        double along = 0, extent = 0, far = 1;
        for (int c = 0; c < 3; ++c) {
            const double inverse = double(own.inverse_scale[c]);
            const double to = -double(between[c]) * inverse;
            along += to * (to > 0 ? part.high[c] : part.low[c]);
            const double steepest = -part.low[c] > part.high[c] ? -part.low[c] : part.high[c];
            const double size = double(other.scale[c]) * inverse;
            extent += size * size * steepest * steepest;
            far += to * to + size * size;
        }
        double start = 1;
        double narrow = 0, wide = 0;  // the least and the largest 1/s: what an angle is worth in the unit space
        for (int c = 0; c < 3; ++c) {
            const double inverse = double(own.inverse_scale[c]);
            const double o = double(between[c]) * double(other.inverse_scale[c]);
            const double r = double(own.scale[c]) * double(other.inverse_scale[c]);
            start += 2 * o * o + 4 * r * r;
            narrow = c == 0 || inverse < narrow ? inverse : narrow;
            wide = inverse > wide ? inverse : wide;
        }
        const double grown = 1 + 8 * double(scene.doubt) * start;
        // A ray that all but touches may leave below the tangent plane by its roundings.
        const double doubts =
            double(scene.doubt) * (1 + far) * (1 + double(own.eye_distance_squared)) * (wide / narrow);
        return along + grown * __builtin_sqrt(extent) + doubts < 1;
    }

    static WHITTED_LARGE void find_lists(const SceneConstants<Real> &scene, const Span<Real> &span, const Hits &hits,
                                         SpanLists &found) {
        std::size_t used = 0;
        for (std::size_t k = 0; k < span.outline_count; ++k) {
            const std::int32_t i = span.outlines[k].sphere;
            const SphereConstants<Real> &own = scene.spheres[i];
            SphereList *lists = found.lists + k * (scene.light_count + 1);
            std::size_t listed = 0;
            for (std::size_t light = 0; light < scene.light_count; ++light) {
                lists[light] = own.lamps[light].blockers;
                if (own.lamps[light].adds) listed += static_cast<std::size_t>(lists[light].end - lists[light].begin);
            }
            lists[scene.light_count] = scene.all;
            const bool mirror = own.reflection > zero && scene.max_reflections > 0;
            if (mirror) listed += scene.sphere_count;
            if (listed == 0 || used + listed > SpanLists::most) continue;
            const Box part = box(hits, reach(span.outlines[k], span), P(Real(i)));
            if (part.empty) continue;
            double middle[3], half[3];
            for (int c = 0; c < 3; ++c) {
                middle[c] = 0.5 * (part.low[c] + part.high[c]) * double(own.scale[c]);
                half[c] = 0.5 * (part.high[c] - part.low[c]) * double(own.scale[c]);
            }
            // Those of `list` that stay go to the end of what is used.
            const auto keep = [&](SphereList &list, auto goes) {
                std::int32_t *const begin = found.spheres + used;
                std::int32_t *end = begin;
                for (const std::int32_t *j = list.begin; j != list.end; ++j)
                    if (!goes(*j)) *end++ = *j;
                list = {begin, end};
                used += static_cast<std::size_t>(end - begin);
            };
            for (std::size_t light = 0; light < scene.light_count; ++light) {
                const Lamp<Real> &lamp = own.lamps[light];
                if (!lamp.adds || lists[light].begin == lists[light].end) continue;
                keep(lists[light], [&](std::int32_t j) {
                    const SphereConstants<Real> &other = scene.spheres[j];
                    return other.lamps[light].side > 0 &&
                           passes(scene, lamp, own.from_others + 3 * j, other, middle, half);
                });
            }
            if (mirror && !part.inside)
                keep(lists[scene.light_count], [&](std::int32_t j) {
                    return j == i || is_below(scene, own, own.from_others + 3 * j, scene.spheres[j], part);
                });
        }
    }

    // A point on sphere i: n in its unit space, offset = |s_i| n from its centre in the world.
    struct SurfacePoint {
        std::size_t sphere;
        Vec n;
        Vec offset;
        Lanes inside;
        Vec gradient;  // g = n / |s_i|
        P to_normal;   // 1 / |g|, below 0 where the inside is seen: N = g to_normal
    };
    static WHITTED_INLINE SurfacePoint surface_point(const SceneConstants<Real> &scene, std::size_t i, Vec n,
                                                     Lanes inside) {
        const SphereConstants<Real> &sphere = scene.spheres[i];
        const Vec gradient = n * broadcast(sphere.inverse_scale);
        const P outward = P(one) / sqrt(dot(gradient, gradient));
        return {i, n, n * broadcast(sphere.scale), inside, gradient, select(inside, -outward, outward)};
    }

    // The point in the unit space of sphere j.
    static WHITTED_INLINE Vec seen_from(const SceneConstants<Real> &scene, const SurfacePoint &x, std::size_t j) {
        const SphereConstants<Real> &own = scene.spheres[x.sphere];
        const SphereConstants<Real> &other = scene.spheres[j];
        Vec between;
        if (own.from_others) [[likely]] {
            between = broadcast(own.from_others + 3 * j);
        } else {
            between = {P(Real(own.center[0] - other.center[0])), P(Real(own.center[1] - other.center[1])),
                       P(Real(own.center[2] - other.center[2]))};
        }
        return (x.offset + between) * broadcast(other.inverse_scale);
    }

    static WHITTED_INLINE P reach_squared(P distance_squared) {
        return minimum(P(touch_reach * touch_reach) * maximum(distance_squared, P(one)),
                       P(widest_touch * widest_touch));
    }

    // Reflected rays: on the sphere they start from only the other root, which the outside never meets. met: a bit for
    // each sphere that is hit, its place modulo 64. others: what they can meet.
    static WHITTED_LARGE Hit next_hit(const SceneConstants<Real> &scene, const SurfacePoint &x, Vec direction,
                                      Lanes active, SphereList others, std::uint64_t &met) {
        Hit nearest = no_hit();
        for (const std::int32_t *other = others.begin; other != others.end; ++other) {
            const std::size_t j = static_cast<std::size_t>(*other);
            const Vec d = direction * broadcast(scene.spheres[j].inverse_scale);
            if (j == x.sphere) {
                const Lanes crosses = active & x.inside;
                if (!any(crosses)) continue;
                const P t = P(Real(-2)) * dot(x.n, d) / dot(d, d);
                const Lanes hit = crosses & (t > P(zero)) & (t < nearest.t);
                met |= std::uint64_t{1} << (j % 64);
                keep_nearer(nearest, hit, t, P(Real(j)), x.n + d * t, Lanes::all());
                continue;
            }
            const Vec o = seen_from(scene, x, j);
            const P distance_squared = dot(o, o);
            const P c = distance_squared - P(one);
            // From outside and away from it: both roots are below 0, or nothing. Or D is below 0 for certain.
            const P a = dot(d, d);
            const P h = dot(o, d);
            const P slack = P(scene.doubt) * (P(one) + distance_squared) * a + P(underflow);
            const Lanes misses = ((h > P(zero)) & (c >= P(zero))) | (h * h - a * c < -slack);
            if (!any(active & !misses)) continue;
            const Roots roots = intersect(o, c, d, scene.spheres[j].steep, reach_squared(distance_squared));
            const Lanes far = !(roots.near_t > P(zero));
            const P t = select(far, roots.far_t, roots.near_t);
            const Lanes hit = active & roots.real & (t > P(zero)) & (t < nearest.t);
            if (!any(hit)) continue;
            keep_nearer(nearest, hit, t, P(Real(j)), unit_point(roots, d, far), far);
            met |= std::uint64_t{1} << (j % 64);
        }
        return nearest;
    }

    // Whether sphere j meets x + t d with epsilon < t < 1, in its unit space. end_d: the light there times d; side: of
    // it, not 0.
    static WHITTED_LARGE Lanes meets(Vec o, P distance_squared, P c, Vec d, bool steep, P end_d, P epsilon, int side) {
        const Roots roots = intersect(o, c, d, steep, reach_squared(distance_squared));
        // The light is inside: the way there enters, unless it starts inside. It is outside: both roots are before it,
        // or both behind it: as the ray comes to it going away from the centre, or not.
        return side < 0 ? roots.near_t > epsilon : roots.real & (roots.far_t > epsilon) & (end_d > P(zero));
    }

    // Whether some sphere meets x + t to_light with shadow_epsilon < t < 1. On which side of a sphere the light is, is
    // known exactly: so no root is held against 1, where rounding might take it to the wrong side of the light.
    // g_d: the product of x's gradient with to_light.
    static WHITTED_LARGE Lanes hidden(const SceneConstants<Real> &scene, const SurfacePoint &x, std::size_t light,
                                      SphereList blockers, Vec to_light, P g_d, Lanes asked) {
        const P epsilon(scene.shadow_epsilon);
        Lanes found = Lanes::none();
        // On this sphere the roots are 0 and the other one, which is before the light where that is outside.
        if (scene.spheres[x.sphere].lamps[light].side > 0) {
            const P m = P(Real(-2)) * g_d;
            if (any(asked & (m > P(zero)))) {
                const Vec d = to_light * broadcast(scene.spheres[x.sphere].inverse_scale);
                found = m / dot(d, d) > epsilon;
                if (!any(asked & !found)) return asked;
            }
        }
        for (const std::int32_t *blocker = blockers.begin; blocker != blockers.end; ++blocker) {
            const std::size_t j = static_cast<std::size_t>(*blocker);
            if (j == x.sphere) continue;
            const SphereConstants<Real> &sphere = scene.spheres[j];
            const int side = sphere.lamps[light].side;
            const Vec d = to_light * broadcast(sphere.inverse_scale);
            const Vec o = seen_from(scene, x, j);
            const P distance_squared = dot(o, o);
            const P c = distance_squared - P(one);
            if (side == 0) {
                // The roots are 1, which does not hide, and, by their product c/a, the other one.
                const P other = c / dot(d, d);
                found = found | ((other > epsilon) & (other < P(one)));
            } else {
                // What is certain without a division or a root: all but the rays near an outline.
                const P g = -dot(o, d);
                const P end_d = dot(broadcast(sphere.lamps[light].end), d);
                Lanes free, dark;
                if (side > 0) {
                    const P a = dot(d, d);
                    const P slack = P(scene.doubt) * (P(one) + distance_squared) * a + P(underflow);
                    const P discriminant = g * g - a * c;  // a D
                    const P before = g * end_d;  // above 0: the middle of the roots is between x and the light
                    free = (discriminant < -slack) | ((before < -slack) & (c >= P(zero)));
                    if (!any(asked & !(found | free))) continue;
                    dark = (discriminant > slack) & (before > slack) & (g > a * P(scene.certain_epsilon));
                } else {
                    const P slack = P(scene.doubt) * (P(one) + distance_squared);
                    free = (c <= P(zero)) | (g < P(zero));
                    if (!any(asked & !(found | free))) continue;
                    dark = (c > slack) & (c > g * P(Real(2) * scene.certain_epsilon)) & (g > P(underflow));
                }
                found = found | dark;
                if (any(asked & !(found | free))) [[unlikely]]
                    found = found | meets(o, distance_squared, c, d, sphere.steep, end_d, epsilon, side);
            }
            if (!any(asked & !found)) return asked;
        }
        return found & asked;
    }

    static WHITTED_INLINE void store3(Real *const *planes, std::size_t at, Vec v) {
        if (!planes[0]) return;
        v.x.store(planes[0] + at);
        v.y.store(planes[1] + at);
        v.z.store(planes[2] + at);
    }
    // Stores the lanes of one sphere beside those already there.
    static WHITTED_INLINE void merge(Real *plane, std::size_t at, Lanes lanes, P v) {
        select(lanes, v, P::load(plane + at)).store(plane + at);
    }

    struct Local {
        Vec ambient, diffuse, specular;
    };

    // The terms of the specification at the hits on one sphere. lists: where not null, what can hide each light, in
    // place of the scene's lists. g and p - x stand for N and L, the lengths come last: so no decision on a light waits
    // for the root and the division of one.
    static WHITTED_LARGE Local shade(const SceneConstants<Real> &scene, const SurfacePoint &x, Vec direction,
                                     Lanes lanes, const SphereList *lists, Real *const *shadow_planes, std::size_t at) {
        const SphereConstants<Real> &sphere = scene.spheres[x.sphere];
        Local local{broadcast(sphere.ambient), broadcast_zero(), broadcast_zero()};
        if (!sphere.lit && !shadow_planes) return local;
        // V = -d / |d|, d the ray's direction.
        const P inverse_length = sphere.specular ? P(one) / sqrt(dot(direction, direction)) : P(zero);
        const P twice_Nd = P(Real(2)) * dot(x.gradient, direction) * x.to_normal;
        for (std::size_t light = 0; light < scene.light_count; ++light) {
            const Lamp<Real> &lamp = sphere.lamps[light];
            if (!lamp.adds && !shadow_planes) continue;
            const Vec to_light = broadcast(lamp.place) - x.offset;
            const P g_d = dot(x.gradient, to_light);
            const Lanes facing = lanes & (select(x.inside, -g_d, g_d) > P(zero));
            if (!shadow_planes && !any(facing)) continue;
            const P distance_squared = dot(to_light, to_light);
            const Lanes apart = distance_squared > P(zero);  // a light at x itself is visible and adds nothing
            const Lanes asked = shadow_planes ? lanes & apart : facing;
            const Lanes dark = hidden(scene, x, light, lists ? lists[light] : lamp.blockers, to_light, g_d, asked);
            if (shadow_planes) merge(shadow_planes[light], at, lanes, select(dark, P(zero), P(one)));
            const Lanes bright = facing & apart & !dark;
            if (!lamp.adds || !any(bright)) continue;

            const P inverse_distance = P(one) / sqrt(distance_squared);
            const P height = g_d * x.to_normal;  // N.L, but for the distance
            const P cosine = select(bright, height * inverse_distance, P(zero));
            local.diffuse = local.diffuse + broadcast(lamp.diffuse) * cosine * broadcast(sphere.color);
            if (!sphere.specular) continue;
            // R = 2 (N.L) N - L; R.V, but for the distance and |d|.
            const P along = dot(to_light, direction) - height * twice_Nd;
            const Lanes shiny = bright & (along > P(zero));
            if (!any(shiny)) continue;
            // Rounding alone brings it above 1.
            const P RV = minimum(along * inverse_length * inverse_distance, P(one));
            const P highlight = select(shiny, power(RV, sphere.exponent, sphere.integer), P(zero));
            local.specular = local.specular + broadcast(lamp.specular) * highlight;
        }
        return local;
    }

    // The byte of v is 255 v, clamped, its fraction cut off; NaN becomes 0.
    static WHITTED_INLINE P byte(P v) { return minimum(maximum(P(zero), v), P(one)) * P(Real(255)); }

    // Rays on their way from mirror to mirror.
    struct Chain {
        Hit hit = no_hit();
        Vec direction = broadcast_zero();
        P weight = zero;  // product of the Kr's before the hit
        Lanes active = Lanes::none();
        std::uint64_t met = 0;  // a bit for each sphere that was hit, its place modulo 64
    };

    // Sends the rays of these lanes on from the mirror that x lies on, into `next`.
    static WHITTED_LARGE void reflect(const SceneConstants<Real> &scene, const SurfacePoint &x, Vec direction, P weight,
                                      Lanes lanes, SphereList others, Chain &next) {
        // d - 2 (d.N) N
        const Vec N = x.gradient * x.to_normal;
        const Vec mirrored = direction - N * (P(Real(2)) * dot(direction, N));
        std::uint64_t met = 0;
        const Hit found = next_hit(scene, x, mirrored, lanes, others, met);
        const Lanes goes_on = lanes & (found.sphere >= P(zero));
        if (!any(goes_on)) return;

        keep_nearer(next.hit, goes_on, found.t, found.sphere, found.n, found.inside);
        next.direction = select3(goes_on, mirrored, next.direction);
        next.weight = select(goes_on, weight * P(scene.spheres[x.sphere].reflection), next.weight);
        next.active = next.active | goes_on;
        next.met |= met;
    }

    // What the mirrors show. orders: planes of the single reflections, or null.
    static WHITTED_LARGE Vec reflections(const SceneConstants<Real> &scene, Chain chain, Real *const *orders,
                                         std::size_t at) {
        Vec reflected = broadcast_zero();
        for (std::int32_t bounce = 1; chain.met; ++bounce) {
            Chain next;
            Vec order = broadcast_zero();
            for (std::size_t i = 0; i < scene.sphere_count; ++i) {
                if (!(chain.met >> (i % 64) & 1)) continue;
                const Lanes lanes = chain.active & (chain.hit.sphere == P(Real(i)));
                if (!any(lanes)) continue;
                const SphereConstants<Real> &sphere = scene.spheres[i];
                const SurfacePoint x = surface_point(scene, i, chain.hit.n, chain.hit.inside);
                const Local local = shade(scene, x, chain.direction, lanes, nullptr, nullptr, at);
                order = select3(lanes, (local.ambient + (local.diffuse + local.specular)) * chain.weight, order);
                if (bounce < scene.max_reflections && sphere.reflection > zero)
                    reflect(scene, x, chain.direction, chain.weight, lanes, scene.all, next);
            }
            reflected = reflected + order;
            if (orders) store3(orders + 3 * (bounce - 1), at, order);
            chain = next;
        }
        return reflected;
    }

    // words: where the beauty in 8 bits is all that is asked for. lists: those of SpanLists, or null: the
    // scene's.
    template <bool only_words>
    static WHITTED_LARGE void trace_packet(const SceneConstants<Real> &scene, const Span<Real> &span, const Hits &hits,
                                           const SphereList *lists, std::size_t at, std::int32_t *words) {
        const Planes<Real> planes = only_words ? Planes<Real>{} : span.planes;
        const Vec direction{P::load(span.direction_x + at), P(span.direction_y), P(span.direction_z)};
        const Hit hit = hits.load(at);
        const Lanes covered = hit.sphere >= P(zero);
        if constexpr (!only_words) {
            if (planes.depth)
                select(covered, hit.t * sqrt(dot(direction, direction)), P(Real(__builtin_inf())))
                    .store(planes.depth + at);
            if (planes.position[0]) store3(planes.position, at, select3(covered, direction * hit.t, broadcast_zero()));
        }

        Vec beauty = broadcast(scene.background);
        Local primary{broadcast_zero(), broadcast_zero(), broadcast_zero()};
        Vec normal = broadcast_zero();
        P id(-one);
        Chain chain;
        const std::int64_t column = span.column + static_cast<std::int64_t>(at);
        for (std::size_t k = 0; k < span.outline_count; ++k) {
            const Outline &outline = span.outlines[k];
            if (outline.begin >= column + Width || outline.end <= column) continue;
            const std::size_t i = static_cast<std::size_t>(outline.sphere);
            const Lanes lanes = hit.sphere == P(Real(i));
            if (!any(lanes)) continue;
            const SphereConstants<Real> &sphere = scene.spheres[i];
            const SurfacePoint x = surface_point(scene, i, hit.n, hit.inside);
            const SphereList *own_lists = lists ? lists + k * (scene.light_count + 1) : nullptr;
            const Local local = shade(scene, x, direction, lanes, own_lists, planes.shadow, at);
            beauty = select3(lanes, local.ambient + (local.diffuse + local.specular), beauty);
            if constexpr (!only_words) {
                primary.ambient = select3(lanes, local.ambient, primary.ambient);
                primary.diffuse = select3(lanes, local.diffuse, primary.diffuse);
                primary.specular = select3(lanes, local.specular, primary.specular);
                normal = select3(lanes, x.gradient * x.to_normal, normal);
                id = select(lanes, P(Real(sphere.index)), id);
            }
            if (scene.max_reflections > 0 && sphere.reflection > zero)
                reflect(scene, x, direction, P(one), lanes, own_lists ? own_lists[scene.light_count] : scene.all,
                        chain);
        }
        Vec reflected = broadcast_zero();
        if (chain.met) reflected = reflections(scene, chain, planes.reflection_order, at);
        if (!only_words || chain.met) beauty = select3(covered, beauty + reflected, beauty);

        if constexpr (only_words) {
            store_words(words + at, byte(beauty.x), byte(beauty.y), byte(beauty.z));
        } else {
            store3(planes.beauty, at, beauty);
            store3(planes.ambient, at, primary.ambient);
            store3(planes.diffuse, at, primary.diffuse);
            store3(planes.specular, at, primary.specular);
            store3(planes.direct, at, primary.diffuse + primary.specular);
            store3(planes.reflection, at, reflected);
            store3(planes.normal, at, normal);
            if (planes.id) id.store(planes.id + at);
        }
    }

    static void trace_span(const SceneConstants<Real> &scene, const Span<Real> &span) {
        Hits hits;
        first_hits(scene, span, hits);
        SpanLists found;
        const SphereList *lists = nullptr;
        if (scene.span_lists && span.outline_count * (scene.light_count + 1) <= SpanLists::most_lists) {
            find_lists(scene, span, hits, found);
            lists = found.lists;
        }
        if (span.bytes) {
            alignas(64) std::int32_t words[widest_span<Real> + widest_packet];
            for (std::size_t at = 0; at < span.count; at += Width)
                trace_packet<true>(scene, span, hits, lists, at, words);
            pack_words(span.bytes, words, span.count);
        } else {
            for (std::size_t at = 0; at < span.count; at += Width)
                trace_packet<false>(scene, span, hits, lists, at, nullptr);
        }
    }
};

}  // namespace
}  // namespace whitted
