// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

namespace eigencast {

/// A URL as people may see it: "..." for what stands before its host, a name and a password.
inline std::string without_user_info(std::string_view url) {
  const std::size_t scheme = url.find("://"), begin = scheme == std::string_view::npos ? 0 : scheme + 3;
  const std::size_t at = url.rfind('@');
  if (at == std::string_view::npos || at <= begin) return std::string(url);
  return std::string(url.substr(0, begin)) + "..." + std::string(url.substr(at));
}

}  // namespace eigencast
