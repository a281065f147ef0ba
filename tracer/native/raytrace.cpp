// raytrace SCENE: renders a scene to the PPM file that it names.
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>
#include <mutex>
#include <new>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "number.hpp"
#include "output.hpp"
#include "ppm.hpp"
#include "render.hpp"
#include "scene.hpp"
#include "text.hpp"

namespace {

using whitted::Problem;

constexpr int success = 0;
constexpr int wrong_input = 2;

constexpr const char *help_text = R"(Usage: raytrace [OPTIONS] SCENE

Renders SCENE to the PPM file that its field OUTPUT names. SCENE '-' is stdin.

Options:
  -o, --output FILE       write FILE instead of OUTPUT; '-' is stdout
  --precision f64|f32     arithmetic of the renderer [f64]
  --threads N             0: as many as there are processors [0]
  --sample PLACE          where in a pixel its ray goes through: corner (top left),
                          center, bottom-left, top-right, or inclusive (the
                          outermost rays go through the edges of the image)
                          [corner]
  --shadow-epsilon E      shadow rays start at this fraction of the way to the
                          light [0.0001]
  --max-reflections N     mirror bounces followed [3]
  --no-limits             lift the limits on spheres, lights and resolution
  --version               print the version, the instruction set and the compiler
  -h, --help              print this

Environment:
  WHITTED_ISA             instruction set: scalar, sse2, avx2, avx512 or neon
                          [the best this processor has]

Exit status: 0 the image was written; 2 something is wrong with the command, the
scene or the file to write; 130 or 143 stopped by a signal.

Examples:
  raytrace scene.txt
  raytrace scene.txt -o image.ppm --sample center --threads 4
  generate-scene | raytrace - -o - | display
)";

struct Options {
    std::string scene;
    std::string output;  // "": as the scene says
    whitted::Settings settings;
    bool limits = true;
};

std::atomic<int> stop_signal{0};

void on_signal(int signal) { stop_signal = signal; }

bool is_stopped() { return stop_signal != 0; }

int fail(const Problem &problem) {
    std::fprintf(stderr, "error: %s\n", problem.message.c_str());
    if (!problem.hint.empty()) std::fprintf(stderr, "  hint: %s\n", problem.hint.c_str());
    return wrong_input;
}

constexpr std::array<std::string_view, 10> option_names{
    "--output",          "--precision", "--threads", "--sample", "--shadow-epsilon",
    "--max-reflections", "--no-limits", "--version", "--help",   "-o"};

std::string nearest_option(std::string_view wrong) {
    std::string_view nearest;
    std::size_t least = std::min<std::size_t>(4, wrong.size() / 2);  // a letter of two is no likeness
    for (const std::string_view name : option_names) {
        const std::size_t distance = whitted::edit_distance(wrong, name);
        if (distance < least) {
            least = distance;
            nearest = name;
        }
    }
    return nearest.empty() ? "raytrace --help lists the options" : "did you mean '" + std::string(nearest) + "'?";
}

std::optional<int> integer_between(std::string_view text, int least, int most) {
    int value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || value < least || value > most) return std::nullopt;
    return value;
}

Problem bad_value(std::string_view option, std::string_view value, const std::string &expected) {
    return {"'" + std::string(value) + "' is not a value of " + std::string(option), "expected " + expected};
}

// One option that takes a value.
Problem take(Options &options, std::string_view option, std::string_view value) {
    whitted::Settings &settings = options.settings;
    if (option == "--output" || option == "-o") {
        if (value.empty()) return {"the file name after " + std::string(option) + " is empty", "name a file"};
        options.output = value;
    } else if (option == "--precision") {
        if (value != "f64" && value != "f32") return bad_value(option, value, "f64 or f32");
        settings.precision = value == "f64" ? whitted::Precision::f64 : whitted::Precision::f32;
    } else if (option == "--threads") {
        const auto threads = integer_between(value, 0, whitted::most_threads);
        if (!threads) return bad_value(option, value, "an integer from 0 to " + std::to_string(whitted::most_threads));
        settings.threads = *threads;
    } else if (option == "--sample") {
        const auto sample = whitted::parse_sample(value);
        if (!sample) return bad_value(option, value, "corner, center, bottom-left, top-right or inclusive");
        settings.sample = *sample;
    } else if (option == "--shadow-epsilon") {
        const whitted::Number number = whitted::parse_number(value);
        if (!number.valid || !(number.value >= 0 && number.value < 1))
            return bad_value(option, value, "a number from 0 up to, but not including, 1");
        settings.shadow_epsilon = number.value;
    } else {
        const auto bounces = integer_between(value, 0, whitted::most_reflections);
        if (!bounces)
            return bad_value(option, value, "an integer from 0 to " + std::to_string(whitted::most_reflections));
        settings.max_reflections = *bounces;
    }
    return {};
}

