// SPDX-License-Identifier: MIT
#include "broker/backbone/remote_memory.h"

#include <algorithm>

#include "common/wire/limits.h"

namespace eigencast::broker {

bool MemoryNotice::goes_on_as(const MemoryNotice& later) const {
  return root == later.root && segments.size() <= later.segments.size() &&
         std::equal(segments.begin(), segments.end(), later.segments.begin());
}

Bytes bytes_from(const MemoryNotice& notice) {
  Bytes bytes{'M'};
  ByteWriter out(bytes);
  for (const std::uint32_t number : {notice.root, notice.number, notice.epoch}) out.u32(number);
  for (const Sha256& id : notice.segments) out.bytes(id.digest);
  return bytes;
}

Bytes head_of_recalled(const Generation& memory, std::uint32_t needed, std::uint32_t epoch, std::uint64_t sequence) {
  Bytes head{'F'};
  ByteWriter out(head);
  for (const std::uint32_t number : {memory.root, needed, epoch}) out.u32(number);
  out.u64(sequence);
  return head;
}

std::optional<MemoryMessage> memory_message_from(ByteView bytes) {
  ByteReader in(bytes);
  const std::uint8_t kind = in.u8();
  MemoryMessage message;
  message.root = in.u32();
  message.number = in.u32();
  if (in.failed()) return std::nullopt;
  if (kind == 'F') {
    const ByteView frame = in.bytes(in.remaining());
    message.frame.assign(frame.begin(), frame.end());
    return message;
  }
  MemoryNotice notice{in.u32(), message.root, message.number};
  const std::size_t count = in.remaining() / sizeof(Sha256::digest);
  if (kind != 'M' || in.failed() || in.remaining() % sizeof(Sha256::digest) != 0 || count > limits::kMaxMemorySegments)
    return std::nullopt;
  for (std::size_t i = 0; i < count; ++i) {
    const ByteView digest = in.bytes(sizeof(Sha256::digest));
    std::copy(digest.begin(), digest.end(), notice.segments.emplace_back().digest.begin());
  }
  message.notice = std::move(notice);
  return message;
}

}  // namespace eigencast::broker
