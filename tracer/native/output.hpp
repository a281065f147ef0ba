// Where an image may be written, and files that appear whole or not at all.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace whitted {

// One sentence of what is wrong, and what to do; message empty: nothing is wrong.
struct Problem {
    std::string message;
    std::string hint;
    explicit operator bool() const { return !message.empty(); }
};

// Whether the OUTPUT of an untrusted scene may be written: a relative name that stays below the current folder.
Problem check_output_field(const std::string &name);

// A file that is written beside its final name and renamed at the end. Devices, pipes and "-" (stdout) are written
// directly. Without finish() nothing is left behind.
class OutputFile {
  public:
    // stopped: whether a signal asked to stop, so that waiting for the reader of a pipe ends.
    explicit OutputFile(bool (*stopped_by_signal)()) : stopped(stopped_by_signal) {}
    ~OutputFile();
    OutputFile(const OutputFile &) = delete;
    OutputFile &operator=(const OutputFile &) = delete;

    // scene: the path of the scene file, which is never overwritten, or "-". size: in bytes, must fit on the disk.
    Problem open(const std::string &path, const std::string &scene, std::int64_t size);
    Problem write(const char *data, std::size_t size);
    // Not for what is_direct(); by any thread.
    Problem write_at(std::int64_t place, const char *data, std::size_t size);
    Problem finish();
    // Whether what was written so far is already with its reader.
    bool is_direct() const { return temporary.empty(); }

  private:
    bool (*stopped)();
    std::string path;
    std::string temporary;
    int descriptor = -1;
    Problem put(const char *data, std::size_t size, std::int64_t place);
};

// All bytes of a file, "-" for stdin. At most `limit` bytes.
Problem read_file(const std::string &path, std::size_t limit, std::string &content);

}  // namespace whitted
