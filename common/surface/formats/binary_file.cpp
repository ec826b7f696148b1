// SPDX-License-Identifier: MIT
#include "common/surface/formats/binary_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <system_error>

namespace eigencast {

Result<std::shared_ptr<const BinaryFile>> BinaryFile::open(const std::string& path) {
  std::error_code code;
  const auto status = std::filesystem::status(path, code);
  if (!std::filesystem::exists(status)) return fail(ErrorCode::kNotFound, path + ": no such file");
  if (!std::filesystem::is_regular_file(status)) return fail(ErrorCode::kIo, path + ": not a regular file");
  FileHandle file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat facts {};
  if (file.get() < 0 || ::fstat(file.get(), &facts) != 0)
    return fail(ErrorCode::kIo, path + ": cannot be opened; is reading it allowed?");
  return std::shared_ptr<const BinaryFile>(
      new BinaryFile(std::move(file), path, static_cast<std::uint64_t>(facts.st_size)));
}

Result<void> BinaryFile::read_at(std::uint64_t offset, std::string& into) const {
  std::size_t done = 0;
  while (done < into.size()) {
    const ssize_t got = ::pread(file_.get(), into.data() + done, into.size() - done, static_cast<off_t>(offset + done));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return fail(ErrorCode::kIo, path_ + ": cannot be read any more; has it changed?");
    done += static_cast<std::size_t>(got);
  }
  return {};
}

}  // namespace eigencast
