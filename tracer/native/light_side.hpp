// On which side of a sphere's surface a light is: exactly, whatever the rounding.
#pragma once

#include "scene.hpp"

namespace whitted {

// |(p - c) / s|^2 - 1 of a light at p: -1 inside the sphere, 0 on it, 1 outside.
int light_side(const Sphere &sphere, const Light &light);

}  // namespace whitted
