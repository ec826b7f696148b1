// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <vector>

namespace eigencast {

/// Memory aligned to a cache line; where it is large, to a huge page, and in huge pages if the system grants them:
/// processors do not prefetch across pages.
void* allocate_lines(std::size_t bytes);
void free_lines(void* at, std::size_t bytes);

template <typename T>
struct CacheLineAllocator {
  using value_type = T;
  CacheLineAllocator() = default;
  template <typename U>
  explicit CacheLineAllocator(const CacheLineAllocator<U>&) {}
  T* allocate(std::size_t count) { return static_cast<T*>(allocate_lines(count * sizeof(T))); }
  void deallocate(T* at, std::size_t count) { free_lines(at, count * sizeof(T)); }
  friend bool operator==(const CacheLineAllocator&, const CacheLineAllocator&) { return true; }
};
template <typename T>
using AlignedVector = std::vector<T, CacheLineAllocator<T>>;

}  // namespace eigencast
