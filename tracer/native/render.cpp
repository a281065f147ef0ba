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
#include <numeric>
#include <set>
#include <system_error>
#include <thread>

#include "constants.hpp"
#include "cuts.hpp"
#include "light_side.hpp"
#include "ppm.hpp"

namespace whitted {

namespace {

// What a thread takes at a time: long enough to make the taking cheap, short enough to share the work evenly.
constexpr std::int64_t piece = 8192;
// The same where a system call follows each time; three bytes each stay in the second-level cache.
constexpr std::int64_t streamed_piece = 65536;
// How often a thread asks whether to go on.
constexpr std::int64_t pixels_to_report = 2048;
// Below this many pixels a second thread costs more than it saves.
constexpr std::int64_t pixels_for_a_thread = 16384;
// How much background is copied at a time.
constexpr std::int64_t pattern_columns = 4096;
// Up to here the places of all columns are kept; up to here what concerns two spheres and a light, too.
constexpr std::int64_t most_columns_kept = 1 << 17;
constexpr std::size_t most_spheres_kept = 256;
constexpr std::size_t most_blockers_sought = 1 << 16;

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
    using GoOn = Renderer::GoOn;
    // Renders pixels begin .. end - 1, counted row by row; the targets begin with pixel `first`.
    virtual void pixels(std::int64_t begin, std::int64_t end, std::int64_t first, const std::vector<Target> &targets,
                        const GoOn &go_on) const = 0;
};

template <class Real>
struct Renderer::PreparedFor final : Renderer::Prepared {
    static constexpr double unit_roundoff = sizeof(Real) == 8 ? 0x1p-53 : 0x1p-24;
    // A span is the part of a row that a kernel fills at a time.
    static constexpr std::int64_t span_columns = widest_span<Real>;
    static_assert(widest_span<Real> % widest_packet == 0);

    std::vector<SphereConstants<Real>> spheres;
    std::vector<Lamp<Real>> lamps;
    std::vector<Real> from_others;
    std::vector<std::int32_t> everything;  // 0, 1 ..: the places of the spheres
    std::vector<std::int32_t> blocking;

    std::vector<Silhouette> silhouettes;  // empty: nothing is cut
    std::vector<Real> columns;            // x of each column, the last one again up to a packet; empty: too many
    std::uint8_t background8[3 * pattern_columns];
    Grid across, down;
    double blur;  // bound above the roundings of a place in a row, in columns
    SceneConstants<Real> scene{};
    TraceSpan<Real> trace;

    PreparedFor(const Scene &from, const Settings &chosen, TraceSpan<Real> kernel) : trace(kernel) {
        view = from.view;
        settings = chosen;
        const bool cuts = settings.cuts && can_cut(from, unit_roundoff);
        const std::vector<std::size_t> distinct = from.distinct();
        const std::size_t light_count = from.lights.size();
        const Extent extent(from);
        lamps.reserve(distinct.size() * light_count);
        spheres.reserve(distinct.size());
        if (distinct.size() <= most_spheres_kept) from_others.reserve(distinct.size() * distinct.size() * 3);

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
            to.steep = is_steep(sphere, extent);
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
            to.lamps = lamps.data() + lamps.size();
            for (const Light &light : from.lights) {
                Lamp<Real> lamp{};
                for (std::size_t k = 0; k < 3; ++k) {
                    lamp.place[k] = static_cast<Real>(light.position[k] - sphere.position[k]);
                    lamp.end[k] =
                        static_cast<Real>((light.position[k] - sphere.position[k]) / std::abs(sphere.scaling[k]));
                    lamp.diffuse[k] = static_cast<Real>(sphere.kd * light.intensity[k]);
                    lamp.specular[k] = static_cast<Real>(sphere.ks * light.intensity[k]);
                }
                lamp.side = light_side(sphere, light);
                lamp.adds = to.lit && light.intensity != Vec3{0, 0, 0};
                lamps.push_back(lamp);
            }
            if (distinct.size() <= most_spheres_kept) {
                to.from_others = from_others.data() + from_others.size();
                for (const std::size_t other : distinct)
                    for (std::size_t k = 0; k < 3; ++k)
                        from_others.push_back(static_cast<Real>(sphere.position[k] - from.spheres[other].position[k]));
            }
            if (cuts) silhouettes.emplace_back(sphere, view, unit_roundoff);
            spheres.push_back(to);
        }
        find_blockers(from, distinct, cuts);
        scene.doubt = cuts ? static_cast<Real>(256 * unit_roundoff) : std::numeric_limits<Real>::infinity();
        scene.span_lists = cuts && distinct.size() <= most_spheres_kept;
        scene.spheres = spheres.data();

