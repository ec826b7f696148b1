// SPDX-License-Identifier: MIT
//
// malloc and free in place of libc's, which are four times as large. Blocks of up to kSmall bytes come from a list for
// each size; others, first fit, from one list in the order of addresses, in which neighbours become one block again.
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>

extern "C" std::uint8_t __heap_base;

namespace {

constexpr std::size_t kUnit = 16;  ///< Sizes and addresses are multiples of it.
constexpr std::size_t kSmall = 512, kSpan = 16384, kPage = 65536;
constexpr std::size_t kMaxBytes = std::size_t{1} << 31;

/// Stands before what is given; `next` counts while it is free.
struct alignas(kUnit) Block {
  std::size_t bytes;  ///< This header included.
  Block* next;
};
static_assert(sizeof(Block) == kUnit);

Block* small[kSmall / kUnit + 1];
Block* large;        ///< The lowest.
std::uintptr_t top;  ///< From here on nothing was given yet.

std::uintptr_t end_of(const Block* block) {
  return reinterpret_cast<std::uintptr_t>(block) + block->bytes;
}
Block* block_at(std::uintptr_t address, std::size_t bytes) {
  auto* block = reinterpret_cast<Block*>(address);
  block->bytes = bytes;
  return block;
}

/// Null: the memory does not grow so far.
Block* taken_from_top(std::size_t bytes) {
  if (top == 0) top = (reinterpret_cast<std::uintptr_t>(&__heap_base) + kUnit - 1) / kUnit * kUnit;
  const std::size_t has = __builtin_wasm_memory_size(0) * kPage;
  if (bytes > has - top && __builtin_wasm_memory_grow(0, (bytes - (has - top) + kPage - 1) / kPage) == SIZE_MAX)
    return nullptr;
  Block* block = block_at(top, bytes);
  top += bytes;
  return block;
}

void release_large(Block* block) {
  Block** at = &large;
  Block* before = nullptr;
  for (; *at != nullptr && *at < block; at = &(*at)->next) before = *at;
  block->next = *at;
  *at = block;
  if (block->next != nullptr && end_of(block) == reinterpret_cast<std::uintptr_t>(block->next)) {
    block->bytes += block->next->bytes;
    block->next = block->next->next;
  }
  if (before != nullptr && end_of(before) == reinterpret_cast<std::uintptr_t>(block)) {
    before->bytes += block->bytes;
    before->next = block->next;
  }
}

/// Its own size, which may be a little more than asked for.
Block* take_large(std::size_t bytes) {
  for (Block** at = &large; *at != nullptr; at = &(*at)->next) {
    Block* block = *at;
    if (block->bytes < bytes) continue;
    if (block->bytes - bytes <= kSmall) {
      *at = block->next;
      return block;
    }
    block->bytes -= bytes;  // Its end is given, so that the list stays as it is.
    return block_at(end_of(block), bytes);
  }
  return taken_from_top(bytes);
}

Block* take_small(std::size_t bytes) {
  Block*& list = small[bytes / kUnit];
  if (list == nullptr) {
    Block* span = take_large(kSpan);
    if (span == nullptr) return nullptr;
    const auto first = reinterpret_cast<std::uintptr_t>(span), end = end_of(span);
    for (std::uintptr_t each = first; each + bytes <= end; each += bytes) {
      Block* block = block_at(each, bytes);
      block->next = list;
      list = block;
    }
  }
  Block* block = list;
  list = block->next;
  return block;
}

}  // namespace

extern "C" {

void* malloc(std::size_t bytes) {
  if (bytes > kMaxBytes) return nullptr;
  const std::size_t whole = (bytes + sizeof(Block) + kUnit - 1) / kUnit * kUnit;
  Block* block = whole <= kSmall ? take_small(whole) : take_large(whole);
  return block == nullptr ? nullptr : block + 1;
}

void free(void* given) {
  if (given == nullptr) return;
  Block* block = static_cast<Block*>(given) - 1;
  if (block->bytes > kSmall) return release_large(block);
  block->next = small[block->bytes / kUnit];
  small[block->bytes / kUnit] = block;
}

void* calloc(std::size_t count, std::size_t each) {
  std::size_t bytes = 0;
  if (__builtin_mul_overflow(count, each, &bytes)) return nullptr;
  void* given = malloc(bytes);
  return given == nullptr ? nullptr : std::memset(given, 0, bytes);
}

/// REQUIRES: alignment is a power of two.
void* aligned_alloc(std::size_t alignment, std::size_t bytes) {
  if (alignment <= kUnit) return malloc(bytes);
  if (bytes > kMaxBytes || alignment > kMaxBytes) return nullptr;
  void* given = malloc(bytes + alignment + kSmall);
  const auto address = reinterpret_cast<std::uintptr_t>(given);
  if (address % alignment == 0) return given;  // Null, too.
  // What lies before becomes a block of its own, large enough for the list of large ones.
  Block* front = static_cast<Block*>(given) - 1;
  const std::uintptr_t aligned = (address + kSmall + alignment - 1) / alignment * alignment;
  const std::size_t before = aligned - address;
  Block* block = block_at(aligned - sizeof(Block), front->bytes - before);
  front->bytes = before;
  free(given);
  return block + 1;
}

int posix_memalign(void** to, std::size_t alignment, std::size_t bytes) {
  *to = aligned_alloc(alignment, bytes);
  return *to == nullptr ? ENOMEM : 0;
}

void* realloc(void* given, std::size_t bytes) {
  void* moved = malloc(bytes);
  if (given == nullptr || moved == nullptr) return moved;
  const std::size_t had = (static_cast<Block*>(given) - 1)->bytes - sizeof(Block);
  std::memcpy(moved, given, had < bytes ? had : bytes);
  free(given);
  return moved;
}

// By these names parts of libc call them.
void* __libc_malloc(std::size_t bytes) {
  return malloc(bytes);
}
void __libc_free(void* given) {
  free(given);
}
void* __libc_calloc(std::size_t count, std::size_t each) {
  return calloc(count, each);
}

}  // extern "C"

// libc++ without exceptions gives null where memory ran out, and vectors would write there.
void* operator new(std::size_t bytes) {
  void* given = malloc(bytes);
  if (given == nullptr) __builtin_trap();
  return given;
}
void* operator new(std::size_t bytes, std::align_val_t alignment) {
  void* given = aligned_alloc(static_cast<std::size_t>(alignment), bytes);
  if (given == nullptr) __builtin_trap();
  return given;
}