// Fills options, or says what is wrong. `shown`: --help or --version, where nothing is rendered.
Problem parse_arguments(int count, char **arguments, Options &options, std::string_view &shown) {
    bool only_files = false;
    bool have_scene = false;
    for (int k = 1; k < count; ++k) {
        std::string_view word = arguments[k];
        if (!only_files && word == "--") {
            only_files = true;
        } else if (only_files || word == "-" || word.empty() || word[0] != '-') {
            if (have_scene)
                return {"a second scene, '" + std::string(word) + "'", "raytrace renders one scene at a time"};
            options.scene = word;
            have_scene = true;
        } else if (word == "--help" || word == "-h") {
            shown = "--help";
            return {};
        } else if (word == "--version") {
            shown = "--version";
            return {};
        } else if (word == "--no-limits") {
            options.limits = false;
        } else {
            std::optional<std::string_view> value;
            const std::size_t equals = word.find('=');
            if (word.substr(0, 2) == "--" && equals != word.npos) {
                value = word.substr(equals + 1);
                word = word.substr(0, equals);
            } else if (word.substr(0, 2) == "-o" && word.size() > 2) {
                value = word.substr(2);
                word = "-o";
            }
            if (std::find(option_names.begin(), option_names.end(), word) == option_names.end())
                return {"unknown option '" + std::string(word) + "'", nearest_option(word)};
            if (word == "--no-limits" || word == "--version" || word == "--help")
                return {"the option " + std::string(word) + " takes no value", "leave out what stands after the '='"};
            if (!value) {
                if (k + 1 == count)
                    return {"the option " + std::string(word) + " needs a value", "raytrace --help says which"};
                value = arguments[++k];
            }
            if (const Problem problem = take(options, word, *value)) return problem;
        }
    }
    if (!have_scene || options.scene.empty()) return {"no scene is given", "raytrace SCENE, or raytrace --help"};
    return {};
}

// A line on stderr that is redrawn while the work takes longer than a second.
class Progress {
  public:
    explicit Progress(std::int64_t whole) : total(whole), enabled(::isatty(STDERR_FILENO) == 1) {}
    ~Progress() { clear(); }
    Progress(const Progress &) = delete;
    Progress &operator=(const Progress &) = delete;

    void update(std::int64_t done) {
        const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
        if (!enabled || spent.count() < 1 || done == 0) return;
        const double fraction = static_cast<double>(done) / static_cast<double>(total);
        std::fprintf(stderr, "\rrendering: %3.0f %%, %.0f s left ", 100 * fraction,
                     spent.count() * (1 - fraction) / fraction);
        std::fflush(stderr);
        shown = true;
    }

    void clear() {
        if (shown) std::fputs("\r\x1b[K", stderr);
        shown = false;
    }

  private:
    std::int64_t total;
    bool enabled;
    bool shown = false;
    std::chrono::steady_clock::time_point start = std::chrono::steady_clock::now();
};

int stopped(bool incomplete = false) {
    std::fputs(incomplete ? "stopped: the image is incomplete\n" : "stopped: nothing was written\n", stderr);
    return 128 + stop_signal;
}

// The ending of a file name that promises another format than PPM; empty: none.
std::string_view other_image(std::string_view path) {
    constexpr std::array<std::string_view, 9> endings{".png", ".jpg",  ".jpeg", ".gif", ".bmp",
                                                      ".tif", ".tiff", ".exr",  ".webp"};
    for (const std::string_view ending : endings) {
        const std::size_t start = path.size() - std::min(path.size(), ending.size());
        if (whitted::upper(path.substr(start)) == whitted::upper(ending)) return ending;
    }
    return "";
}

// To a pipe: bands of pixels, large enough for all threads, small enough that memory does not grow with the image.
Problem write_in_order(const whitted::Renderer &renderer, std::int64_t pixels, whitted::OutputFile &file,
                       Progress &progress) {
    constexpr std::int64_t band_pixels = 1 << 20;
    std::vector<unsigned char> band(static_cast<std::size_t>(3 * std::min(pixels, band_pixels)));
    for (std::int64_t first = 0; first < pixels && !is_stopped(); first += band_pixels) {
        const std::int64_t last = std::min(first + band_pixels, pixels);
        const auto poll = [&](std::int64_t done) {
            progress.update(first + done);
            return !is_stopped();
        };
        if (!renderer.render(first, last, {{whitted::PassKind::beauty8, 0, band.data()}}, poll) || is_stopped()) break;
        if (Problem problem =
                file.write(reinterpret_cast<const char *>(band.data()), static_cast<std::size_t>(3 * (last - first))))
            return problem;
    }
    return {};
}

// To a file: every thread writes what it rendered, while the others render.
Problem write_anywhere(const whitted::Renderer &renderer, std::size_t header, whitted::OutputFile &file,
                       Progress &progress) {
    std::mutex failing;
    Problem problem;
    const auto deliver = [&](std::int64_t begin, std::int64_t end, const std::uint8_t *bytes) {
        const Problem found =
            file.write_at(static_cast<std::int64_t>(header) + 3 * begin, reinterpret_cast<const char *>(bytes),
                          static_cast<std::size_t>(3 * (end - begin)));
        if (!found) return true;
        const std::lock_guard lock(failing);
        problem = found;
        return false;
    };
    renderer.stream(deliver, [&](std::int64_t done) {
        progress.update(done);
        return !is_stopped();
    });
    return problem;
}