        scene.sphere_count = spheres.size();
        scene.light_count = light_count;
        narrow(scene.background, from.background);
        scene.shadow_epsilon = static_cast<Real>(settings.shadow_epsilon);
        scene.certain_epsilon = static_cast<Real>(settings.shadow_epsilon * (1 + 64 * unit_roundoff));
        scene.max_reflections = settings.max_reflections;

        for (std::size_t k = 0; k < sizeof background8; ++k) background8[k] = quantise(scene.background[k % 3]);
        across = grid(settings.sample, true, view.columns);
        down = grid(settings.sample, false, view.rows);
        blur = 0x1p-10 + 16 * unit_roundoff * across.steps * std::max(std::abs(view.left), std::abs(view.right)) /
                             (view.right - view.left);
        if (view.columns <= most_columns_kept) {
            columns.resize(static_cast<std::size_t>(view.columns) + widest_packet);
            places(columns.data(), 0, view.columns);
        }
    }

    void find_blockers(const Scene &from, const std::vector<std::size_t> &distinct, bool cuts) {
        const std::size_t count = distinct.size();
        const std::size_t light_count = from.lights.size();
        everything.resize(count);
        std::iota(everything.begin(), everything.end(), 0);
        scene.all = {everything.data(), everything.data() + count};
        const bool all = !cuts || count * count * light_count > most_blockers_sought;
        std::vector<std::size_t> ends;
        if (!all) {
            for (const std::size_t i : distinct) {
                const Sphere &surface = from.spheres[i];
                const double reach = farthest_ray(surface, from);
                for (const Light &light : from.lights) {
                    for (std::size_t j = 0; j < count; ++j) {
                        const Sphere &other = from.spheres[distinct[j]];
                        if (distinct[j] != i && !cannot_block(surface, reach, light, other, unit_roundoff))
                            blocking.push_back(static_cast<std::int32_t>(j));
                    }
                    ends.push_back(blocking.size());
                }
            }
        }
        std::size_t begin = 0;
        for (std::size_t k = 0; k < count * light_count; ++k) {
            lamps[k].blockers = all ? scene.all : SphereList{blocking.data() + begin, blocking.data() + ends[k]};
            if (!all) begin = ends[k];
        }
    }

    // How far from the surface, in units of its |s|, rays start: at the eye, or on a mirror.
    static double farthest_ray(const Sphere &surface, const Scene &from) {
        const auto distance = [&](const Vec3 &position, const Vec3 &scaling) {
            double sum = 0;
            for (std::size_t k = 0; k < 3; ++k)
                sum += (std::abs(position[k] - surface.position[k]) + 2 * std::abs(scaling[k])) /
                       std::abs(surface.scaling[k]);
            return sum;
        };
        double farthest = distance({0, 0, 0}, {0, 0, 0});
        for (const Sphere &sphere : from.spheres)
            if (sphere.kr != 0) farthest = std::max(farthest, distance(sphere.position, sphere.scaling));
        return farthest;
    }

    // The box that all rays start in: the eye and all surfaces, with some room for their roundings.
    struct Extent {
        Vec3 low{}, high{};
        explicit Extent(const Scene &from) {
            for (const Sphere &sphere : from.spheres)
                for (std::size_t k = 0; k < 3; ++k) {
                    low[k] = std::min(low[k], sphere.position[k] - 2 * std::abs(sphere.scaling[k]));
                    high[k] = std::max(high[k], sphere.position[k] + 2 * std::abs(sphere.scaling[k]));
                }
        }
    };

