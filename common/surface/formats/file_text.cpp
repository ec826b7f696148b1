// SPDX-License-Identifier: MIT
#include "common/surface/formats/file_text.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <system_error>

#include "common/core/files.h"

namespace eigencast::text {
namespace {

constexpr std::uintmax_t kMaxFileBytes = std::uintmax_t{2} << 30;

bool is_blank(char c) {
  return c == ' ' || c == '\t' || c == '\v' || c == '\f' || c == '\r' || c == '\n';
}

}  // namespace

Result<std::string> bytes_of_file(const std::string& path) {
  return read_file(path, kMaxFileBytes);
}

std::string ending_of(const std::string& path) {
  std::string ending = std::filesystem::path(path).extension().string();
  if (!ending.empty()) ending.erase(0, 1);
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return ending;
}

bool is_file(const std::string& path) {
  std::error_code code;
  return std::filesystem::is_regular_file(path, code);
}

bool is_file_below(const std::string& folder, const std::string& path) {
  std::error_code code;
  const std::filesystem::path holder =
      folder.empty() ? std::filesystem::path() : std::filesystem::canonical(folder, code);
  if (code || holder.empty()) return false;
  const std::filesystem::path file = std::filesystem::canonical(path, code);
  if (code || !std::filesystem::is_regular_file(file, code)) return false;
  const auto [mine, rest] = std::mismatch(holder.begin(), holder.end(), file.begin(), file.end());
  return mine == holder.end() && rest != file.end();
}

std::optional<std::string_view> Lines::next() {
  if (rest_.empty()) return std::nullopt;
  const std::size_t end = std::min(rest_.find_first_of("\r\n"), rest_.size());
  const std::string_view line = rest_.substr(0, end);
  rest_.remove_prefix(end);
  if (!rest_.empty()) rest_.remove_prefix(rest_.substr(0, 2) == "\r\n" ? 2 : 1);
  ++number_;
  return line;
}

std::string_view take_token(std::string_view& rest) {
  std::size_t begin = 0;
  while (begin < rest.size() && is_blank(rest[begin])) ++begin;
  std::size_t end = begin;
  while (end < rest.size() && !is_blank(rest[end])) ++end;
  const std::string_view token = rest.substr(begin, end - begin);
  rest.remove_prefix(end);
  return token;
}

std::string_view without_comment(std::string_view line) {
  return line.substr(0, std::min(line.find('#'), line.size()));
}

std::optional<double> coordinate_from_token(std::string_view token) {
  if (!token.empty() && token[0] == '+') token.remove_prefix(1);
  double value = 0;
  const char* const end = token.data() + token.size();
  const auto [stop, error] = std::from_chars(token.data(), end, value);
  if (stop != end || token.empty()) return std::nullopt;
  // Below the smallest double from_chars reports out of range too, and leaves `value` at 0, which is near enough.
  const bool tiny = error == std::errc::result_out_of_range &&
                    (token.find("e-") != std::string_view::npos || token.find("E-") != std::string_view::npos);
  if (error != std::errc() && !tiny) return std::nullopt;
  if (!(std::abs(value) <= static_cast<double>(std::numeric_limits<float>::max()))) return std::nullopt;
  return value;
}

Result<std::array<double, 3>> take_position(std::string_view& rest, std::size_t line, const std::string& what) {
  std::array<double, 3> p{};
  for (double& coordinate : p) {
    const std::string_view token = take_token(rest);
    const auto value = coordinate_from_token(token);
    if (!value) return corrupt_at(line, what + " needs three finite numbers, not " + quoted(token));
    coordinate = *value;
  }
  return p;
}

std::optional<std::int64_t> integer_from_token(std::string_view token) {
  if (!token.empty() && token[0] == '+') token.remove_prefix(1);
  std::int64_t value = 0;
  const char* const end = token.data() + token.size();
  const auto [stop, error] = std::from_chars(token.data(), end, value);
  if (stop != end || token.empty() || error != std::errc()) return std::nullopt;
  return value;
}

Error corrupt_at(std::size_t line, const std::string& what) {
  return fail(ErrorCode::kCorrupt, "line " + std::to_string(line) + ": " + what);
}

std::string quoted(std::string_view token) {
  std::string text = "\"";
  for (const char c : token.substr(0, 40)) text += c >= ' ' && c <= '~' ? c : '?';
  return text + (token.size() > 40 ? "...\"" : "\"");
}

}  // namespace eigencast::text
