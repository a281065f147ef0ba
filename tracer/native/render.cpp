// Scene constants, threads, and the way from a kernel's planes to the images.
#include "render.hpp"

#include <algorithm>
#include <atomic>
#include <cfenv>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <limits>
#include <mutex>
#include <set>
#include <system_error>
#include <thread>

#include "constants.hpp"
#include "light_side.hpp"
#include "ppm.hpp"

namespace whitted {

namespace {

// A span is the part of a row that a kernel fills at a time: its planes stay in the first-level caches.
constexpr std::int64_t span_columns = 256;
static_assert(span_columns % widest_packet == 0);
// What a thread takes at a time: long enough to make the taking cheap, short enough to share the work evenly.
constexpr std::int64_t piece = 4096;
// Below this many pixels a second thread costs more than it saves.
constexpr std::int64_t pixels_for_a_thread = 16384;

struct InstructionSet {
    const Kernels *kernels;
    bool (*supported)();
};

// The best one first.
const InstructionSet instruction_sets[] = {
#if defined(__x86_64__)
    {&kernels_avx512,
     [] {
         return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
     }},
    {&kernels_avx2, [] { return __builtin_cpu_supports("avx2") != 0; }},
    {&kernels_sse2, [] { return true; }},
#elif defined(__aarch64__)
    {&kernels_neon, [] { return true; }},
#endif
    {&kernels_scalar, [] { return true; }},
};

const Kernels *choose(std::string &problem) {
    const char *wish = std::getenv("WHITTED_ISA");
    std::string known;
    for (const InstructionSet &set : instruction_sets) {
        const std::string_view name = set.kernels->name;
        if (!wish || !*wish) {
            if (set.supported()) return set.kernels;
        } else if (name == wish) {
            if (set.supported()) return set.kernels;
            problem = "WHITTED_ISA asks for '" + std::string(name) + "', which this processor lacks";
            return nullptr;
        }
        if (set.supported()) known += (known.empty() ? "" : ", ") + std::string(name);
    }
    problem = "WHITTED_ISA is '" + std::string(wish) + "', but here it can be one of " + known;
    return nullptr;
}

template <class Real>
void narrow(Real (&to)[3], const Vec3 &from) {
    for (int k = 0; k < 3; ++k) to[k] = static_cast<Real>(from[static_cast<std::size_t>(k)]);
}

// The image plane, for a sphere: whether there is anything to decide there, and its part of the rounding bound.
template <class Real>
void meet_plane(SphereConstants<Real> &to, const Sphere &sphere, const View &view) {
    // f = |y|^2 - 1 counts as 0 up to 0.5 at most, which is beyond |y_z| = 1.25.
    to.meets_plane = std::abs(view.near_plane + sphere.position[2]) <= 1.25 * std::abs(sphere.scaling[2]);
    const double corner[3] = {view.left, view.top, 0};
    for (std::size_t k = 0; k < 3; ++k) {
        const double reach = std::abs(sphere.position[k]) + 0.375 * std::abs(corner[k]);
        to.plane_reach[k] = static_cast<Real>(reach / std::abs(sphere.scaling[k]));
    }
}

// Sets the default rounding and denormal modes for its lifetime.
class DefaultFloatingPoint {
  public:
    DefaultFloatingPoint() {
        std::fegetenv(&saved);
        std::fesetenv(FE_DFL_ENV);
    }
    ~DefaultFloatingPoint() { std::fesetenv(&saved); }
    DefaultFloatingPoint(const DefaultFloatingPoint &) = delete;
    DefaultFloatingPoint &operator=(const DefaultFloatingPoint &) = delete;

