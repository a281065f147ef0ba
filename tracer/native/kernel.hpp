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

template <class Real, int Width>
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
    // A bound above all roundings of D a = h^2 - a c, in units of a (1 + |o|^2), touching() included; and what stays
    // far above all that underflows. Both are generous: between the bounds the full arithmetic decides.
    static constexpr Real doubt = 256 * unit_roundoff;
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
    static WHITTED_INLINE Lanes touching(P D, Vec o, Vec closest, Vec along) {
        const P sum = absolute(closest.x) * (absolute(o.x) + absolute(along.x)) +
                      absolute(closest.y) * (absolute(o.y) + absolute(along.y)) +
                      absolute(closest.z) * (absolute(o.z) + absolute(along.z));
        return -D <= P(tangent_roundings) * (P(one) + sum);
    }

    // c = |o|^2 - 1. reach_squared: the square of a bound above that of touching().
    static WHITTED_INLINE Roots intersect(Vec o, P c, Vec d, P reach_squared) {
        const P a = dot(d, d);
        const P h = dot(o, d);
        const P inverse_a = P(one) / a;
        const Vec along = d * (h * inverse_a);
        const Vec closest = o - along;
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
    static WHITTED_INLINE void settle_plane(const SphereConstants<Real> &sphere, Vec d, Roots &roots) {
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

    // Primary rays: the smallest t > 1; of equal ones the first in the file.
    static WHITTED_INLINE Hit first_hit(const SceneConstants<Real> &scene, const Span<Real> &span, std::int64_t column,
                                        Vec direction) {
        Hit nearest = no_hit();
        for (std::size_t k = 0; k < span.outline_count; ++k) {
            const Outline &outline = span.outlines[k];
            if (outline.begin >= column + Width || outline.end <= column) continue;
            const SphereConstants<Real> &sphere = scene.spheres[outline.sphere];
            const Vec d = direction * broadcast(sphere.inverse_scale);
            Roots roots =
                intersect(broadcast(sphere.eye), P(sphere.eye_power), d, reach_squared(P(sphere.eye_distance_squared)));
            if (!any(roots.real)) continue;
            if (sphere.meets_plane) [[unlikely]]
                settle_plane(sphere, d, roots);
            const Lanes far = !(roots.near_t > P(one));
            const P t = select(far, roots.far_t, roots.near_t);
            const Lanes hit = roots.real & (t > P(one)) & (t < nearest.t);
            if (any(hit)) keep_nearer(nearest, hit, t, P(Real(outline.sphere)), unit_point(roots, d, far), far);
        }
        return nearest;
    }

    // A point on sphere i: n in its unit space, offset = |s_i| n from its centre in the world.
    struct SurfacePoint {
        std::size_t sphere;
        Vec n;
        Vec offset;
        Lanes inside;
    };

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

    // Reflected rays: on the sphere they start from only the other root, which the outside never meets.
    static WHITTED_INLINE Hit next_hit(const SceneConstants<Real> &scene, const SurfacePoint &x, Vec direction,
                                       Lanes active) {
        Hit nearest = no_hit();
        for (std::size_t j = 0; j < scene.sphere_count; ++j) {
            const Vec d = direction * broadcast(scene.spheres[j].inverse_scale);
            if (j == x.sphere) {
                const Lanes crosses = active & x.inside;
                if (!any(crosses)) continue;
                const P t = P(Real(-2)) * dot(x.n, d) / dot(d, d);
                const Lanes hit = crosses & (t > P(zero)) & (t < nearest.t);
                keep_nearer(nearest, hit, t, P(Real(j)), x.n + d * t, Lanes::all());
                continue;
            }
            const Vec o = seen_from(scene, x, j);
            const P distance_squared = dot(o, o);
            const P c = distance_squared - P(one);
            if (scene.cuts) {
                const P a = dot(d, d);
                const P h = dot(o, d);
                // From outside and away from it: both roots are below 0, or nothing. Or D is below 0 for certain.
                const Lanes misses = ((h > P(zero)) & (c >= P(zero))) |
                                     (h * h - a * c < -(P(doubt) * (P(one) + distance_squared) * a + P(underflow)));
                if (!any(active & !misses)) continue;
            }
            const Roots roots = intersect(o, c, d, reach_squared(distance_squared));
            const Lanes far = !(roots.near_t > P(zero));
            const P t = select(far, roots.far_t, roots.near_t);
            const Lanes hit = active & roots.real & (t > P(zero)) & (t < nearest.t);
            if (any(hit)) keep_nearer(nearest, hit, t, P(Real(j)), unit_point(roots, d, far), far);
        }
        return nearest;
    }

    // Whether sphere j meets x + t d with epsilon < t < 1, in its unit space. side: of the light there, not 0.
    static WHITTED_INLINE Lanes meets(Vec o, P distance_squared, P c, Vec d, P epsilon, int side) {
        const Roots roots = intersect(o, c, d, reach_squared(distance_squared));
        // The light is inside: the way there enters, unless it starts inside. It is outside: both roots are before it
        // where their middle is, or both behind it.
        return side < 0 ? roots.near_t > epsilon
                        : roots.real & (roots.far_t > epsilon) & (roots.near_t + roots.far_t < P(Real(2)));
    }

    // Whether some sphere meets x + t to_light with shadow_epsilon < t < 1. On which side of a sphere the light is, is
    // known exactly: so no root is held against 1, where rounding might take it to the wrong side of the light.
    // own_d: to_light in the unit space of the sphere that x lies on; n_d: its product with n.
    static WHITTED_INLINE Lanes hidden(const SceneConstants<Real> &scene, const SurfacePoint &x, std::size_t light,
                                       Vec to_light, Vec own_d, P n_d, Lanes asked) {
        const SphereConstants<Real> &own = scene.spheres[x.sphere];
        const P epsilon(scene.shadow_epsilon);
        Lanes found = Lanes::none();
        // On this sphere the roots are 0 and the other one, which is before the light where that is outside.
        if (own.light_sides[light] > 0) {
            const P m = P(Real(-2)) * n_d;
            if (any(asked & (m > P(zero)))) {
                found = m / dot(own_d, own_d) > epsilon;
                if (!any(asked & !found)) return asked;
            }
        }
        const Blockers blockers = own.blockers[light];
        for (const std::int32_t *blocker = blockers.begin; blocker != blockers.end; ++blocker) {
            const std::size_t j = static_cast<std::size_t>(*blocker);
            if (j == x.sphere) continue;
            const SphereConstants<Real> &sphere = scene.spheres[j];
            const int side = sphere.light_sides[light];
            const Vec d = to_light * broadcast(sphere.inverse_scale);
            const Vec o = seen_from(scene, x, j);
            const P distance_squared = dot(o, o);
            const P c = distance_squared - P(one);
            if (side == 0) {
                // The roots are 1, which does not hide, and, by their product c/a, the other one.
                const P other = c / dot(d, d);
                found = found | ((other > epsilon) & (other < P(one)));
            } else if (!scene.cuts) {
                found = found | meets(o, distance_squared, c, d, epsilon, side);
            } else {
                // What is certain without a division or a root: all but the rays near an outline.
                const P g = -dot(o, d);
                Lanes free, dark;
                if (side > 0) {
                    const P a = dot(d, d);
                    const P slack = P(doubt) * (P(one) + distance_squared) * a + P(underflow);
                    const P discriminant = g * g - a * c;  // a D
                    const P before = g * (a - g);          // above 0: the middle of the roots, g/a, is before the light
                    free = (discriminant < -slack) | ((before < -slack) & (c >= P(zero)));
                    if (!any(asked & !(found | free))) continue;
                    dark = (discriminant > slack) & (before > slack) & (g > a * P(scene.certain_epsilon));
                } else {
                    const P slack = P(doubt) * (P(one) + distance_squared);
                    free = (c <= P(zero)) | (g < P(zero));
                    if (!any(asked & !(found | free))) continue;
                    dark = (c > slack) & (c > g * P(Real(2) * scene.certain_epsilon)) & (g > P(underflow));
                }
                found = found | dark;
                if (any(asked & !(found | free))) found = found | meets(o, distance_squared, c, d, epsilon, side);
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

    // The terms of the specification at the hits on one sphere. N is the shading normal.
    static WHITTED_INLINE Local shade(const SceneConstants<Real> &scene, const SurfacePoint &x, Vec N, Vec direction,
                                      Lanes lanes, Real *const *shadow_planes, std::size_t at) {
        const SphereConstants<Real> &sphere = scene.spheres[x.sphere];
        Local local{broadcast(sphere.ambient), broadcast_zero(), broadcast_zero()};
        if (!sphere.lit && !shadow_planes) return local;
        const Vec V = sphere.specular ? -direction * (P(one) / sqrt(dot(direction, direction))) : broadcast_zero();
        for (std::size_t light = 0; light < scene.light_count; ++light) {
            const bool contributes = sphere.lit && !scene.lights[light].dark;
            if (!contributes && !shadow_planes) continue;
            const Vec to_light = broadcast(sphere.to_lights + 3 * light) - x.offset;
            const Vec own_d = to_light * broadcast(sphere.inverse_scale);
            const P n_d = dot(x.n, own_d);
            if (scene.cuts && !shadow_planes) {
                // n.d is N.L but for a positive factor, and the side that is seen.
                const Lanes away = select(x.inside, n_d, -n_d) > P(sphere.least_facing[light]);
                if (!any(lanes & !away)) continue;
            }
            const P distance_squared = dot(to_light, to_light);
            const Lanes apart = distance_squared > P(zero);  // a light at x itself is visible and adds nothing
            const Vec L = to_light * (P(one) / sqrt(distance_squared));
            const P NL = dot(N, L);
            const Lanes facing = lanes & apart & (NL > P(zero));
            const Lanes asked = shadow_planes ? lanes & apart : facing;
            if (!any(asked)) {
                if (shadow_planes) merge(shadow_planes[light], at, lanes, P(one));
                continue;
            }
            const Lanes dark = hidden(scene, x, light, to_light, own_d, n_d, asked);
            if (shadow_planes) merge(shadow_planes[light], at, lanes, select(dark, P(zero), P(one)));
            const Lanes bright = facing & !dark;
            if (!contributes || !any(bright)) continue;

            const Real *terms = sphere.light_terms + 6 * light;
            const P cosine = select(bright, NL, P(zero));
            local.diffuse = local.diffuse + broadcast(terms) * cosine * broadcast(sphere.color);
            if (!sphere.specular) continue;
            // R = 2 (N.L) N - L; rounding alone brings R.V above 1.
            const P RV = minimum(P(Real(2)) * NL * dot(N, V) - dot(L, V), P(one));
            const Lanes shiny = bright & (RV > P(zero));
            if (!any(shiny)) continue;
            const P highlight = select(shiny, power(RV, sphere.exponent, sphere.integer), P(zero));
            local.specular = local.specular + broadcast(terms + 3) * highlight;
        }
        return local;
    }

    static WHITTED_INLINE Vec shading_normal(const SphereConstants<Real> &sphere, Vec n, Lanes inside) {
        const Vec gradient = n * broadcast(sphere.inverse_scale);
        const Vec outward = gradient * (P(one) / sqrt(dot(gradient, gradient)));
        return select3(inside, -outward, outward);
    }

    // The byte of v is 255 v, clamped, its fraction cut off; NaN becomes 0.
    static WHITTED_INLINE P byte(P v) {
        return select(v > P(zero), select(v < P(one), v, P(one)), P(zero)) * P(Real(255));
    }

    // words: where not null, the beauty in 8 bits is all that is asked for.
    template <bool only_words>
    static WHITTED_INLINE void trace_packet(const SceneConstants<Real> &scene, const Span<Real> &span, std::size_t at,
                                            std::int32_t *words) {
        const Planes<Real> planes = only_words ? Planes<Real>{} : span.planes;
        Vec direction{P::load(span.direction_x + at), P(span.direction_y), P(span.direction_z)};
        Hit hit = first_hit(scene, span, span.column + static_cast<std::int64_t>(at), direction);
        const Lanes covered = hit.sphere >= P(zero);

        if (!any(covered)) {
            const Vec nothing = broadcast_zero();
            const Vec background = broadcast(scene.background);
            if constexpr (only_words) {
                store_words(words + at, byte(background.x), byte(background.y), byte(background.z));
                return;
            }
            store3(planes.beauty, at, background);
            store3(planes.ambient, at, nothing);
            store3(planes.diffuse, at, nothing);
            store3(planes.specular, at, nothing);
            store3(planes.direct, at, nothing);
            store3(planes.reflection, at, nothing);
            store3(planes.position, at, nothing);
            store3(planes.normal, at, nothing);
            if (planes.depth) P(Real(__builtin_inf())).store(planes.depth + at);
            if (planes.id) P(-one).store(planes.id + at);
            return;
        }

        if (planes.depth)
            select(covered, hit.t * sqrt(dot(direction, direction)), P(Real(__builtin_inf()))).store(planes.depth + at);
        if (planes.position[0]) store3(planes.position, at, select3(covered, direction * hit.t, broadcast_zero()));

        Local primary{broadcast_zero(), broadcast_zero(), broadcast_zero()};
        Vec normal = broadcast_zero();
        P id(-one);
        Vec reflected = broadcast_zero();
        P weight(one);
        Lanes active = covered;
        for (std::int32_t bounce = 0;; ++bounce) {
            Hit next = no_hit();
            Vec next_direction = direction;
            P next_weight = weight;
            Lanes next_active = Lanes::none();
            Vec order = broadcast_zero();
            for (std::size_t i = 0; i < scene.sphere_count; ++i) {
                const Lanes lanes = active & (hit.sphere == P(Real(i)));
                if (!any(lanes)) continue;
                const SphereConstants<Real> &sphere = scene.spheres[i];
                const SurfacePoint x{i, hit.n, hit.n * broadcast(sphere.scale), hit.inside};
                const Vec N = shading_normal(sphere, hit.n, hit.inside);
                const Local local = shade(scene, x, N, direction, lanes, bounce == 0 ? planes.shadow : nullptr, at);
                if (bounce == 0) {
                    primary.ambient = select3(lanes, local.ambient, primary.ambient);
                    primary.diffuse = select3(lanes, local.diffuse, primary.diffuse);
                    primary.specular = select3(lanes, local.specular, primary.specular);
                    normal = select3(lanes, N, normal);
                    id = select(lanes, P(Real(sphere.index)), id);
                } else {
                    order = select3(lanes, (local.ambient + (local.diffuse + local.specular)) * weight, order);
                }
                if (bounce == scene.max_reflections || !(sphere.reflection > zero)) continue;
                // d - 2 (d.N) N
                const Vec mirrored = direction - N * (P(Real(2)) * dot(direction, N));
                const Hit found = next_hit(scene, x, mirrored, lanes);
                const Lanes goes_on = lanes & (found.sphere >= P(zero));
                if (!any(goes_on)) continue;
                keep_nearer(next, goes_on, found.t, found.sphere, found.n, found.inside);
                next_direction = select3(goes_on, mirrored, next_direction);
                next_weight = select(goes_on, weight * P(sphere.reflection), next_weight);
                next_active = next_active | goes_on;
            }
            if (bounce > 0) {
                reflected = reflected + order;
                if (planes.reflection_order) store3(planes.reflection_order + 3 * (bounce - 1), at, order);
            }
            if (!any(next_active)) break;
            hit = next;
            direction = next_direction;
            weight = next_weight;
            active = next_active;
        }

        const Vec direct = primary.diffuse + primary.specular;
        const Vec beauty = select3(covered, (primary.ambient + direct) + reflected, broadcast(scene.background));
        if constexpr (only_words) {
            store_words(words + at, byte(beauty.x), byte(beauty.y), byte(beauty.z));
            return;
        }
        store3(planes.beauty, at, beauty);
        store3(planes.ambient, at, primary.ambient);
        store3(planes.diffuse, at, primary.diffuse);
        store3(planes.specular, at, primary.specular);
        store3(planes.direct, at, direct);
        store3(planes.reflection, at, reflected);
        store3(planes.normal, at, normal);
        if (planes.id) id.store(planes.id + at);
    }

    static void trace_span(const SceneConstants<Real> &scene, const Span<Real> &span) {
        if (span.bytes) {
            alignas(64) std::int32_t words[widest_span + widest_packet];
            for (std::size_t at = 0; at < span.count; at += Width) trace_packet<true>(scene, span, at, words);
            pack_words(span.bytes, words, span.count);
        } else {
            for (std::size_t at = 0; at < span.count; at += Width) trace_packet<false>(scene, span, at, nullptr);
        }
    }
};

}  // namespace
}  // namespace whitted
