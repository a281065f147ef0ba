// cuts FIRST COUNT: draws random scenes with cuts and without, on every instruction set there is. The bytes of all
// passes must be the same. Prints the seeds of scenes where they are not; exit status 1.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "render.hpp"
#include "scene.hpp"

namespace {

using namespace whitted;
using Bytes = std::vector<unsigned char>;

class Random {
  public:
    explicit Random(std::uint64_t seed) : source(seed * 7919 + 17) {}
    double between(double low, double high) {
        return low + (high - low) * static_cast<double>(source() >> 11) * 0x1p-53;
    }
    std::size_t below(std::size_t count) { return source() % count; }
    bool chance(double part) { return between(0, 1) < part; }
    // Often one that other numbers are equal to.
    double number(double span) {
        return chance(0.4) ? static_cast<double>(below(9)) * span / 4 - span : between(-span, span);
    }
    template <class T, std::size_t count>
    T one_of(const T (&values)[count]) {
        return values[below(count)];
    }

  private:
    std::mt19937_64 source;
};

enum class Kind { plain, coincident, eye_inside, ground, flat, tiny, near_cut, tangent, nested, far, out_of_scale };
constexpr std::size_t kinds = 11;

// What makes a sphere hard to cut.
void make_hard(Sphere &sphere, Kind kind, std::size_t index, const Scene &scene, Random &random) {
    switch (kind) {
        case Kind::coincident:
            for (double &x : sphere.position) x = random.number(4);
            sphere.position[2] -= 2;
            for (double &s : sphere.scaling) s = random.one_of({0.25, 0.5, 1.0, 2.0, 4.0, random.between(0.1, 5)});
            break;
        case Kind::eye_inside:
            if (index > 0) break;
            sphere.position = {0, 0, 0};
            sphere.position[random.below(3)] = random.number(2);
            for (double &s : sphere.scaling) s = random.between(3, 9);
            break;
        case Kind::ground: {
            if (index > 0) break;
            const double radius = std::pow(10, random.between(2, 7));
            sphere.position = {random.between(-1, 1), -radius - random.between(0.3, 3), random.between(-5, 5)};
            sphere.scaling = {radius, radius, radius};
            break;
        }
        case Kind::flat:
            sphere.scaling[random.below(3)] *= std::pow(10, random.between(-3, -1));
            break;
        case Kind::tiny: {
            const double part = std::pow(10, random.between(-4, -2));
            for (double &s : sphere.scaling) s *= part;
            break;
        }
        case Kind::near_cut:
            if (index < 3)
                sphere.position = {random.number(2), random.number(2),
                                   -scene.view.near_plane - random.between(-0.5, 0.5)};
            break;
        case Kind::tangent: {  // to a plane through the eye
            if (index > 1) break;
            const std::size_t axis = random.below(2);
            sphere.position[2] = random.between(-3, 0.5);
            sphere.position[axis] = (random.chance(0.5) ? 1 : -1) * sphere.scaling[axis] *
                                    (random.chance(0.5) ? 1 : random.between(1, 1.01));
            break;
        }
        case Kind::nested:
            if (index == 0 || random.chance(0.4)) break;
            sphere.position = scene.spheres[0].position;
            for (double &x : sphere.position)
                if (random.chance(0.5)) x += random.number(1);
            if (random.chance(0.4)) {
                sphere.scaling = scene.spheres[0].scaling;
                const double part = random.chance(0.5) ? 1 + 1e-9 : random.between(0.9, 1.1);
                for (double &s : sphere.scaling) s *= part;
            }
            break;
        case Kind::far: {
            const double distance = std::pow(10, random.between(1, 3));
            sphere.position = {random.between(-1, 1) * distance, random.between(-1, 1) * distance, -distance};
            for (double &s : sphere.scaling) s *= random.between(0.1, 20);
            break;
        }
        default:
            break;
    }
}

Vec3 light_place(const Scene &scene, Random &random) {
    Vec3 place{random.between(-8, 8), random.between(-8, 8), random.between(-12, 4)};
    const Sphere &sphere = scene.spheres[random.below(scene.spheres.size())];
    switch (random.below(8)) {
        case 0:
            for (double &x : place) x = random.number(4);
            break;
        case 1:
            return sphere.position;
        case 2: {  // on the surface
            place = sphere.position;
            const std::size_t axis = random.below(3);
            place[axis] += (random.chance(0.5) ? 1 : -1) * sphere.scaling[axis];
            break;
        }
        case 3: {  // or just beside it
            double direction[3];
            double length = 0;
            for (double &x : direction) {
                x = random.between(-1, 1);
                length += x * x;
            }
            const double off = random.chance(0.5) ? 0 : std::pow(10, random.between(-15, -1));
            const double part = (1 + (random.chance(0.5) ? off : -off)) / std::sqrt(length);
            for (std::size_t k = 0; k < 3; ++k) place[k] = sphere.position[k] + sphere.scaling[k] * direction[k] * part;
            break;
        }
        case 4:
            return {0, 0, 0};
        default:
            break;
    }
    return place;
}

Scene make(std::uint64_t seed) {
    Random random(seed);
    const Kind kind = static_cast<Kind>(random.below(kinds));
    const double unit = kind == Kind::out_of_scale ? std::pow(10, random.between(-6, 6)) : 1;
    Scene scene;
    View &view = scene.view;
    view.columns = 20 + static_cast<std::int64_t>(random.below(60));
    view.rows = 10 + static_cast<std::int64_t>(random.below(30));
    view.near_plane = random.one_of({0.5, 1.0, 2.0, 0.05, 1.0});
    const double half = view.near_plane * (random.chance(0.7) ? random.between(0.2, 1.3) : random.between(0.01, 0.1));
    view.left = -half * random.between(0.5, 1);
    view.right = half * random.between(0.5, 1);
    view.bottom = -half * random.between(0.5, 1);
    view.top = half * random.between(0.5, 1);
    if (random.chance(0.15)) {
        const double aside = random.number(3) * half;
        const double up = random.number(3) * half;
        view.left += aside;
        view.right += aside;
        view.bottom += up;
        view.top += up;
    }
    const std::size_t sphere_count = 1 + random.below(6);
    const std::size_t light_count = random.below(5);
    for (std::size_t k = 0; k < sphere_count; ++k) {
        Sphere sphere;
        sphere.name = "s";
        const double depth = random.chance(0.8) ? random.between(1, 12) : random.between(-6, 14);
        const double width = 0.8 * std::abs(depth);
        sphere.position = {random.between(-width, width), random.between(-width, width), -depth};
        const double size = random.chance(0.5) ? random.between(0.2, 1.5) : random.between(0.5, 4);
        const bool round = random.chance(0.5);
        for (double &s : sphere.scaling) s = size * (round ? 1 : random.between(0.3, 1.5));
        make_hard(sphere, kind, k, scene, random);
        for (double &x : sphere.position) x *= unit;
        for (double &s : sphere.scaling) s *= unit;
        for (double &c : sphere.color) c = random.between(0, 1);
        sphere.ka = random.between(0, 1);
        sphere.kd = random.one_of({0.0, 0.5, 1.0});
        sphere.ks = random.one_of({0.0, 0.5, 1.0});
        sphere.kr = random.one_of({0.0, 0.3, 0.7, 1.0});
        sphere.exponent = random.one_of({0.0, 0.5, 1.0, 2.0, 7.5, 30.0, 50.0, 200.0, 1000.0});
        scene.spheres.push_back(sphere);
    }
    if (kind == Kind::far) {  // look at the first one
        const Sphere &sphere = scene.spheres[0];
        const double scale = view.near_plane / -sphere.position[2];
        const double width = 3 * std::abs(sphere.scaling[0]) * scale * random.between(0.5, 3);
        view.left = sphere.position[0] * scale - width;
        view.right = sphere.position[0] * scale + width;
        view.bottom = sphere.position[1] * scale - width;
        view.top = sphere.position[1] * scale + width;
    }
    for (std::size_t k = 0; k < light_count; ++k) {
        Light light;
        light.name = "l";
        light.position = light_place(scene, random);
        for (double &i : light.intensity) i = random.chance(0.1) ? 0 : random.between(-0.2, 1);
        if (random.chance(0.05)) light.intensity = {0, 0, 0};
        scene.lights.push_back(light);
    }
    for (double &c : scene.background) c = random.between(0, 1);
    for (double &c : scene.ambient) c = random.between(0, 1);
    return scene;
}

// The bytes of passes, one after the other. What is asked for decides which way a kernel takes.
enum class Asked { bytes, colors, all };

Bytes draw(const Scene &scene, const Settings &settings, std::int64_t band, Asked asked) {
    std::vector<Target> targets{{PassKind::beauty8}};
    if (asked != Asked::bytes) {
        for (const PassKind kind :
             {PassKind::beauty, PassKind::ambient, PassKind::diffuse, PassKind::specular, PassKind::direct,
              PassKind::reflection, PassKind::depth, PassKind::position, PassKind::normal, PassKind::id})
            targets.push_back({kind});
        for (int bounce = 1; bounce <= settings.max_reflections; ++bounce)
            targets.push_back({PassKind::reflection_order, bounce});
    }
    if (asked == Asked::all)
        for (std::size_t light = 0; light < scene.lights.size(); ++light)
            targets.push_back({PassKind::shadow, static_cast<int>(light)});

    const std::int64_t pixels = scene.view.columns * scene.view.rows;
    std::vector<Bytes> data;
    std::vector<std::size_t> sizes;
    for (const Target &target : targets) {
        sizes.push_back(static_cast<std::size_t>(channels(target.kind)) * value_size(target.kind, settings.precision));
        data.emplace_back(static_cast<std::size_t>(pixels) * sizes.back(), static_cast<unsigned char>(0xAA));
    }
    const Renderer renderer(scene, settings);
    for (std::int64_t first = 0; first < pixels; first += band) {
        for (std::size_t k = 0; k < targets.size(); ++k)
            targets[k].data = data[k].data() + static_cast<std::size_t>(first) * sizes[k];
        renderer.render(first, std::min(first + band, pixels), targets, {});
    }
    Bytes all;
    for (const Bytes &bytes : data) all.insert(all.end(), bytes.begin(), bytes.end());
    return all;
}

std::vector<std::string> instruction_sets() {
    std::vector<std::string> there;
    for (const char *name : {"scalar", "sse2", "avx2", "avx512", "neon"}) {
        setenv("WHITTED_ISA", name, 1);
        std::string problem;
        if (!instruction_set(problem).empty()) there.emplace_back(name);
    }
    return there;
}

}  // namespace