  private:
    std::fenv_t saved;
};

// The sample's place in its pixel, and the number of steps that the image is divided into.
struct Grid {
    double offset;
    double steps;
};

Grid grid(Sample sample, bool horizontal, std::int64_t pixels) {
    const double count = static_cast<double>(pixels);
    switch (sample) {
        case Sample::center:
            return {0.5, count};
        case Sample::bottom_left:
            return {horizontal ? 0.0 : 1.0, count};
        case Sample::top_right:
            return {horizontal ? 1.0 : 0.0, count};
        case Sample::inclusive:
            return {0.0, pixels > 1 ? count - 1 : 1.0};
        case Sample::corner:
            break;
    }
    return {0.0, count};
}

}  // namespace

std::optional<Sample> parse_sample(std::string_view name) {
    if (name == "corner") return Sample::corner;
    if (name == "center") return Sample::center;
    if (name == "bottom-left") return Sample::bottom_left;
    if (name == "top-right") return Sample::top_right;
    if (name == "inclusive") return Sample::inclusive;
    return std::nullopt;
}

int channels(PassKind kind) {
    switch (kind) {
        case PassKind::shadow:
        case PassKind::depth:
        case PassKind::id:
            return 1;
        default:
            return 3;
    }
}

std::size_t value_size(PassKind kind, Precision precision) {
    switch (kind) {
        case PassKind::beauty8:
            return 1;
        case PassKind::id:
            return sizeof(std::int32_t);
        default:
            return precision == Precision::f64 ? sizeof(double) : sizeof(float);
    }
}

std::string instruction_set(std::string &problem) {
    const Kernels *kernels = choose(problem);
    return kernels ? kernels->name : "";
}

std::string compiler() {
#if defined(__clang__)
    return "Clang " __clang_version__;
#else
    return "GCC " __VERSION__;
#endif
}

struct Renderer::Prepared {
    View view;
    Settings settings;
    virtual ~Prepared() = default;
    // Called with the number of pixels that were just finished; false: leave the rest.
    using GoOn = std::function<bool(std::int64_t)>;
    // Renders pixels begin .. end - 1, counted row by row; the targets begin with pixel `first`.
    virtual void pixels(std::int64_t begin, std::int64_t end, std::int64_t first, const std::vector<Target> &targets,
                        const GoOn &go_on) const = 0;
};

template <class Real>
struct Renderer::PreparedFor final : Renderer::Prepared {
    std::vector<SphereConstants<Real>> spheres;
    std::vector<LightConstants<Real>> lights;
    std::vector<Real> light_terms;
    std::vector<std::int8_t> light_sides;
    SceneConstants<Real> scene{};
    TraceSpan<Real> trace;

    PreparedFor(const Scene &from, const Settings &chosen, TraceSpan<Real> kernel) : trace(kernel) {
        view = from.view;
        settings = chosen;
        const std::vector<std::size_t> distinct = from.distinct();
        const std::size_t light_count = from.lights.size();
        light_terms.reserve(distinct.size() * light_count * 6);
        light_sides.reserve(distinct.size() * light_count);
        spheres.reserve(distinct.size());

        for (const Light &light : from.lights) {
            LightConstants<Real> to{};
            std::copy(light.position.begin(), light.position.end(), to.position);
            to.dark = light.intensity == Vec3{0, 0, 0};
            lights.push_back(to);
        }
        for (const std::size_t index : distinct) {
            const Sphere &sphere = from.spheres[index];
            SphereConstants<Real> to{};
            double power = -1;
            for (std::size_t k = 0; k < 3; ++k) {
                const double scale = std::abs(sphere.scaling[k]);
                const double eye = -sphere.position[k] / scale;
                to.center[k] = sphere.position[k];
                to.scale[k] = static_cast<Real>(scale);
                to.inverse_scale[k] = static_cast<Real>(1 / scale);
                to.eye[k] = static_cast<Real>(eye);
                to.ambient[k] = static_cast<Real>(sphere.ka * from.ambient[k] * sphere.color[k]);
                power += eye * eye;
            }
            to.eye_power = static_cast<Real>(power);
            to.eye_distance_squared = static_cast<Real>(power + 1);
            meet_plane(to, sphere, from.view);
            narrow(to.color, sphere.color);
            to.reflection = static_cast<Real>(sphere.kr);
            to.exponent = static_cast<Real>(sphere.exponent);
            to.integer = sphere.exponent <= 1024 && sphere.exponent == std::floor(sphere.exponent)
                             ? static_cast<std::int32_t>(sphere.exponent)
                             : -1;
            to.index = static_cast<std::int32_t>(index);
            to.lit = sphere.kd != 0 || sphere.ks != 0;
            to.specular = sphere.ks != 0;
            to.light_terms = light_terms.data() + light_terms.size();
            to.light_sides = light_sides.data() + light_sides.size();
            for (const Light &light : from.lights) {
                for (const double k : {sphere.kd, sphere.ks})
                    for (const double intensity : light.intensity)
                        light_terms.push_back(static_cast<Real>(k * intensity));
                light_sides.push_back(static_cast<std::int8_t>(light_side(sphere, light)));
            }
            spheres.push_back(to);
        }
        scene.spheres = spheres.data();
        scene.lights = lights.data();
        scene.sphere_count = spheres.size();
        scene.light_count = lights.size();
        narrow(scene.background, from.background);
        scene.shadow_epsilon = static_cast<Real>(settings.shadow_epsilon);
        scene.max_reflections = settings.max_reflections;
    }

