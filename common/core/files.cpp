// SPDX-License-Identifier: MIT
#include "common/core/files.h"

#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>

namespace eigencast {
namespace {

bool write(const std::string& path, std::string_view content) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file << content;
  file.close();
  return !file.fail();
}

/// A device, a pipe or a link: nothing may take its place.
bool is_special(const std::string& path) {
  using Type = std::filesystem::file_type;
  std::error_code ignored;
  const Type type = std::filesystem::symlink_status(path, ignored).type();
  return type != Type::none && type != Type::not_found && type != Type::regular && type != Type::directory;
}

Error no_place(const std::string& path, const std::string& why) {
  return fail(ErrorCode::kIo, path + " cannot be written: " + why);
}

}  // namespace

Result<void> write_file_atomically(const std::string& path, std::string_view content) {
  const bool in_place = is_special(path);
  const std::string temporary = in_place ? path : path + ".new";
  if (!write(temporary, content)) {
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

Result<void> check_place_of_file(const std::string& path) {
  std::error_code ignored;
  if (path.empty()) return {};
  if (std::filesystem::is_directory(path, ignored)) return no_place(path, "it is a folder, where a file is meant");
  if (is_special(path)) {
    const bool takes = !std::filesystem::exists(path, ignored) || ::access(path.c_str(), W_OK) == 0;
    return takes ? Result<void>() : no_place(path, std::strerror(errno));
  }
  const std::string folder = std::filesystem::path(path).parent_path().string();
  if (!folder.empty() && !std::filesystem::exists(folder, ignored))
    return no_place(path, "there is no folder " + folder);
  const auto usable = check_place_of_folder(folder.empty() ? "." : folder);
  return usable ? usable : no_place(path, usable.error().message);
}

Result<void> check_place_of_folder(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  fs::path there(path);
  while (!there.empty() && !fs::exists(there, ignored)) there = there.parent_path();
  const std::string folder = there.empty() ? "." : there.string();
  if (!fs::is_directory(folder, ignored)) return fail(ErrorCode::kIo, folder + " is no folder");
  if (::access(folder.c_str(), W_OK) != 0)
    return fail(ErrorCode::kIo, "nothing can be written into " + folder + ": " + std::strerror(errno));
  return {};
}

}  // namespace eigencast
