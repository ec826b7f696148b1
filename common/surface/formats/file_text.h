// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/result.h"

/// What the readers of this room share: whole files as bytes, lines, tokens and numbers. Private to common/surface.
namespace eigencast::text {

Result<std::string> bytes_of_file(const std::string& path);  ///< At most 2 GiB. Errors: as read_file().

std::string ending_of(const std::string& path);  ///< In lower case without the dot: "obj".

bool is_file(const std::string& path);

/// Whether it is a regular file that lies below `folder` when all links are resolved. An empty folder holds nothing.
bool is_file_below(const std::string& folder, const std::string& path);

/// Lines of a text, without their ends (\n, \r\n or \r) and without the mark that editors put before UTF-8.
class Lines {
 public:
  explicit Lines(std::string_view text) : rest_(text.substr(text.starts_with("\xEF\xBB\xBF") ? 3 : 0)) {}
  std::optional<std::string_view> next();         ///< Nothing after the last.
  std::size_t number() const { return number_; }  ///< Numbers the line that next() gave last, from 1.

 private:
  std::string_view rest_;
  std::size_t number_ = 0;
};

/// Takes the first token, up to blanks, off `rest`; empty at the end.
std::string_view take_token(std::string_view& rest);

std::string_view without_comment(std::string_view line);  ///< Up to a '#'.

/// A decimal number that is finite also as a 32-bit float (assets hold coordinates so).
std::optional<double> coordinate_from_token(std::string_view token);

/// Three coordinates off `rest`. Errors: kCorrupt, naming the line, `what` ("a vertex") and the token.
Result<std::array<double, 3>> take_position(std::string_view& rest, std::size_t line, const std::string& what);

std::optional<std::int64_t> integer_from_token(std::string_view token);

Error corrupt_at(std::size_t line, const std::string& what);  ///< "line 12: what", kCorrupt.

/// A token for a message: quoted, at most 40 bytes, only printable ones.
std::string quoted(std::string_view token);

}  // namespace eigencast::text
