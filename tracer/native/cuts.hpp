// What a scene does not need: rays outside a sphere's outline, spheres that cannot stand between a surface and a light.
// Decided in float64, and conservatively: whatever a kernel computes in its own precision, a cut changes no result.
#pragma once

#include <cstdint>

#include "scene.hpp"

namespace whitted {

// Whether the scene's lengths are near enough to each other that products of four of them, in a kernel's unit
// roundoff, neither overflow nor vanish. Without that nothing is cut.
bool can_cut(const Scene &scene, double unit_roundoff);

// The image of one sphere.
class Silhouette {
  public:
    Silhouette(const Sphere &sphere, const View &view, double unit_roundoff);

    // The part of the row at height y, in x, outside of which no computed ray meets the sphere in front of the eye.
    struct Interval {
        double low, high;
        bool is_empty() const { return !(low <= high); }
    };
    Interval row(double y) const;

  private:
    double scale_x, scale_y;  // 1 / |s|
    double eye[3];            // -p / |s|
    double forward;           // -near / |s_z|
    double power;             // |eye|^2 - 1, less a bound above the roundings of D
    double quadratic;         // the coefficient of u^2 in the outline's equation
    enum class Kind { nowhere, everywhere, outlined } kind;
};

// Whether no computed ray from a point on `surface` to the light meets `other` before it. reach: how far from it, in
// units of |s| of the surface, a ray that hits it may start: a bound.
bool cannot_block(const Sphere &surface, double reach, const Light &light, const Sphere &other, double unit_roundoff);

}  // namespace whitted
