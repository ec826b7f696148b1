// SPDX-License-Identifier: MIT
#include "common/core/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>

namespace eigencast {
namespace {

template <typename Content>
Result<Content> read_all(const std::string& path, std::uint64_t max_bytes) {
  const FileHandle file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat facts {};
  if (file.get() < 0 || ::fstat(file.get(), &facts) != 0) {
    return fail(ErrorCode::kNotFound,
                path + ": cannot be opened: " + std::strerror(errno) + "; check the path and its permissions");
  }
  if (S_ISDIR(facts.st_mode)) return fail(ErrorCode::kIo, path + ": is a folder, where a file is meant");
  const auto size = static_cast<std::uint64_t>(facts.st_size);  // 0 for what is not a regular file.
  const auto too_large = fail(ErrorCode::kTooLarge, path + ": is over " + std::to_string(max_bytes) + " bytes");
  if (size > max_bytes) return too_large;
  Content content(static_cast<std::size_t>(size) + 1, 0);  // One more, in which the end shows.
  for (std::size_t have = 0;;) {
    if (have == content.size()) content.resize(2 * have);
    const ssize_t got = ::read(file.get(), content.data() + have, content.size() - have);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return fail(ErrorCode::kIo, path + ": cannot be read: " + std::strerror(errno));
    have += static_cast<std::size_t>(got);
    if (have > max_bytes) return too_large;
    if (got > 0) continue;
    content.resize(have);
    return content;
  }
}

bool write(const std::string& path, std::string_view content) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file << content;
  file.close();
  return !file.fail();
}

bool sync(const std::string& path) {
  const FileHandle file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  return file.get() >= 0 && ::fsync(file.get()) == 0;
}

/// A device, a pipe or a link, which must not be replaced.
bool is_special(const std::string& path) {
  using Type = std::filesystem::file_type;
  std::error_code ignored;
  const Type type = std::filesystem::symlink_status(path, ignored).type();
  return type != Type::none && type != Type::not_found && type != Type::regular && type != Type::directory;
}

Error not_writable(const std::string& path, const std::string& why) {
  return fail(ErrorCode::kIo, path + " cannot be written: " + why);
}

}  // namespace

FileHandle::~FileHandle() {
  if (fd_ >= 0) ::close(fd_);
}

FileHandle& FileHandle::operator=(FileHandle&& other) noexcept {
  std::swap(fd_, other.fd_);
  return *this;
}

Result<std::string> read_file(const std::string& path, std::uint64_t max_bytes) {
  return read_all<std::string>(path, max_bytes);
}

Result<Bytes> read_bytes(const std::string& path, std::uint64_t max_bytes) {
  return read_all<Bytes>(path, max_bytes);
}

Result<void> write_file_atomically(const std::string& path, std::string_view content, bool synced) {
  const bool in_place = is_special(path);
  const std::string temporary = in_place ? path : path + ".new";
  if (!write(temporary, content) || (synced && !in_place && !sync(temporary))) {
    if (!in_place) std::remove(temporary.c_str());
    return fail(ErrorCode::kIo, path + ": cannot be written: check the folder, its permissions and the free space");
  }
  if (in_place) return {};
  if (std::rename(temporary.c_str(), path.c_str()) != 0) {
    std::remove(temporary.c_str());
    return fail(ErrorCode::kIo, path + ": cannot be put in place: is it a folder?");
  }
  return {};
}

Result<void> check_output_file(const std::string& path) {
  std::error_code ignored;
  if (path.empty()) return {};
  if (std::filesystem::is_directory(path, ignored)) return not_writable(path, "it is a folder, where a file is meant");
  if (is_special(path)) {
    const bool takes = !std::filesystem::exists(path, ignored) || ::access(path.c_str(), W_OK) == 0;
    return takes ? Result<void>() : not_writable(path, std::strerror(errno));
  }
  const std::string folder = std::filesystem::path(path).parent_path().string();
  if (!folder.empty() && !std::filesystem::exists(folder, ignored))
    return not_writable(path, "there is no folder " + folder);
  const auto usable = check_output_folder(folder.empty() ? "." : folder);
  return usable ? usable : not_writable(path, usable.error().message);
}

Result<void> check_output_folder(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  fs::path there(path);
  while (!there.empty() && !fs::exists(there, ignored)) there = there.parent_path();
  const std::string folder = there.empty() ? "." : there.string();
  if (!fs::is_directory(folder, ignored)) return fail(ErrorCode::kIo, folder + " is not a folder");
  if (::access(folder.c_str(), W_OK) != 0)
    return fail(ErrorCode::kIo, "nothing can be written into " + folder + ": " + std::strerror(errno));
  return {};
}

}  // namespace eigencast