    // The planes of one span and the memory behind them.
    struct Buffer {
        std::vector<Real> values;
        std::vector<Real *> shadow;
        std::vector<Real *> reflection_order;
        Planes<Real> planes{};

        Buffer(const std::vector<Target> &targets, std::size_t light_count, int max_reflections) {
            const auto wanted = [&](PassKind kind) {
                return std::any_of(targets.begin(), targets.end(), [&](const Target &t) { return t.kind == kind; });
            };
            if (wanted(PassKind::shadow)) shadow.resize(light_count);
            if (wanted(PassKind::reflection_order))
                reflection_order.resize(3 * static_cast<std::size_t>(max_reflections));
            std::set<Real **> used;  // memory only for what is asked for: there are up to 1000 bounces
            for (const Target &target : targets)
                for (int c = 0; c < channels(target.kind); ++c) used.insert(planes_of(target) + c);
            for (Real *&plane : shadow) used.insert(&plane);  // a kernel fills those of all lights
            values.resize(used.size() * span_columns);
            Real *next = values.data();
            for (Real **plane : used) {
                *plane = next;
                next += span_columns;
            }
            planes.shadow = shadow.empty() ? nullptr : shadow.data();
            planes.reflection_order = reflection_order.empty() ? nullptr : reflection_order.data();
        }

        // Shadow and the single reflections are only written where something is hit.
        void clear() {
            for (Real *plane : shadow) std::fill_n(plane, span_columns, Real(0));
            for (Real *plane : reflection_order)
                if (plane) std::fill_n(plane, span_columns, Real(0));
        }

        // The first plane of a pass; there is one a channel.
        Real **planes_of(const Target &target) {
            const std::size_t member = static_cast<std::size_t>(target.member);
            switch (target.kind) {
                case PassKind::beauty:
                case PassKind::beauty8:
                    return planes.beauty;
                case PassKind::ambient:
                    return planes.ambient;
                case PassKind::diffuse:
                    return planes.diffuse;
                case PassKind::specular:
                    return planes.specular;
                case PassKind::direct:
                    return planes.direct;
                case PassKind::reflection:
                    return planes.reflection;
                case PassKind::position:
                    return planes.position;
                case PassKind::normal:
                    return planes.normal;
                case PassKind::depth:
                    return &planes.depth;
                case PassKind::id:
                    return &planes.id;
                case PassKind::shadow:
                    return shadow.data() + member;
                case PassKind::reflection_order:
                    return reflection_order.data() + 3 * (member - 1);
            }
            return nullptr;
        }
    };

    // Planes to interleaved values.
    static void deliver(const Target &target, const Real *const *planes, std::int64_t pixel, std::int64_t count) {
        const std::int64_t width = channels(target.kind);
        const auto interleave = [&](auto *to, auto convert) {
            for (std::int64_t c = 0; c < width; ++c)
                for (std::int64_t k = 0; k < count; ++k) to[(pixel + k) * width + c] = convert(planes[c][k]);
        };
        if (target.kind == PassKind::beauty8) {
            interleave(static_cast<std::uint8_t *>(target.data), [](Real v) { return quantise(v); });
        } else if (target.kind == PassKind::id) {
            interleave(static_cast<std::int32_t *>(target.data), [](Real v) { return static_cast<std::int32_t>(v); });
        } else {
            interleave(static_cast<Real *>(target.data), [](Real v) { return v; });
        }
    }

