// SPDX-License-Identifier: MIT
#include "client/film_writer.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "common/core/files.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

constexpr timeval kStuckAfter{120, 0};  // ffmpeg takes no byte for so long

class PictureFiles final : public FilmWriter {
 public:
  explicit PictureFiles(FilmTarget target) : target_(std::move(target)) {}
  Result<void> add(const Picture& picture) override { return write_png(target_.picture_path(++written_), picture); }
  Result<void> finish() override { return {}; }

 private:
  FilmTarget target_;
  std::uint64_t written_ = 0;
};

/// What ffmpeg said, without how often.
std::string in_a_line(std::string_view text) {
  std::string line;
  while (!text.empty()) {
    const std::string_view next = trimmed(text.substr(0, text.find('\n')));
    text.remove_prefix(std::min(text.size(), text.find('\n')));
    text.remove_prefix(text.empty() ? 0 : 1);
    if (!next.empty() && !next.starts_with("Last message repeated")) line.append(line.empty() ? "" : "; ").append(next);
  }
  return line;
}

std::vector<std::string> ffmpeg_arguments(const FilmTarget& target, int width, int height, double fps,
                                          const std::string& file) {
  std::vector<std::string> all{"ffmpeg", "-nostdin", "-hide_banner", "-loglevel", "error", "-xerror", "-y"};
  const auto add = [&](std::initializer_list<const char*> more) { all.insert(all.end(), more.begin(), more.end()); };
  add({"-f", "rawvideo", "-pixel_format", "rgb24", "-video_size"});
  all.push_back(std::to_string(width) + "x" + std::to_string(height));
  add({"-framerate", formatted("%.9g", fps).c_str(), "-i", "pipe:0"});
  // Said in the file, so that every player shows the same colours.
  add({"-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p", "-colorspace", "bt709", "-color_primaries",
       "bt709", "-color_trc", "bt709", "-color_range", "tv"});
  if (target.kind == FilmTarget::Kind::kMp4) {
    add({"-c:v", "libx264", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"});
  } else {
    add({"-c:v", "libvpx-vp9", "-crf", "24", "-b:v", "0", "-row-mt", "1", "-cpu-used", "4", "-f", "webm"});
  }
  add({"-fflags", "+bitexact"});  // no random identifiers: the same pictures make the same file
  all.push_back("file:" + file);  // a name with a colon is no protocol
  return all;
}

/// ffmpeg in a process group of its own, so that Ctrl-C does not reach it: it ends when its input does.
class Video final : public FilmWriter {
 public:
  explicit Video(const FilmTarget& target) : path_(target.path), partial_(target.path + ".partial") {}
  ~Video() override {
    if (pid_ > 0) {
      ::kill(pid_, SIGKILL);
      ::waitpid(pid_, nullptr, 0);
    }
    if (made_) ::unlink(partial_.c_str());
  }

  Result<void> start(std::vector<std::string> arguments) {
    const FileHandle file(::open(partial_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
    if (file.get() < 0) return fail(ErrorCode::kIo, partial_ + ": " + std::strerror(errno));
    made_ = true;
    std::array<int, 2> ends{-1, -1};
    // Not a pipe: writing to an ffmpeg that has ended is then an error, not a signal.
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0)
      return fail(ErrorCode::kIo, std::string("no connection to ffmpeg: ") + std::strerror(errno));
    input_ = FileHandle(ends[0]);
    const FileHandle theirs(ends[1]);
    said_ = FileHandle(::memfd_create("ffmpeg", MFD_CLOEXEC));
    if (said_.get() < 0) return fail(ErrorCode::kIo, std::string("no memory file: ") + std::strerror(errno));
    ::setsockopt(input_.get(), SOL_SOCKET, SO_SNDTIMEO, &kStuckAfter, sizeof kStuckAfter);
    return spawn(std::move(arguments), theirs.get());
  }

  Result<void> add(const Picture& picture) override {
    const std::uint8_t* next = picture.rgb.data();
    const std::uint8_t* const end = next + picture.rgb.size();
    while (next < end) {
      const ssize_t sent = ::send(input_.get(), next, static_cast<std::size_t>(end - next), MSG_NOSIGNAL);
      if (sent < 0 && errno == EINTR) continue;
      if (sent < 0 && errno == EAGAIN)
        return fail(ErrorCode::kIo, path_ + ": ffmpeg has taken nothing for two minutes");
      if (sent < 0) return ended();
      next += sent;
    }
    return {};
  }

  Result<void> finish() override {
    input_ = FileHandle();
    if (const auto good = ended(); !good) return good;
    std::error_code error;
    std::filesystem::rename(partial_, path_, error);
    if (error) return fail(ErrorCode::kIo, path_ + ": " + error.message());
    made_ = false;
    return {};
  }

 private:
  Result<void> spawn(std::vector<std::string> arguments, int input) {
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, input, STDIN_FILENO);
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
    posix_spawn_file_actions_adddup2(&actions, said_.get(), STDERR_FILENO);
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
    posix_spawnattr_setpgroup(&attributes, 0);
    const int error = ::posix_spawnp(&pid_, argv[0], &actions, &attributes, argv.data(), environ);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
    if (error == 0) return {};
    pid_ = -1;
    if (error == ENOENT)
      return fail(ErrorCode::kNotFound,
                  path_ +
                      ": videos need ffmpeg, which is not installed: install the package ffmpeg, or write pictures "
                      "with --film frame_%04d.png");
    return fail(ErrorCode::kIo, std::string("ffmpeg does not start: ") + std::strerror(error));
  }

  /// Waits for ffmpeg. Good only after the end of its input.
  Result<void> ended() {
    int status = 0;
    const pid_t pid = std::exchange(pid_, -1);
    while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
    }
    const off_t size = ::lseek(said_.get(), 0, SEEK_END);
    // It may end well after a write that failed: then it said so.
    if (input_.get() < 0 && WIFEXITED(status) && WEXITSTATUS(status) == 0 && size == 0) return {};
    std::string why = WIFSIGNALED(status) ? formatted("was ended by signal %d", WTERMSIG(status))
                                          : formatted("ended with status %d", WEXITSTATUS(status));
    std::array<char, 600> text{};
    const ssize_t read = ::pread(said_.get(), text.data(), text.size(), std::max<off_t>(0, size - off_t{text.size()}));
    if (read > 0) why += ": " + in_a_line(trimmed({text.data(), static_cast<std::size_t>(read)}));
    return fail(ErrorCode::kIo, path_ + ": ffmpeg " + why);
  }

  std::string path_, partial_;
  bool made_ = false;  ///< partial_ is ours.
  FileHandle input_, said_;
  pid_t pid_ = -1;
};

}  // namespace

Result<std::unique_ptr<FilmWriter>> FilmWriter::create(const FilmTarget& target, int width, int height, double fps) {
  const bool pictures = target.kind == FilmTarget::Kind::kPictures;
  std::error_code unmade;  // which is said below
  if (const auto folder = std::filesystem::path(target.path).parent_path(); pictures && !folder.empty())
    std::filesystem::create_directories(folder, unmade);
  if (const auto writable = check_output_file(pictures ? target.picture_path(1) : target.path); !writable)
    return writable.error();
  if (pictures) return std::unique_ptr<FilmWriter>(std::make_unique<PictureFiles>(target));
  if (target.kind == FilmTarget::Kind::kMp4 && (width % 2 != 0 || height % 2 != 0))
    return fail(ErrorCode::kInvalidArgument, target.path + ": an mp4 has even width and height");
  auto video = std::make_unique<Video>(target);
  const auto started = video->start(ffmpeg_arguments(target, width, height, fps, target.path + ".partial"));
  if (!started) return started.error();
  return std::unique_ptr<FilmWriter>(std::move(video));
}

}  // namespace eigencast
