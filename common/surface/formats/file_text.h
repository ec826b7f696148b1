// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/result.h"

/// What the readers of this room share: whole files as bytes, lines, tokens and numbers. Private to common/surface.
namespace eigencast::text {

/// The bytes of a file of at most 2 GiB. Errors: as read_file().
Result<std::string> bytes_of_file(const std::string& path);

/// The file's ending in lower case without the dot: "obj".
std::string ending_of(const std::string& path);

bool is_file(const std::string& path);

/// Whether it is a regular file that lies below `folder` when all links are resolved. An empty folder holds nothing.
bool is_file_below(const std::string& folder, const std::string& path);

/// Lines of a text, without their ends (\n, \r\n or \r).
class Lines {
 public:
  explicit Lines(std::string_view text) : rest_(text) {}
  /// Nothing after the last.
  std::optional<std::string_view> next();
  /// Number of the line that next() gave last, from 1.
  std::size_t number() const { return number_; }

 private:
  std::string_view rest_;
  std::size_t number_ = 0;
};

/// Takes the first token, up to blanks, off `rest`; empty at the end.
std::string_view take_token(std::string_view& rest);

/// `line` up to a '#'.
std::string_view without_comment(std::string_view line);

/// A decimal number that is finite also as a 32-bit float (assets hold coordinates so).
std::optional<double> coordinate_from_token(std::string_view token);

std::optional<std::int64_t> integer_from_token(std::string_view token);

/// "line 12: what", kCorrupt.
Error corrupt_at(std::size_t line, const std::string& what);

/// A token for a message: quoted, at most 40 bytes, only printable ones.
std::string quoted(std::string_view token);

}  // namespace eigencast::text
