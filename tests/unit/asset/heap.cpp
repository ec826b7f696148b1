// SPDX-License-Identifier: MIT
#include "heap.h"

#include <malloc.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <new>

namespace {

std::atomic<std::size_t> heap_now{0}, heap_peak{0};

}  // namespace

void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  void* const at = std::malloc(size);
  if (at == nullptr) return nullptr;
  const std::size_t now = heap_now += ::malloc_usable_size(at);
  std::size_t peak = heap_peak;
  while (now > peak && !heap_peak.compare_exchange_weak(peak, now)) continue;
  return at;
}
void* operator new(std::size_t size) {
  void* const at = operator new(size, std::nothrow);
  if (at == nullptr) throw std::bad_alloc();
  return at;
}
void operator delete(void* at) noexcept {
  if (at != nullptr) heap_now -= ::malloc_usable_size(at);
  std::free(at);
}
void operator delete(void* at, std::size_t) noexcept {
  operator delete(at);
}

namespace eigencast {

HeapUse heap_use() {
  return {heap_now, heap_peak};
}

void watch_heap() {
  heap_peak = heap_now.load();
}

}  // namespace eigencast
