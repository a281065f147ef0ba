// Draws scenes in every way there is: the bytes of all passes must be the same.
//
//     bits random FIRST COUNT     random scenes that are hard to cut, each in a few ways
//     bits SCENE...               files, in a small size, in all ways
//
// The ways: every instruction set of this machine, several threads, the image in bands and pieces that no packet fits,
// arrays or bytes or a stream. What they are held against is drawn without cuts, in one piece, by one thread, one ray
// at a time. Prints what differs, exit status 1; and a hash of all bytes, the same on every processor and from every
// compiler.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "ppm.hpp"
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

double product(const Vec3 &a, const Vec3 &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

Vec3 sum(const Vec3 &a, double s, const Vec3 &b) { return {a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]}; }

Vec3 direction(Random &random) {
    for (;;) {
        const Vec3 v{random.between(-1, 1), random.between(-1, 1), random.between(-1, 1)};
        const double length = std::sqrt(product(v, v));
        if (length > 0.1 && length < 1) return sum({}, 1 / length, v);
    }
}

// A huge ball that is no axis' own, small ones at a place on it, and a window about the edge of the shadow of the
// first: what is decided there hangs on the roundings of the huge one.
Scene make_huge(std::uint64_t seed) {
    Random random(seed);
    Scene scene;
    const bool mirror = random.chance(0.3);
    const double radius = std::pow(10, random.chance(0.2) ? random.between(13, 15) : random.between(2, 6.5));
    const Vec3 place{random.between(-1, 1), random.between(-1, 1), -random.between(3, 8)};
    Vec3 up = direction(random);
    if (product(up, place) > 0) up = sum({}, -1, up);
    const auto add = [&](const Vec3 &center, double size, double kr) {
        Sphere sphere;
        sphere.name = "s";
        sphere.position = center;
        sphere.scaling = {size, size, size};
        sphere.color = {0.9, 0.5, 0.3};
        sphere.ka = 0.2;
        sphere.kd = 0.7;
        sphere.ks = 0.5;
        sphere.kr = kr;
        sphere.exponent = 8;
        scene.spheres.push_back(sphere);
    };
    add(sum(place, -radius, up), radius, mirror ? 0.8 : 0);
    const double size = random.between(0.2, 0.5);
    const Vec3 center = sum(place, size * random.between(1, 2), up);
    add(center, size, 0);
    if (mirror)  // all but below the plane that touches the mirror at the place
        for (int k = 0; k < 2; ++k) {
            const double own = std::pow(10, random.between(-2, 0.5));
            Vec3 aside = direction(random);
            aside = sum(aside, -product(aside, up), up);
            const double gap = (random.chance(0.5) ? 1 : -1) * std::pow(10, random.between(-8, -1));
            add(sum(sum(place, random.between(0.1, 10), aside), -own * (1 + gap), up), own, 0);
        }
    Light light;
    light.name = "l";
    light.position = sum(sum(place, random.between(2, 5), up), 2, direction(random));
    light.intensity = {0.7, 0.6, 0.5};
    scene.lights.push_back(light);
    // Where the ray from the light that touches the small ball meets the plane through the place.
    const Vec3 to_center = sum(center, -1, light.position);
    Vec3 across = direction(random);
    across = sum(across, -product(across, to_center) / product(to_center, to_center), to_center);
    const double off = size * random.between(0.9, 1.1) / std::sqrt(product(across, across));
    const Vec3 touching = sum(to_center, off, across);
    const double t = product(sum(place, -1, light.position), up) / product(touching, up);
    Vec3 edge = t > 0 ? sum(light.position, t, touching) : place;
    if (!(edge[2] < -0.2)) edge = place;
    const double half = std::pow(10, random.between(-5, -1));
    scene.view = {1,
                  edge[0] / -edge[2] - half,
                  edge[0] / -edge[2] + half,
                  edge[1] / -edge[2] - half,
                  edge[1] / -edge[2] + half,
                  1 + static_cast<std::int64_t>(random.below(3)),
                  8 + static_cast<std::int64_t>(random.below(30))};
    scene.background = {0.1, 0.2, 0.3};
    scene.ambient = {0.5, 0.5, 0.5};
    return scene;
}