int render(const Options &options, const whitted::Scene &scene) {
    const std::int64_t pixels = scene.view.columns * scene.view.rows;
    if (pixels > (std::numeric_limits<std::int64_t>::max() - 100) / 3)
        return fail({"an image of " + std::to_string(scene.view.columns) + " x " + std::to_string(scene.view.rows) +
                         " pixels is larger than any file can be",
                     "lower RES"});
    const std::string path = options.output.empty() ? scene.output : options.output;
    if (const std::string_view kind = other_image(path); !kind.empty())
        std::fprintf(
            stderr, "warning: '%s' becomes a PPM file, whatever %s says\n  hint: whitted render writes .png and .exr\n",
            path.c_str(), std::string(kind).c_str());
    const std::string header = whitted::ppm_header(scene.view.columns, scene.view.rows);
    if (options.output.empty()) {
        if (const Problem problem = whitted::check_output_field(path)) return fail(problem);
    }
    whitted::OutputFile file(is_stopped);
    // A scene may name a file '-'; stdout is only for -o.
    if (const Problem problem = file.open(options.output.empty() && path == "-" ? "./-" : path, options.scene,
                                          3 * pixels + static_cast<std::int64_t>(header.size())))
        return is_stopped() ? stopped() : fail(problem);

    const whitted::Renderer renderer(scene, options.settings);
    Progress progress(pixels);
    if (const Problem problem = file.write(header.data(), header.size()))
        return is_stopped() ? stopped(file.is_direct()) : fail(problem);
    if (const Problem problem = file.is_direct() ? write_in_order(renderer, pixels, file, progress)
                                                 : write_anywhere(renderer, header.size(), file, progress);
        problem || is_stopped()) {
        progress.clear();
        return is_stopped() ? stopped(file.is_direct()) : fail(problem);
    }
    progress.clear();
    if (const Problem problem = file.finish()) return fail(problem);
    return success;
}

// What --help and --version print.
int show(const std::string &text) {
    if (std::fputs(text.c_str(), stdout) < 0 || std::fflush(stdout) != 0)
        return fail({std::string("cannot write to stdout: ") + std::strerror(errno), ""});
    return success;
}

int run(int count, char **arguments) {
    Options options;
    std::string_view shown;
    if (const Problem problem = parse_arguments(count, arguments, options, shown)) return fail(problem);
    if (shown == "--help") return show(help_text);
    std::string problem;
    const std::string isa = whitted::instruction_set(problem);
    if (isa.empty()) return fail({problem, "unset WHITTED_ISA to use the best one"});
    if (shown == "--version")
        return show("raytrace " + std::string(WHITTED_VERSION) + " (" + isa + ", " + whitted::compiler() + ")\n");

    // No scene within the limits comes near this; a device or a log given by mistake does.
    constexpr std::size_t most_bytes = std::size_t{64} << 20;
    constexpr std::size_t most_bytes_without_limits = std::size_t{4} << 30;
    std::string text;
    if (const Problem unreadable =
            whitted::read_file(options.scene, options.limits ? most_bytes : most_bytes_without_limits, text))
        return is_stopped() ? stopped() : fail(unreadable);
    const std::string source = options.scene == "-" ? "<stdin>" : options.scene;
    whitted::ParseResult parsed = whitted::parse(text, options.limits);
    if (parsed.errors.empty() && options.settings.precision == whitted::Precision::f32)
        parsed.errors = whitted::check_float32(parsed.scene);
    for (const whitted::Diagnostic &warning : parsed.warnings)
        std::fprintf(stderr, "%s\n", whitted::describe(warning, source, "warning").c_str());
    for (const whitted::Diagnostic &error : parsed.errors)
        std::fprintf(stderr, "%s\n", whitted::describe(error, source).c_str());
    if (!parsed.errors.empty()) return wrong_input;
    return render(options, parsed.scene);
}

}  // namespace

int main(int count, char **arguments) {
    // A closed stdin, stdout or stderr must not become the number of the image file: what is open for the other
    // direction fails just as a closed one does.
    for (const int descriptor : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO})
        if (::fcntl(descriptor, F_GETFD) < 0) ::open("/dev/null", descriptor == STDIN_FILENO ? O_WRONLY : O_RDONLY);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
        struct sigaction action{};
        ::sigaction(signal, nullptr, &action);
        if (action.sa_handler == SIG_IGN) continue;  // nohup, or a job in the background of a script
        action = {};
        action.sa_handler = on_signal;
        ::sigaction(signal, &action, nullptr);
    }
    // A closed pipe and a file that grows too large are errors of write().
    std::signal(SIGPIPE, SIG_IGN);
    std::signal(SIGXFSZ, SIG_IGN);
    try {
        return run(count, arguments);
    } catch (const std::bad_alloc &) {
        return fail({"there is not enough memory for this scene", "use fewer spheres and lights"});
    } catch (const std::exception &unforeseen) {
        return fail({unforeseen.what(), "please report this"});
    }
}
