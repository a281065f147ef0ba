// What the files of the Python face share.
#pragma once

#include <nanobind/nanobind.h>

#include <string_view>
#include <vector>

#include "scene.hpp"

namespace whitted {

// What stands for the file in messages about a Scene made in code.
inline constexpr std::string_view in_code = "Scene";

// Raises tracer.SceneError when there are errors.
void raise_errors(const std::vector<Diagnostic> &errors, std::string_view source);

void bind_render(nanobind::module_ &module);

}  // namespace whitted