// More spheres than there are lists for.
Scene make_many(std::uint64_t seed) {
    Random random(seed);
    Scene scene = make(seed);
    const std::vector<Sphere> some = scene.spheres;
    for (int k = 0; k < 300; ++k) {
        Sphere sphere = some[random.below(some.size())];
        sphere.position = {random.between(-4, 4), random.between(-4, 4), -random.between(2, 12)};
        for (double &s : sphere.scaling) s = random.between(0.05, 0.6);
        scene.spheres.push_back(sphere);
    }
    return scene;
}

// The bytes of passes, one after the other. What is asked for decides which way a kernel takes.
enum class Asked { bytes, colors, all };
constexpr const char *asked_names[] = {"bytes", "colors", "all passes"};

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

Bytes stream(const Scene &scene, const Settings &settings) {
    Bytes all(static_cast<std::size_t>(3 * scene.view.columns * scene.view.rows), static_cast<unsigned char>(0xAA));
    const auto deliver = [&](std::int64_t begin, std::int64_t end, const std::uint8_t *bytes) {
        std::copy_n(bytes, 3 * (end - begin), all.begin() + 3 * begin);
        return true;
    };
    Renderer(scene, settings).stream(deliver, {});
    return all;
}

// Whether 8 bits drawn by themselves are those of the colors, whose first passes are beauty8 and beauty.
template <class Real>
bool is_quantised(const Bytes &bytes, const Bytes &colors) {
    for (std::size_t k = 0; k < bytes.size(); ++k) {
        Real value;
        std::memcpy(&value, colors.data() + bytes.size() + k * sizeof value, sizeof value);
        if (bytes[k] != colors[k] || bytes[k] != quantise(value)) return false;
    }
    return true;
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

struct Way {
    std::string set;
    int threads;
    std::int64_t band, piece;  // pixels
};

class Comparison {
  public:
    // Draws a scene once as it is to be, and then in all the ways given.
    void draw_all(const std::string &name, const Scene &scene, Settings settings, const std::vector<Way> &ways) {
        const std::int64_t pixels = scene.view.columns * scene.view.rows;
        Bytes bytes;
        for (const Asked asked : {Asked::bytes, Asked::colors, Asked::all}) {
            settings.cuts = false;
            settings.threads = 1;
            settings.piece = pixels;
            setenv("WHITTED_ISA", "scalar", 1);
            const Bytes expected = draw(scene, settings, pixels, asked);
            for (const unsigned char byte : expected) hash = (hash ^ byte) * 0x100000001b3;  // FNV-1a
            if (asked == Asked::bytes) bytes = expected;
            if (asked == Asked::colors &&
                !(settings.precision == Precision::f64 ? is_quantised<double>(bytes, expected)
                                                       : is_quantised<float>(bytes, expected)))
                differs(name, settings, "8 bits are not those of the colors");
            settings.cuts = true;
            for (const Way &way : ways) {
                settings.threads = way.threads;
                settings.piece = way.piece;
                setenv("WHITTED_ISA", way.set.c_str(), 1);
                const std::string how = way.set + ", " + std::to_string(way.threads) + " threads, band " +
                                        std::to_string(way.band) + ", piece " + std::to_string(way.piece);
                ++drawn;
                if (draw(scene, settings, way.band, asked) != expected)
                    differs(name, settings, asked_names[static_cast<int>(asked)] + (", " + how));
                if (asked == Asked::bytes && stream(scene, settings) != expected)
                    differs(name, settings, "stream, " + how);
            }
        }
        ++scenes;
    }

    int result() const {
        std::printf("%ld images of %ld scenes and precisions, %ld differ, hash %016llx\n", drawn, scenes, wrong,
                    static_cast<unsigned long long>(hash));
        return wrong != 0 || drawn == 0;
    }

  private:
    void differs(const std::string &name, const Settings &settings, const std::string &how) {
        ++wrong;
        std::printf("%s, %s, %s\n", name.c_str(), settings.precision == Precision::f64 ? "f64" : "f32", how.c_str());
    }
    std::uint64_t hash = 0xcbf29ce484222325;
    long drawn = 0, scenes = 0, wrong = 0;
};

bool is_fit(const Scene &scene, Precision precision) {
    return check(scene, false).empty() && (precision == Precision::f64 || check_float32(scene).empty());
}

void draw_random(std::uint64_t seed, Comparison &comparison) {
    Scene scene = seed % 100 == 99 ? make_many(seed) : seed % 3 == 2 ? make_huge(seed) : make(seed);
    if (seed % 11 == 0) {  // rows of several spans
        scene.view.columns = 250 + static_cast<std::int64_t>(seed % 401);
        scene.view.rows = 5;
    }
    const std::int64_t pixels = scene.view.columns * scene.view.rows;
    const std::int64_t band =
        seed % 4 == 0 ? 1 + static_cast<std::int64_t>(seed * 37 % static_cast<std::uint64_t>(pixels)) : pixels;
    for (const Precision precision : {Precision::f64, Precision::f32}) {
        if (!is_fit(scene, precision)) continue;
        Settings settings;
        settings.precision = precision;
        settings.sample = static_cast<Sample>(seed / 5 % 5);
        constexpr double epsilons[] = {1e-4, 1e-4, 1e-3, 0, 0.05};
        settings.shadow_epsilon = epsilons[seed % 5];
        settings.max_reflections = seed % 7 == 0 ? 5 : seed % 7 == 1 ? 0 : 3;
        std::vector<Way> ways;
        for (const std::string &set : instruction_sets())
            ways.push_back({set, 1 + static_cast<int>(seed % 3), band, seed % 3 == 0 ? 0 : 97});
        comparison.draw_all("seed " + std::to_string(seed), scene, settings, ways);
    }
}

bool draw_file(const char *path, Comparison &comparison) {
    std::ifstream file(path, std::ios::binary);
    ParseResult parsed = parse(std::string(std::istreambuf_iterator<char>(file), {}), false);
    if (!file || !parsed.errors.empty()) return false;
    Scene &scene = parsed.scene;
    scene.view.columns = 61;
    scene.view.rows = 47;
    constexpr std::int64_t all = 61 * 47;
    std::vector<Way> ways;
    for (const std::string &set : instruction_sets()) {
        ways.push_back({set, 1, all, 0});
        for (const int threads : {1, 2, 3, 7}) {
            ways.push_back({set, threads, all, 97});      // pieces of rows
            ways.push_back({set, threads, 5 * 61, 61});   // bands of rows, a row a piece
            ways.push_back({set, threads, 13 * 61, 33});  // and neither a row nor a packet
            ways.push_back({set, threads, 419, 64});      // bands of pixels
        }
    }
    for (const Precision precision : {Precision::f64, Precision::f32}) {
        Settings settings;
        settings.precision = precision;
        if (is_fit(scene, precision)) comparison.draw_all(path, scene, settings, ways);
    }
    return true;
}

}  // namespace

int main(int count, char **arguments) {
    const std::string first = count > 1 ? arguments[1] : "";
    Comparison comparison;
    if (first == "random" && count == 4) {
        const std::uint64_t seed = std::strtoull(arguments[2], nullptr, 10);
        const std::uint64_t end = seed + std::strtoull(arguments[3], nullptr, 10);
        for (std::uint64_t k = seed; k < end; ++k) draw_random(k, comparison);
        return comparison.result();
    }
    if (count < 2 || first == "random") {
        std::fputs("usage: bits random FIRST COUNT, or bits SCENE...\n", stderr);
        return 2;
    }
    for (int k = 1; k < count; ++k) {
        if (draw_file(arguments[k], comparison)) continue;
        std::fprintf(stderr, "error: %s is no scene\n", arguments[k]);
        return 2;
    }
    return comparison.result();
}
