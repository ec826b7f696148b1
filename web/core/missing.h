// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <memory>
#include <type_traits>

// What the standard library for wasm32 lacks yet.
#ifndef __cpp_lib_smart_ptr_for_overwrite
namespace std {
template <typename Array>
unique_ptr<Array> make_unique_for_overwrite(size_t count) {
  return unique_ptr<Array>(new remove_extent_t<Array>[count]);
}
}  // namespace std
#endif

/// There is one thread, and no storage of its own.
#define thread_local static
