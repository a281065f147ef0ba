// Renders runs of pixels of a scene over threads, with the kernels of the best instruction set.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "scene.hpp"

namespace whitted {

enum class Precision { f64, f32 };
enum class Sample { corner, center, bottom_left, top_right, inclusive };

// "corner", "center", "bottom-left", "top-right" or "inclusive".
std::optional<Sample> parse_sample(std::string_view name);

struct Settings {
    Precision precision = Precision::f64;
    int threads = 0;  // 0: as many as there are processors
    Sample sample = Sample::corner;
    double shadow_epsilon = 1e-4;
    int max_reflections = 3;
    bool cuts = true;        // leave out what cannot change a bit of the result; off only to test that
    std::int64_t piece = 0;  // the pixels that a thread takes at a time; 0: what is fast; another only to test that
};

// More bounces than any mirror of Kr < 0.99 shows in float64.
inline constexpr int most_reflections = 1000;
inline constexpr int most_threads = 1024;

enum class PassKind {
    beauty,
    beauty8,  // the beauty, quantised to 8 bits
    ambient,
    diffuse,
    specular,
    direct,
    shadow,
    reflection,
    reflection_order,
    depth,
    position,
    normal,
    id,
};

// Where a pass goes: pixel by pixel, channels interleaved, the first rendered pixel first. The values
// are of the settings' precision, but uint8 for beauty8 and int32 for id.
struct Target {
    PassKind kind;
    int member = 0;  // of shadow: the light, of reflection_order: the bounce from 1
    void *data = nullptr;
};

// Values of a pass for one pixel, and their size in bytes.
int channels(PassKind kind);
std::size_t value_size(PassKind kind, Precision precision);

// Called in the calling thread about every 50 ms with the number of pixels done; false stops the rendering.
using Poll = std::function<bool(std::int64_t)>;

// Called by the threads that render, in any order, with finished pixels begin .. end - 1 of the beauty in 8 bits; false
// stops the rendering.
using Deliver = std::function<bool(std::int64_t begin, std::int64_t end, const std::uint8_t *bytes)>;

// The name of the instruction set in use, or "" when WHITTED_ISA asks for one that is unknown or that this processor
// lacks; then `problem` says so.
std::string instruction_set(std::string &problem);

// The compiler this was built with.
std::string compiler();

// A scene made ready for rendering.
class Renderer {
  public:
    // The scene is valid, and fit for the precision (check_float32). instruction_set() is not "".
    Renderer(const Scene &scene, const Settings &settings);
    ~Renderer();
    Renderer(const Renderer &) = delete;
    Renderer &operator=(const Renderer &) = delete;

    // Fills the targets with pixels first .. last - 1, counted row by row. False when poll stopped it. The rounding and
    // denormal modes of the calling thread play no part and are left as they were.
    bool render(std::int64_t first, std::int64_t last, const std::vector<Target> &targets, const Poll &poll) const;

    // The beauty in 8 bits of the whole image, piece by piece, in little memory. False when poll or deliver stopped it.
    bool stream(const Deliver &deliver, const Poll &poll) const;

  private:
    struct Prepared;
    template <class Real>
    struct PreparedFor;
    // Told of finished pixels; false: leave the rest.
    using GoOn = std::function<bool(std::int64_t)>;
    // Renders pixels begin .. end - 1; false: leave the rest.
    using Piece = std::function<bool(std::int64_t begin, std::int64_t end, const GoOn &go_on)>;
    // Shares the pixels among the threads, each with a worker of its own.
    bool share(std::int64_t first, std::int64_t last, std::int64_t size, const std::function<Piece()> &worker,
               const Poll &poll) const;
    Prepared *prepared;
};

}  // namespace whitted
