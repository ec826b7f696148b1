// SPDX-License-Identifier: MIT
#include "common/surface/formats/sequence.h"

#include <glob.h>

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "common/surface/formats/endings.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/motion_clip.h"

namespace eigencast {

namespace fs = std::filesystem;

namespace {

// In natural order; `faces.npy` is not a frame. One that is a clip by itself, where there is nothing else.
Result<std::vector<std::string>> as_sequence(std::vector<std::string> paths, const std::string& where) {
  std::erase_if(paths, [](const std::string& path) { return !text::is_file(path); });
  const auto frames_end = std::stable_partition(paths.begin(), paths.end(), [](const std::string& path) {
    return is_frame_ending(text::ending_of(path)) && fs::path(path).filename() != "faces.npy";
  });
  std::vector<std::string> others(frames_end, paths.end());
  paths.erase(frames_end, paths.end());
  std::erase_if(others, [](const std::string& path) { return !is_whole_clip(text::ending_of(path)); });
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

bool natural_less(std::string_view a, std::string_view b) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (!is_digit(a[i]) || !is_digit(b[j])) {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
      ++i;
      ++j;
      continue;
    }
    while (i < a.size() && a[i] == '0') ++i;
    while (j < b.size() && b[j] == '0') ++j;
    std::size_t a_end = i;
    std::size_t b_end = j;
    while (a_end < a.size() && is_digit(a[a_end])) ++a_end;
    while (b_end < b.size() && is_digit(b[b_end])) ++b_end;
    if (a_end - i != b_end - j) return a_end - i < b_end - j;
    const int order = a.substr(i, a_end - i).compare(b.substr(j, b_end - j));
    if (order != 0) return order < 0;
    i = a_end;
    j = b_end;
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;
}

Result<std::vector<std::string>> files_of_sequence(const std::string& path) {
  std::error_code code;
  const auto status = fs::status(path, code);
  if (fs::is_directory(status)) {
    const std::string recording = (fs::path(path) / "vertices.npy").string();
    if (text::is_file(recording)) return std::vector<std::string>{recording};
    return files_in_directory(path);
  }
  if (!fs::exists(status) && path.find_first_of("*?[") != std::string::npos) return files_of_glob(path);
  return std::vector<std::string>{path};
}

}  // namespace eigencast