int main(int count, char **arguments) {
    if (count != 3) {
        std::fputs("usage: cuts FIRST COUNT\n", stderr);
        return 2;
    }
    const std::uint64_t first = std::strtoull(arguments[1], nullptr, 10);
    const std::uint64_t scenes = std::strtoull(arguments[2], nullptr, 10);
    const std::vector<std::string> sets = instruction_sets();
    long drawn = 0;
    long wrong = 0;
    for (std::uint64_t seed = first; seed < first + scenes; ++seed) {
        const Scene scene = make(seed);
        if (!check(scene, false).empty()) continue;
        const std::int64_t pixels = scene.view.columns * scene.view.rows;
        for (const Precision precision : {Precision::f64, Precision::f32}) {
            if (precision == Precision::f32 && !check_float32(scene).empty()) continue;
            Settings settings;
            settings.precision = precision;
            settings.sample = static_cast<Sample>(seed / 5 % 5);
            constexpr double epsilons[] = {1e-4, 1e-4, 1e-3, 0, 0.05};
            settings.shadow_epsilon = epsilons[seed % 5];
            settings.max_reflections = seed % 7 == 0 ? 5 : seed % 7 == 1 ? 0 : 3;
            for (const Asked asked : {Asked::bytes, Asked::colors, Asked::all}) {
                settings.cuts = false;
                settings.threads = 1;
                setenv("WHITTED_ISA", sets.front().c_str(), 1);
                const Bytes expected = draw(scene, settings, pixels, asked);
                settings.cuts = true;
                settings.threads = 1 + static_cast<int>(seed % 3);
                const std::int64_t band =
                    seed % 4 == 0 ? 1 + static_cast<std::int64_t>(seed * 37 % static_cast<std::uint64_t>(pixels))
                                  : pixels;
                for (const std::string &set : sets) {
                    setenv("WHITTED_ISA", set.c_str(), 1);
                    ++drawn;
                    if (draw(scene, settings, band, asked) == expected) continue;
                    std::printf("seed %llu, %s, %s\n", static_cast<unsigned long long>(seed), set.c_str(),
                                precision == Precision::f64 ? "f64" : "f32");
                    ++wrong;
                }
            }
        }
    }
    std::printf("%ld images of %llu scenes, %ld differ\n", drawn, static_cast<unsigned long long>(scenes), wrong);
    return wrong != 0;
}
