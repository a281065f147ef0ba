// Where an image may be written, and files that appear whole or not at all.
#include "output.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <utility>

#include "scene.hpp"

namespace whitted {

namespace fs = std::filesystem;

namespace {

constexpr const char *use_o = "name the file yourself: raytrace SCENE -o FILE";

std::string in_quotes(std::string_view name) { return "'" + std::string(name) + "'"; }

std::string reason(int error) { return std::strerror(error); }

// The path behind symbolic links, also behind one that points at nothing.
fs::path resolved(fs::path path, std::error_code &error) {
    for (int link = 0; link < 40; ++link) {
        if (fs::symlink_status(path, error).type() != fs::file_type::symlink) return fs::weakly_canonical(path, error);
        const fs::path target = fs::read_symlink(path, error);
        if (error) return {};
        path = target.is_absolute() ? target : path.parent_path() / target;
    }
    error = std::make_error_code(std::errc::too_many_symbolic_link_levels);
    return {};
}

// Whether both are one file; false where one of them does not exist.
bool is_same_file(const std::string &path, const std::string &scene) {
    struct stat one{};
    struct stat other{};
    if (::stat(path.c_str(), &one) != 0) return false;
    if ((scene == "-" ? ::fstat(STDIN_FILENO, &other) : ::stat(scene.c_str(), &other)) != 0) return false;
    return one.st_dev == other.st_dev && one.st_ino == other.st_ino && S_ISREG(one.st_mode);
}

bool is_below(const fs::path &path, const fs::path &folder) {
    return std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first == folder.end();
}

}  // namespace

Problem check_output_field(const std::string &name) {
    const fs::path path(name);
    if (path.is_absolute())
        return {"OUTPUT " + in_quotes(name) + " is an absolute path, which a scene may not write", use_o};
    if (std::find(path.begin(), path.end(), "..") != path.end())
        return {"OUTPUT " + in_quotes(name) + " contains '..', which leads out of the current folder", use_o};
    std::error_code error;
    const fs::path folder = fs::canonical(fs::current_path(error), error);
    if (error) return {"the current folder cannot be read: " + error.message(), use_o};
    const fs::path target = resolved(folder / path, error);
    if (error) return {"OUTPUT " + in_quotes(name) + " cannot be followed: " + error.message(), use_o};
    if (!is_below(target, folder))
        return {"OUTPUT " + in_quotes(name) + " leads out of the current folder through a symbolic link", use_o};
    const fs::file_status status = fs::status(target, error);
    if (fs::exists(status) && !fs::is_regular_file(status) && !fs::is_directory(status))
        return {"OUTPUT " + in_quotes(name) + " is not a regular file", use_o};
    return {};
}

OutputFile::~OutputFile() {
    if (descriptor > STDOUT_FILENO) ::close(descriptor);
    if (!temporary.empty()) ::unlink(temporary.c_str());
}

Problem OutputFile::open(const std::string &name, const std::string &scene, std::int64_t size) {
    path = name;
    if (path == "-") {
        descriptor = STDOUT_FILENO;
        return {};
    }
    std::error_code error;
    if (is_same_file(path, scene))
        return {in_quotes(path) + " is the scene file itself, which is not overwritten", "choose another file with -o"};
    const fs::file_status status = fs::status(path, error);
    if (fs::is_directory(status)) return {in_quotes(path) + " is a folder", "name a file with -o"};
    if (fs::exists(status) && !fs::is_regular_file(status)) {
        do {  // opening a pipe waits for its reader
            descriptor = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
        } while (descriptor < 0 && errno == EINTR && !stopped());
        if (descriptor < 0) return {"cannot write " + in_quotes(path) + ": " + reason(errno), ""};
        return {};
    }

    // The file behind a link is replaced, not the link.
    const fs::path target = resolved(fs::absolute(path, error), error);
    if (error) return {"cannot write " + in_quotes(path) + ": " + error.message(), "name another file with -o"};
    const std::string folder = target.parent_path().string();
    struct statvfs disk{};
    if (::statvfs(folder.c_str(), &disk) != 0)
        return {"cannot write " + in_quotes(path) + ": " + reason(errno),
                "create the folder, or name another file with -o"};
    const double available = static_cast<double>(disk.f_bavail) * static_cast<double>(disk.f_frsize);
    const bool known = disk.f_blocks > 0;  // some network and virtual file systems do not say
    if (known && static_cast<double>(size) > available)
        return {"the image needs " + std::to_string(size) + " bytes, but the disk has room for " +
                    std::to_string(static_cast<std::int64_t>(available)),
                "lower RES, or write to another disk or a pipe with -o"};

    path = target.string();
    temporary = folder + "/.raytrace-XXXXXX";
    descriptor = ::mkostemp(temporary.data(), O_CLOEXEC);
    if (descriptor < 0) {
        temporary.clear();
        return {"cannot write into the folder " + in_quotes(folder) + ": " + reason(errno),
                "name another file with -o"};
    }
    return {};
}

Problem OutputFile::write(const char *data, std::size_t size) { return put(data, size, -1); }

Problem OutputFile::write_at(std::int64_t place, const char *data, std::size_t size) { return put(data, size, place); }

// place: -1: where the last write ended.
Problem OutputFile::put(const char *data, std::size_t size, std::int64_t place) {
    while (size > 0) {
        const ssize_t written =
            place < 0 ? ::write(descriptor, data, size) : ::pwrite(descriptor, data, size, static_cast<off_t>(place));
        if (written < 0 ? errno == EINTR : static_cast<std::size_t>(written) < size) {
            if (stopped()) return {"stopped", ""};
        }
        if (written < 0) {
            if (errno == EINTR) continue;
            return {"cannot write " + (path == "-" ? "to stdout" : in_quotes(path)) + ": " + reason(errno), ""};
        }
        data += written;
        size -= static_cast<std::size_t>(written);
        if (place >= 0) place += written;
    }
    return {};
}

Problem OutputFile::finish() {
    if (temporary.empty()) return {};
    const mode_t mask = ::umask(0);
    ::umask(mask);
    // A file system may report what it could not write as late as at the close.
    const bool kept = ::fchmod(descriptor, 0666 & ~mask) == 0;
    const bool closed = ::close(std::exchange(descriptor, -1)) == 0;
    if (!kept || !closed || ::rename(temporary.c_str(), path.c_str()) != 0)
        return {"cannot write " + in_quotes(path) + ": " + reason(errno), ""};
    temporary.clear();
    return {};
}

Problem read_file(const std::string &path, std::size_t limit, std::string &content) {
    const bool piped = path == "-";
    const std::string name = piped ? "stdin" : in_quotes(path);
    std::error_code error;
    if (!piped && fs::is_directory(path, error)) return {name + " is a folder, not a scene file", ""};
    std::FILE *file = piped ? stdin : std::fopen(path.c_str(), "rbe");
    if (!file)
        return {"cannot read " + name + ": " + reason(errno),
                errno == ENOENT ? "check the name of the scene file" : ""};
    // A buffer of our own: one system call for an ordinary scene.
    char block[65536];
    std::setvbuf(file, nullptr, _IONBF, 0);
    std::size_t count = 0;
    while (content.size() <= limit && (count = std::fread(block, 1, sizeof block, file)) > 0)
        content.append(block, count);
    const bool failed = std::ferror(file) != 0;
    const int reading_error = errno;
    if (!piped) std::fclose(file);
    if (failed) return {"cannot read " + name + ": " + reason(reading_error), ""};
    if (content.size() > limit)
        return {name + " is larger than " + std::to_string(limit) + " bytes, which no scene needs",
                "check the name of the scene file"};
    return {};
}

}  // namespace whitted
