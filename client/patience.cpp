// SPDX-License-Identifier: MIT
#include "client/patience.h"

#include <algorithm>
#include <utility>

#include "client/clip_source.h"
#include "common/net/http.h"
#include "sdk/broker.h"

namespace eigencast {
namespace {

constexpr std::chrono::seconds kProbeTimeout{3};
constexpr int kMaxAsked = 3;

}  // namespace

bool Patience::is_over(std::span<PoseSource* const> sources, bool has_poses, TimeUs now_us) {
  std::uint64_t bytes = 0;
  bool refused = !has_poses;
  for (const PoseSource* source : sources) {
    const Subscriber::Stats stats = source->stats();
    bytes += stats.asset_bytes_downloaded;
    refused = refused && stats.state == Subscriber::State::kRefused;
  }
  if (std::exchange(bytes_, bytes) != bytes || news_us_ == 0) news_us_ = now_us;
  if (refused && asked_ < kMaxAsked && (++asked_, is_final_no())) return is_refused_ = true;
  return static_cast<double>(now_us - news_us_) / 1e6 >= options_.wait_s;
}

std::string Patience::fate_of(const std::string& stream, const std::string& detail) const {
  if (is_refused_) return "no pose comes from " + stream + ": " + detail;
  return "no pose came from " + stream + " in time (" + detail + "); is a sender running? --wait gives it longer";
}

/// Whether every broker says no in a way that only people can change: token, right, certificate.
bool Patience::is_final_no() const {
  const auto says_no = [this](std::size_t i) {
    auto url = parse_broker_url(options_.scene.streams[i]);
    if (!url || !complete_credentials(*url, options_.credentials[i])) return false;
    const auto refuses = [](const BrokerUrl& there) {
      const auto asked = probe(there, "/v1/subscribe/" + there.stream, kProbeTimeout);
      return !asked && asked.error().code == ErrorCode::kRefused;
    };
    if (!refuses(*url)) return false;
    const auto found = located(*url);
    return !found || refuses(*found);
  };
  const std::size_t streams = std::min(options_.scene.streams.size(), options_.credentials.size());
  for (std::size_t i = 0; i < streams; ++i) {
    if (clip_in(options_.scene.streams[i]) || !says_no(i)) return false;
  }
  return streams > 0;
}

}  // namespace eigencast