    void pixels(std::int64_t begin, std::int64_t end, std::int64_t first, const std::vector<Target> &targets,
                const GoOn &go_on) const override {
        constexpr std::int64_t widest = widest_packet;
        Buffer buffer(targets, scene.light_count, settings.max_reflections);
        alignas(64) Real directions[span_columns];
        const Grid across = grid(settings.sample, true, view.columns);
        const Grid down = grid(settings.sample, false, view.rows);
        for (std::int64_t pixel = begin; pixel < end;) {
            const std::int64_t row = pixel / view.columns;
            const std::int64_t column = pixel % view.columns;
            const std::int64_t count = std::min({span_columns, view.columns - column, end - pixel});
            const std::int64_t padded = (count + widest - 1) / widest * widest;
            for (std::int64_t k = 0; k < padded; ++k) {
                const double c = static_cast<double>(column + std::min(k, count - 1));
                directions[k] =
                    static_cast<Real>(view.left + (view.right - view.left) * (c + across.offset) / across.steps);
            }
            const double j = static_cast<double>(row);
            const double y = view.top - (view.top - view.bottom) * (j + down.offset) / down.steps;
            buffer.clear();
            trace(scene, {directions, static_cast<Real>(y), static_cast<Real>(-view.near_plane),
                          static_cast<std::size_t>(padded), buffer.planes});
            for (const Target &target : targets) deliver(target, buffer.planes_of(target), pixel - first, count);
            pixel += count;
            if (!go_on(count)) return;
        }
    }
};

Renderer::Renderer(const Scene &scene, const Settings &settings) {
    const DefaultFloatingPoint modes;
    std::string problem;
    const Kernels *kernels = choose(problem);
    if (settings.precision == Precision::f64) {
        prepared = new PreparedFor<double>(scene, settings, kernels->f64);
    } else {
        prepared = new PreparedFor<float>(scene, settings, kernels->f32);
    }
}

Renderer::~Renderer() { delete prepared; }

bool Renderer::render(std::int64_t first, std::int64_t last, const std::vector<Target> &targets,
                      const Poll &poll) const {
    using Clock = std::chrono::steady_clock;
    constexpr auto poll_interval = std::chrono::milliseconds(50);
    std::atomic<std::int64_t> next{first};
    std::atomic<std::int64_t> done{0};
    std::atomic<bool> stopped{false};
    std::mutex failing;
    std::exception_ptr failure;

    const auto work = [&](bool may_poll) {
        const DefaultFloatingPoint modes;
        auto polled = Clock::now();
        const Prepared::GoOn go_on = [&](std::int64_t count) {
            done.fetch_add(count, std::memory_order_relaxed);
            if (may_poll && Clock::now() - polled > poll_interval) {
                if (!poll(done.load(std::memory_order_relaxed))) stopped = true;
                polled = Clock::now();
            }
            return !stopped.load(std::memory_order_relaxed);
        };
        try {
            while (!stopped.load(std::memory_order_relaxed)) {
                const std::int64_t begin = next.fetch_add(piece, std::memory_order_relaxed);
                if (begin >= last) return;
                prepared->pixels(begin, std::min(begin + piece, last), first, targets, go_on);
            }
        } catch (...) {  // out of memory: the calling thread says so once all have come to an end
            const std::lock_guard lock(failing);
            failure = std::current_exception();
            stopped = true;
        }
    };

    std::int64_t threads = prepared->settings.threads;
    if (threads == 0) {
        threads = std::min<std::int64_t>(std::max(1U, std::thread::hardware_concurrency()),
                                         std::max<std::int64_t>(1, (last - first) / pixels_for_a_thread));
    }
    threads = std::min<std::int64_t>({threads, (last - first + piece - 1) / piece, most_threads});
    std::vector<std::thread> helpers;
    helpers.reserve(static_cast<std::size_t>(threads));
    try {
        for (std::int64_t k = 1; k < threads; ++k) helpers.emplace_back(work, false);
    } catch (const std::system_error &) {
        // The system gives no more threads: those there are do the work.
    }
    work(static_cast<bool>(poll));
    for (std::thread &helper : helpers) helper.join();
    if (failure) std::rethrow_exception(failure);
    return !stopped;
}

}  // namespace whitted
