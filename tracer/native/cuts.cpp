// What a scene does not need: rays outside a sphere's outline, spheres that cannot stand between a surface and a light.
#include "cuts.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace whitted {

namespace {

// Above all roundings of D = 1 - |l|^2 and of the tangents that count as hits, in units of u (1 + |o|^2): a kernel's
// are below 128, and those of the equations here, in float64, below 64.
constexpr double roundings = 512;

constexpr double square(double x) { return x * x; }

}  // namespace

bool can_cut(const Scene &scene, double unit_roundoff) {
    const View &view = scene.view;
    double largest = std::max(
        {view.near_plane, std::abs(view.left), std::abs(view.right), std::abs(view.bottom), std::abs(view.top)});
    double smallest = view.near_plane;
    for (const Sphere &sphere : scene.spheres)
        for (std::size_t k = 0; k < 3; ++k) {
            const double scale = std::abs(sphere.scaling[k]);
            largest = std::max({largest, scale, std::abs(sphere.position[k])});
            smallest = std::min(smallest, scale);
        }
    for (const Light &light : scene.lights)
        for (const double x : light.position) largest = std::max(largest, std::abs(x));
    return largest <= smallest * (unit_roundoff < 0x1p-40 ? 1e30 : 1e7);
}

// In the sphere's unit space a ray d from the eye e has D = 1 - |e|^2 + (e.d)^2 / |d|^2. Along a row d = (u, v, w) with
// v and w fixed, so D |d|^2 >= 0 is a quadratic inequality in u; in front of the eye is where e.d < 0.
Silhouette::Silhouette(const Sphere &sphere, const View &view, double unit_roundoff) {
    double distance_squared = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        eye[k] = -sphere.position[k] / std::abs(sphere.scaling[k]);
        distance_squared += eye[k] * eye[k];
    }
    scale_x = 1 / std::abs(sphere.scaling[0]);
    scale_y = 1 / std::abs(sphere.scaling[1]);
    forward = -view.near_plane / std::abs(sphere.scaling[2]);
    const double bound = roundings * unit_roundoff * (1 + distance_squared);
    power = distance_squared - 1 - bound;
    quadratic = 1 + bound - eye[1] * eye[1] - eye[2] * eye[2];  // eye_x^2 - power
    if (!(power > bound)) {
        kind = Kind::everywhere;  // the eye is inside, or all but on the surface
    } else if (eye[2] < -1 - bound) {
        kind = Kind::nowhere;  // it is behind the eye
    } else if (!(quadratic < -0x1p-40 * (1 + distance_squared))) {
        kind = Kind::everywhere;  // the outline in this row may be open
    } else {
        kind = Kind::outlined;
    }
}

Silhouette::Interval Silhouette::row(double y) const {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    constexpr Interval nothing{infinity, -infinity};
    if (kind == Kind::nowhere) return nothing;
    if (kind == Kind::everywhere) return {-infinity, infinity};
    const double v = y * scale_y;
    // (e.d)^2 - power |d|^2 = quadratic u^2 + 2 half u + rest
    const double along = eye[1] * v + eye[2] * forward;
    const double half = eye[0] * along;
    const double rest = along * along - power * (v * v + forward * forward);
    const double discriminant = half * half - quadratic * rest;
    if (discriminant < 0) return nothing;
    const double root = std::sqrt(discriminant);
    const double q = half > 0 ? -(half + root) : root - half;
    double one = q / quadratic;
    double other = q != 0 ? rest / q : one;
    if (one > other) std::swap(one, other);
    // Between the roots e.d has one sign: that part of the row sees the sphere, or its mirror image behind the eye.
    if (eye[0] * (0.5 * one + 0.5 * other) + along > 0) return nothing;
    return {one / scale_x, other / scale_x};
}

// In the unit space of `other`: the least distance from its centre to the hull of an ellipsoid and a point. The nearest
// point found so far is z; the plane through the hull's point that lies least far along z says how much nearer it may
// be.
bool cannot_block(const Sphere &surface, double reach, const Light &light, const Sphere &other, double unit_roundoff) {
    Vec3 center{}, axes{}, end{};
    const double grown = 1 + roundings * unit_roundoff * (1 + square(reach));
    double center_squared = 0, end_squared = 0, widest = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        const double scale = std::abs(other.scaling[k]);
        center[k] = (surface.position[k] - other.position[k]) / scale;
        end[k] = (light.position[k] - other.position[k]) / scale;
        axes[k] = grown * std::abs(surface.scaling[k]) / scale;
        center_squared += square(center[k]);
        end_squared += square(end[k]);
        widest = std::max(widest, axes[k]);
    }
    const double farthest = std::max(std::sqrt(center_squared) + 2 * widest, std::sqrt(end_squared));
    const double apart = 1 + 2 * roundings * unit_roundoff * (1 + square(farthest));

    Vec3 z = end;
    for (int step = 0; step < 64; ++step) {
        const double length = std::sqrt(square(z[0]) + square(z[1]) + square(z[2]));
        if (!(length > apart)) return false;
        double to_center = 0, to_end = 0, extent = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            to_center += z[k] * center[k];
            to_end += z[k] * end[k];
            extent += square(z[k] * axes[k]);
        }
        extent = std::sqrt(extent);
        if (std::min(to_center - extent, to_end) > apart * length) return true;
        // To the point nearest to the centre between z and the hull's point that is least far along z.
        Vec3 v = end;
        if (to_center - extent < to_end)
            for (std::size_t k = 0; k < 3; ++k) v[k] = center[k] - (extent > 0 ? square(axes[k]) * z[k] / extent : 0);
        double down = 0, whole = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            down += z[k] * (z[k] - v[k]);
            whole += square(z[k] - v[k]);
        }
        const double part = whole > 0 ? std::clamp(down / whole, 0.0, 1.0) : 0;
        for (std::size_t k = 0; k < 3; ++k) z[k] += part * (v[k] - z[k]);
    }
    return false;
}

}  // namespace whitted
