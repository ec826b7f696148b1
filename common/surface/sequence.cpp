// SPDX-License-Identifier: MIT
#include "common/surface/sequence.h"

#include <glob.h>

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "common/surface/file_text.h"
#include "common/surface/foreign.h"
#include "common/surface/natural_order.h"
#include "common/surface/read.h"

namespace eigencast {

namespace fs = std::filesystem;

bool is_file(const std::string& path) {
  std::error_code code;
  return fs::is_regular_file(path, code);
}

bool is_file_below(const std::string& folder, const std::string& path) {
  std::error_code code;
  const fs::path holder = folder.empty() ? fs::path() : fs::canonical(folder, code);
  if (code || holder.empty()) return false;
  const fs::path file = fs::canonical(path, code);
  if (code || !fs::is_regular_file(file, code)) return false;
  const auto [mine, rest] = std::mismatch(holder.begin(), holder.end(), file.begin(), file.end());
  return mine == holder.end() && rest != file.end();
}

namespace {

bool is_readable_kind(const std::string& path) {
  const std::string ending = text::ending_of(path);
  return ending == "obj" || ending == "off" || ending == "ply" || ending == "stl" || ending == "xyz" ||
         ending == "npy" || ending == "pc2" || ending == "mdd";
}

// What is a clip by itself, or a mesh, but no frame of a sequence.
bool is_whole_clip(const std::string& path) {
  const std::string ending = text::ending_of(path);
  return ending == "gltf" || ending == "glb" || is_foreign(ending);
}

// Files of one kind, in natural order; `faces.npy` is not a frame. One that is a clip by itself, where there is nothing
// else.
Result<std::vector<std::string>> as_sequence(std::vector<std::string> paths, const std::string& where) {
  std::erase_if(paths, [](const std::string& path) { return !is_file(path); });
  const auto frames_end = std::stable_partition(paths.begin(), paths.end(), [](const std::string& path) {
    return is_readable_kind(path) && fs::path(path).filename() != "faces.npy";
  });
  std::vector<std::string> others(frames_end, paths.end());
  paths.erase(frames_end, paths.end());
  std::erase_if(others, [](const std::string& path) { return !is_whole_clip(path); });
  if (paths.empty() && others.size() == 1) return others;
  if (paths.empty() && others.size() > 1) {
    return fail(ErrorCode::kInvalidArgument, where + ": " + std::to_string(others.size()) +
                                                 " files that are clips by themselves; name one, such as " +
                                                 *std::min_element(others.begin(), others.end(), natural_less));
  }
  if (paths.empty()) {
    return fail(ErrorCode::kNotFound, where + ": no files that end in " + readable_endings());
  }
  std::sort(paths.begin(), paths.end(), natural_less);
  for (const std::string& path : paths) {
    if (text::ending_of(path) == text::ending_of(paths[0])) continue;
    std::string what = where;
    what.append(": files of more than one kind (").append(paths[0]).append(", ").append(path);
    return fail(ErrorCode::kInvalidArgument, what + "); give a glob such as \"*.obj\" in quotes");
  }
  return paths;
}

Result<std::vector<std::string>> files_in_directory(const std::string& path) {
  std::vector<std::string> paths;
  std::error_code code;
  for (fs::directory_iterator it(path, code), end; !code && it != end; it.increment(code)) {
    if (it->path().filename().string()[0] != '.') paths.push_back(it->path().string());
    if (paths.size() > kMaxClipFrames) {
      return fail(ErrorCode::kTooLarge, path + ": more than " + std::to_string(kMaxClipFrames) + " files");
    }
  }
  if (code) return fail(ErrorCode::kIo, path + ": " + code.message());
  return as_sequence(std::move(paths), path);
}

Result<std::vector<std::string>> files_of_glob(const std::string& pattern) {
  glob_t found{};
  const int rc = ::glob(pattern.c_str(), GLOB_NOSORT, nullptr, &found);
  std::vector<std::string> paths;
  if (rc == 0 && found.gl_pathc <= kMaxClipFrames) paths.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
  const std::size_t count = found.gl_pathc;
  ::globfree(&found);
  if (rc != 0 && rc != GLOB_NOMATCH) return fail(ErrorCode::kIo, pattern + ": cannot be searched");
  if (count > kMaxClipFrames) {
    return fail(ErrorCode::kTooLarge, pattern + ": more than " + std::to_string(kMaxClipFrames) + " files");
  }
  return as_sequence(std::move(paths), pattern);
}

}  // namespace

Result<std::vector<std::string>> files_of_sequence(const std::string& path) {
  std::error_code code;
  const auto status = fs::status(path, code);
  if (fs::is_directory(status)) {
    const std::string recording = (fs::path(path) / "vertices.npy").string();
    if (is_file(recording)) return std::vector<std::string>{recording};
    return files_in_directory(path);
  }
  if (!fs::exists(status) && path.find_first_of("*?[") != std::string::npos) return files_of_glob(path);
  return std::vector<std::string>{path};
}

}  // namespace eigencast
