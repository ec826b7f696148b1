// SPDX-License-Identifier: MIT
#include "client/patience.h"

#include <algorithm>
#include <utility>

#include "client/clip_source.h"
#include "client/hud_text.h"
#include "client/stream_capture.h"
#include "common/net/http.h"
#include "sdk/broker.h"

namespace eigencast {
namespace {

constexpr std::chrono::seconds kProbeTimeout{3};
constexpr int kMaxAsked = 3;

}  // namespace

Patience::Patience(const ClientOptions& options, std::vector<std::size_t> streams)
    : options_(options), streams_(std::move(streams)), asked_(streams_.size()) {}

bool Patience::is_over(std::span<PoseSource* const> sources, bool has_begun, TimeUs now_us) {
  std::uint64_t bytes = 0;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const Subscriber::Stats stats = sources[i]->stats();
    bytes += stats.asset_bytes_downloaded;
    if (has_begun || stats.state != Subscriber::State::kRefused) continue;
    if (stats.surface_refused || (asked_[i]++ < kMaxAsked && is_final_no(i))) return refused_ = i, true;
  }
  if (std::exchange(bytes_, bytes) != bytes || news_us_ == 0) news_us_ = now_us;
  return static_cast<double>(now_us - news_us_) / 1e6 >= options_.wait_s;
}

std::string Patience::reason(std::span<PoseSource* const> sources) const {
  const auto find = [&](const auto& is_missing) {
    return static_cast<std::size_t>(std::find_if(sources.begin(), sources.end(), is_missing) - sources.begin());
  };
  std::size_t at = refused_.value_or(find([](const PoseSource* source) { return !has_whole_surface(*source); }));
  if (at == sources.size())
    at = find([](const PoseSource* source) { return source->stats().state != Subscriber::State::kLive; });
  at = at == sources.size() ? 0 : at;
  const std::string detail = text_from_state(sources[at]->stats());
  const auto& streams = options_.scene.streams;
  const std::string stream = streams_[at] < streams.size() ? streams[streams_[at]] : "the source";
  if (refused_ && sources[at]->stats().surface_refused)
    return "no pose comes from " + stream + ": its surface cannot be used, see above";
  if (refused_) return "no pose comes from " + stream + ": " + detail;
  return "no pose came from " + stream + " in time (" + detail + "); is a sender running? --wait gives it longer";
}

/// Whether the broker says no in a way that only people can change: token, right, certificate.
bool Patience::is_final_no(std::size_t source) const {
  const std::size_t stream = streams_[source];
  if (stream >= options_.credentials.size() || clip_in(options_.scene.streams[stream])) return false;
  auto url = parse_broker_url(options_.scene.streams[stream]);
  if (!url || !complete_credentials(*url, options_.credentials[stream])) return false;
  const auto refuses = [](const BrokerUrl& there) {
    const auto asked = probe(there, "/v1/subscribe/" + there.stream, kProbeTimeout);
    return !asked && asked.error().code == ErrorCode::kRefused;
  };
  if (!refuses(*url)) return false;
  const auto found = located(*url);
  return !found || refuses(*found);
}

}  // namespace eigencast
