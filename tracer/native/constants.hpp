// What a kernel is given: the scene's constants in the kernel's precision, and a span of pixels to fill. Plain data
// only.
#pragma once

#include <cstddef>
#include <cstdint>

namespace whitted {

// Places of spheres among the existing ones.
struct SphereList {
    const std::int32_t *begin;
    const std::int32_t *end;
};

// A light, as a sphere sees it.
template <class Real>
struct Lamp {
    Real place[3];        // its place minus the sphere's p
    Real end[3];          // the same in the sphere's unit space
    Real diffuse[3];      // Kd Ip
    Real specular[3];     // Ks Ip
    SphereList blockers;  // what can stand between it and the sphere
    std::int32_t side;    // -1 inside the sphere, 0 on it, 1 outside, exactly
    bool adds;            // whether it lights the sphere at all
};

// The columns of a row, begin .. end - 1, outside of which no ray meets a sphere.
struct Outline {
    std::int32_t sphere;  // its place among the existing spheres
    std::int64_t begin;
    std::int64_t end;
};

// One existing sphere. Lengths that are subtracted from each other stay in float64 whatever the kernel's precision.
template <class Real>
struct SphereConstants {
    double center[3];           // p
    Real scale[3];              // |s|
    Real inverse_scale[3];      // 1 / |s|
    Real eye[3];                // the eye in the sphere's unit space: -p / |s|
    Real eye_power;             // |eye|^2 - 1, from float64: below 0 when the eye is inside
    Real eye_distance_squared;  // |eye|^2
    bool meets_plane;           // whether it reaches the image plane z = -near, where primary rays begin to count
    bool steep;                 // so thin and far that D needs a second projection: docs/tolerances.md, section 2
    Real plane_reach[3];        // |p| + 3/8 |(left, top, 0)| in units of |s|: part of the rounding bound there
    Real ambient[3];            // Ka Ia O
    Real color[3];              // O
    Real reflection;            // Kr
    Real exponent;              // n
    std::int32_t integer;       // n where it is an integer that is multiplied out, else -1
    std::int32_t index;         // in the scene, what the pass `id` shows
    bool lit;                   // Kd or Ks is not 0
    bool specular;              // Ks is not 0
    const Real *from_others;    // of each sphere: p minus its centre; null where there are too many
    const Lamp<Real> *lamps;    // one a light
};

template <class Real>
struct SceneConstants {
    const SphereConstants<Real> *spheres;

    std::size_t sphere_count;
    std::size_t light_count;
    Real background[3];
    Real shadow_epsilon;
    Real certain_epsilon;  // a little more: what is above it, is above shadow_epsilon whatever the rounding
    std::int32_t max_reflections;
    // A bound above all roundings of D a = h^2 - a c, in units of a (1 + |o|^2), touching() included: what is decided
    // beyond it needs no division and no root. Infinite where nothing is to be cut.
    Real doubt;
    SphereList all;   // all spheres
    bool span_lists;  // shorten the lists span by span; from_others is there
};

// Where a span's results go: a plane of at least `count` values each, null where a pass is not asked for. The planes of
// shadow and of the single reflections hold zeros before the call.
template <class Real>
struct Planes {
    Real *beauty[3];
    Real *ambient[3];
    Real *diffuse[3];
    Real *specular[3];
    Real *direct[3];
    Real *reflection[3];
    Real *position[3];
    Real *normal[3];
    Real *depth;
    Real *id;
    Real *const *shadow;            // a light each
    Real *const *reflection_order;  // three a bounce
};

// Neighbouring pixels of one row. The directions and the planes reach to the next multiple of the widest packet.
template <class Real>
struct Span {
    const Real *direction_x;
    Real direction_y;
    Real direction_z;
    std::int64_t column;      // of the first pixel
    std::size_t count;        // at most widest_span<Real>
    const Outline *outlines;  // in the order of the file
    std::size_t outline_count;
    Planes<Real> planes;
    std::uint8_t *bytes;  // where not null: the beauty in 8 bits, three bytes a pixel, and no planes
};

template <class Real>
using TraceSpan = void (*)(const SceneConstants<Real> &, const Span<Real> &);

inline constexpr std::size_t widest_packet = 16;
template <class Real>
inline constexpr std::size_t widest_span = 2048 / sizeof(Real);  // its planes stay in the first-level caches

// The kernels of one instruction set.
struct Kernels {
    const char *name;
    TraceSpan<double> f64;
    TraceSpan<float> f32;
};

extern const Kernels kernels_scalar;
extern const Kernels kernels_sse2;
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
extern const Kernels kernels_neon;

}  // namespace whitted
