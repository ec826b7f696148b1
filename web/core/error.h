// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/result.h"

namespace eigencast::web {

/// Keeps the error for error_text() and returns its negative number.
std::int32_t failed(Error error);

/// 0, or the error's number.
template <typename T>
std::int32_t status_of(const Result<T>& result) {
  return result ? 0 : failed(result.error());
}

/// For functions that return a pointer.
inline std::nullptr_t no(Error error) {
  failed(std::move(error));
  return nullptr;
}

}  // namespace eigencast::web
