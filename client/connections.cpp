// SPDX-License-Identifier: MIT
#include "client/connections.h"

#include <algorithm>
#include <utility>

#include "client/hud_text.h"

namespace eigencast {
namespace {

bool is_well(Subscriber::State state) {
  return state == Subscriber::State::kLive || state == Subscriber::State::kDownloading;
}

}  // namespace

Connections::Connections(std::span<PoseSource* const> sources, std::span<const std::string> names, LogSink log)
    : sources_(sources.begin(), sources.end()),
      names_(names.begin(), names.begin() + static_cast<std::ptrdiff_t>(std::min(names.size(), sources.size()))),
      said_(sources.size()),
      log_(std::move(log)) {
  names_.resize(sources_.size());
}

std::size_t Connections::add(PoseSource& source, const std::string& name) {
  const auto at = std::find(sources_.begin(), sources_.end(), &source);
  if (at != sources_.end()) return static_cast<std::size_t>(at - sources_.begin());
  sources_.push_back(&source);
  names_.push_back(name);
  said_.emplace_back();
  return sources_.size() - 1;
}

PoseSource* Connections::remove(std::size_t source) {
  const auto at = static_cast<std::ptrdiff_t>(source);
  PoseSource* gone = sources_[source];
  sources_.erase(sources_.begin() + at);
  names_.erase(names_.begin() + at);
  said_.erase(said_.begin() + at);
  return gone;
}

Subscriber::Stats Connections::look(TimeUs now_us) {
  Subscriber::Stats all = stats();
  download_.sample(all.asset_bytes_downloaded, now_us);
  if (are_well()) {
    lost_since_us_.reset();
  } else if (!lost_since_us_) {
    lost_since_us_ = now_us;
  }
  say_states();
  return all;
}

void Connections::say_states() {
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    const Subscriber::Stats stats = sources_[i]->stats();
    if (said_[i] == stats.state) continue;  // the source itself says why and when it tries again
    said_[i] = stats.state;
    std::string line(name_of(stats.state));
    if (sources_.size() > 1) line = names_[i] + ": " + line;
    if (!stats.detail.empty()) line += ": " + stats.detail;
    const bool fine = is_well(stats.state) || stats.state == Subscriber::State::kConnecting ||
                      stats.state == Subscriber::State::kWaiting;
    log(log_, fine ? LogLevel::kInfo : LogLevel::kWarning, line);
  }
}

Subscriber::Stats Connections::stats() const {
  if (sources_.empty()) return {};
  const PoseSource& first = troubled();
  Subscriber::Stats all = first.stats();
  for (const PoseSource* source : sources_) {
    if (source == &first) continue;
    const Subscriber::Stats s = source->stats();
    all.keys += s.keys;
    all.synthetic += s.synthetic;
    all.joins += s.joins;
    all.bytes += s.bytes;
    all.rejected += s.rejected;
    all.skipped += s.skipped;
    all.missed += s.missed;
    all.reconnects += s.reconnects;
    all.asset_bytes_downloaded += s.asset_bytes_downloaded;
    all.asset_bytes_cached += s.asset_bytes_cached;
    all.asset_bytes_total += s.asset_bytes_total;
    all.latency_us.merge(s.latency_us);
  }
  return all;
}

const PoseSource& Connections::troubled() const {
  for (const PoseSource* source : sources_) {
    if (!is_well(source->stats().state)) return *source;
  }
  return *sources_.front();
}

bool Connections::are_well() const {
  return sources_.empty() || is_well(troubled().stats().state);
}

std::string Connections::line() const {
  return sources_.empty() ? std::string() : connection_line(stats(), troubled().info(), download_.per_second());
}

std::string Connections::banner(std::optional<TimeUs> newest_arrival_us, TimeUs now_us) const {
  if (sources_.empty()) return {};
  std::optional<TimeUs> since;
  if (newest_arrival_us) since = now_us - *newest_arrival_us;
  return banner_text(stats(), since);
}

}  // namespace eigencast
