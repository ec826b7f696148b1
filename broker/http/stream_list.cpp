// SPDX-License-Identifier: MIT
#include "broker/http/stream_list.h"

#include <array>
#include <charconv>

namespace eigencast::broker {
namespace {

/// By hand: a JSON library takes many times as long. No text in it needs escaping. REQUIRES: announced.
void append_json(const Stream& stream, std::string& out) {
  std::array<char, 32> rate{};
  const auto end = std::to_chars(rate.data(), rate.data() + rate.size(), stream.key_rate_hz()).ptr;
  out.append(R"({"stream":")").append(stream.name());
  out.append(R"(","stream_id":)").append(std::to_string(stream.id()));
  out.append(R"(,"state":")").append(name_of(stream.state()));
  out.append(R"(","epoch":)").append(std::to_string(stream.epoch()));
  out.append(R"(,"asset":")").append(stream.asset());
  out.append(R"(","key_rate_hz":)").append(rate.data(), end);
  out.append(R"(,"keys_received":)").append(std::to_string(stream.keys_received()));
  if (const Generation* memory = stream.memory().get())
    out.append(R"(,"memory_poses":)").append(std::to_string(memory->poses.pose_count()));
  out.append(R"(,"subscribers":)").append(std::to_string(stream.watchers())).append("}");
}

}  // namespace

std::string page_of_streams(const Hub& hub, std::string_view after, std::size_t max,
                            const std::function<bool(std::string_view)>& may_see) {
  std::string page = R"({"streams":[)";
  const Stream* last = nullptr;
  bool more = false;
  for (const Stream* stream : hub.streams(after)) {
    if (stream->epoch() == 0 || !may_see(stream->name())) continue;
    if (more = max-- == 0; more) break;
    if (last != nullptr) page += ',';
    append_json(*stream, page);
    last = stream;
  }
  page += ']';
  if (more) page.append(R"(,"next":")").append(last->name()).append("\"");
  return page + "}\n";
}

}  // namespace eigencast::broker