    // A ray all but along the thin axis of a plate comes from |o| = h away in its unit space. There the square of 3 u h
    // is to stay below the roundings of D that moving the plate makes, u max(1, h/ratio).
    static bool is_steep(const Sphere &sphere, const Extent &extent) {
        double narrow = std::abs(sphere.scaling[0]), wide = narrow, farthest = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            const double scale = std::abs(sphere.scaling[k]);
            narrow = std::min(narrow, scale);
            wide = std::max(wide, scale);
            farthest += std::max(sphere.position[k] - extent.low[k], extent.high[k] - sphere.position[k]) / scale;
        }
        return wide / narrow * farthest > 1 / (64 * unit_roundoff);
    }

    // x of columns first .. first + count - 1, and the last one again up to a packet more.
    void places(Real *to, std::int64_t first, std::int64_t count) const {
        for (std::int64_t k = 0; k < count; ++k) {
            const double c = static_cast<double>(first + k);
            to[k] = static_cast<Real>(view.left + (view.right - view.left) * (c + across.offset) / across.steps);
        }
        std::fill_n(to + count, widest_packet, to[count - 1]);
    }

    // The outlines in a row at height y, cut to the columns begin .. end - 1.
    void outline_row(Real y, std::int64_t begin, std::int64_t end, std::vector<Outline> &outlines) const {
        outlines.clear();
        for (std::size_t j = 0; j < spheres.size(); ++j) {
            Outline outline{static_cast<std::int32_t>(j), begin, end};
            if (!silhouettes.empty()) {
                const Silhouette::Interval part = silhouettes[j].row(static_cast<double>(y));
                if (part.is_empty()) continue;
                const double scale = across.steps / (view.right - view.left);
                const double low = (part.low - view.left) * scale - across.offset - blur;
                const double high = (part.high - view.left) * scale - across.offset + blur;
                if (low > static_cast<double>(begin)) {
                    if (low >= static_cast<double>(end)) continue;
                    outline.begin = static_cast<std::int64_t>(std::ceil(low));
                }
                if (high < static_cast<double>(end - 1)) {
                    if (high < static_cast<double>(begin)) continue;
                    outline.end = static_cast<std::int64_t>(std::floor(high)) + 1;
                }
                if (outline.begin >= outline.end) continue;
            }
            outlines.push_back(outline);
        }
    }

    // The planes of one span and the memory behind them.
    struct Buffer {
        std::vector<Real> values;
        std::vector<Real *> shadow;
        std::vector<Real *> reflection_order;
        Planes<Real> planes{};
        std::vector<Outline> outlines;
        std::vector<std::pair<std::int64_t, std::int64_t>> runs;  // the same by their beginnings
        Real directions[span_columns + widest_packet];
        bool only_bytes;  // nothing but the beauty in 8 bits is asked for: it needs no planes

        Buffer(const std::vector<Target> &targets, std::size_t light_count, int max_reflections)
            : only_bytes(std::all_of(targets.begin(), targets.end(),
                                     [](const Target &t) { return t.kind == PassKind::beauty8; })) {
            const auto wanted = [&](PassKind kind) {
                return std::any_of(targets.begin(), targets.end(), [&](const Target &t) { return t.kind == kind; });
            };
            if (wanted(PassKind::shadow)) shadow.resize(light_count);
            if (wanted(PassKind::reflection_order))
                reflection_order.resize(3 * static_cast<std::size_t>(max_reflections));
            std::set<Real **> used;  // memory only for what is asked for: there are up to 1000 bounces
            if (!only_bytes)
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

    // Where nothing is hit.
    void fill(const Target &target, std::int64_t pixel, std::int64_t count) const {
        const std::int64_t width = channels(target.kind);
        if (target.kind == PassKind::beauty8) {
            std::uint8_t *to = static_cast<std::uint8_t *>(target.data) + 3 * pixel;
            for (std::int64_t k = 0; k < count; k += pattern_columns)
                std::memcpy(to + 3 * k, background8,
                            static_cast<std::size_t>(3 * std::min(pattern_columns, count - k)));
        } else if (target.kind == PassKind::id) {
            std::fill_n(static_cast<std::int32_t *>(target.data) + pixel, count, -1);
        } else if (target.kind == PassKind::depth) {
            std::fill_n(static_cast<Real *>(target.data) + pixel, count, std::numeric_limits<Real>::infinity());
        } else if (target.kind == PassKind::beauty) {
            Real *to = static_cast<Real *>(target.data) + 3 * pixel;
            for (std::int64_t k = 0; k < 3 * count; ++k) to[k] = scene.background[k % 3];
        } else {
            std::fill_n(static_cast<Real *>(target.data) + width * pixel, width * count, Real(0));
        }
    }

    // Traces pixels of one row that begins with pixel `row`, counted from the targets' first; y is its height.
    void trace_run(std::int64_t row, Real y, std::int64_t begin, std::int64_t end, Buffer &buffer,
                   const std::vector<Target> &targets, std::int64_t &finished, const GoOn &go_on, bool &stopped) const {
        constexpr std::int64_t widest = widest_packet;
        const std::int64_t spans = (end - begin + span_columns - 1) / span_columns;
        const std::int64_t even = ((end - begin + spans - 1) / spans + widest - 1) / widest * widest;
        for (std::int64_t column = begin; column < end && !stopped; column += even) {
            const std::int64_t count = std::min(even, end - column);
            const Real *directions = columns.data() + column;
            if (columns.empty()) {
                places(buffer.directions, column, count);
                directions = buffer.directions;
            }
            Span<Real> span{directions,
                            y,
                            static_cast<Real>(-view.near_plane),
                            column,
                            static_cast<std::size_t>(count),
                            buffer.outlines.data(),
                            buffer.outlines.size(),
                            buffer.planes,
                            nullptr};
            if (buffer.only_bytes) {
                for (const Target &target : targets) {
                    span.bytes = static_cast<std::uint8_t *>(target.data) + 3 * (row + column);
                    trace(scene, span);
                }
            } else {
                buffer.clear();
                trace(scene, span);
                for (const Target &target : targets) deliver(target, buffer.planes_of(target), row + column, count);
            }
            finished += count;
            if (finished < pixels_to_report) continue;
            stopped = !go_on(finished);
            finished = 0;
        }
    }

    void pixels(std::int64_t begin, std::int64_t end, std::int64_t first, const std::vector<Target> &targets,
                const GoOn &go_on) const override {
        Buffer buffer(targets, scene.light_count, settings.max_reflections);
        bool stopped = false;
        std::int64_t finished = 0;  // and not yet reported: that costs as much as some packets
        for (std::int64_t pixel = begin; pixel < end && !stopped;) {
            const std::int64_t row = pixel / view.columns;
            const std::int64_t from = pixel % view.columns;
            const std::int64_t to = std::min(view.columns, from + (end - pixel));
            const std::int64_t start = row * view.columns - first;
            const double j = static_cast<double>(row);
            const Real y = static_cast<Real>(view.top - (view.top - view.bottom) * (j + down.offset) / down.steps);
            outline_row(y, from, to, buffer.outlines);
            buffer.runs.clear();
            for (const Outline &outline : buffer.outlines) buffer.runs.emplace_back(outline.begin, outline.end);
            std::sort(buffer.runs.begin(), buffer.runs.end());
            std::size_t next = 0;
            // From run to run: what is covered by the outlines, and what lies between.
            for (std::int64_t column = from; column < to && !stopped;) {
                const std::int64_t run = next < buffer.runs.size() ? buffer.runs[next].first : to;
                if (run > column) {
                    for (const Target &target : targets) fill(target, start + column, run - column);
                    finished += run - column;
                    column = run;
                    continue;
                }
                std::int64_t run_end = run;
                for (; next < buffer.runs.size() && buffer.runs[next].first <= run_end; ++next)
                    run_end = std::max(run_end, buffer.runs[next].second);
                trace_run(start, y, column, run_end, buffer, targets, finished, go_on, stopped);
                column = run_end;
            }
            pixel += to - from;
        }
        go_on(finished);
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
    const auto worker = [&]() -> Piece {
        return [&](std::int64_t begin, std::int64_t end, const GoOn &go_on) {
            prepared->pixels(begin, end, first, targets, go_on);
            return true;
        };
    };
    return share(first, last, prepared->settings.piece > 0 ? prepared->settings.piece : piece, worker, poll);
}

bool Renderer::stream(const Deliver &deliver, const Poll &poll) const {
    const std::int64_t pixels = prepared->view.columns * prepared->view.rows;
    // Eight pieces a processor share the work of a small image evenly.
    const std::int64_t processors = std::max(1U, std::thread::hardware_concurrency());
    const std::int64_t even = std::clamp(pixels / (8 * processors), piece, streamed_piece);
    const std::int64_t size = prepared->settings.piece > 0 ? prepared->settings.piece : even;
    const auto worker = [&]() -> Piece {
        return [&, bytes = std::vector<std::uint8_t>(static_cast<std::size_t>(3 * std::min(size, pixels)))](
                   std::int64_t begin, std::int64_t end, const GoOn &go_on) mutable {
            std::int64_t done = 0;
            const GoOn count = [&](std::int64_t more) {
                done += more;
                return go_on(more);
            };
            prepared->pixels(begin, end, begin, {{PassKind::beauty8, 0, bytes.data()}}, count);
            return done == end - begin && deliver(begin, end, bytes.data());
        };
    };
    return share(0, pixels, size, worker, poll);
}

bool Renderer::share(std::int64_t first, std::int64_t last, std::int64_t size, const std::function<Piece()> &worker,
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
            const Piece render_piece = worker();
            while (!stopped.load(std::memory_order_relaxed)) {
                const std::int64_t begin = next.fetch_add(size, std::memory_order_relaxed);
                if (begin >= last) return;
                if (!render_piece(begin, std::min(begin + size, last), go_on)) stopped = true;
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
    threads = std::min<std::int64_t>({threads, (last - first + size - 1) / size, most_threads});
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
