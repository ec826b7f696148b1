// SPDX-License-Identifier: MIT
#include "client/connections.h"

#include <algorithm>
#include <utility>

#include "client/hud_text.h"
#include "common/core/clock.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

bool is_well(Subscriber::State state) {
  return state == Subscriber::State::kLive || state == Subscriber::State::kDownloading;
}

void add_counts(const Subscriber::Stats& one, Subscriber::Stats& all) {
  using Stats = Subscriber::Stats;
  constexpr std::uint64_t Stats::*kCounts[] = {&Stats::keys,
                                               &Stats::synthetic,
                                               &Stats::joins,
                                               &Stats::frames,
                                               &Stats::bytes,
                                               &Stats::recalled,
                                               &Stats::memory_bytes,
                                               &Stats::rejected,
                                               &Stats::dropped,
                                               &Stats::missed,
                                               &Stats::reconnects,
                                               &Stats::asset_bytes_downloaded,
                                               &Stats::asset_bytes_cached,
                                               &Stats::asset_bytes_total};
  for (const auto count : kCounts) all.*count += one.*count;
  all.latency_us.merge(one.latency_us);
}

}  // namespace

Connections::Connections(std::span<PoseSource* const> sources, std::span<const std::string> names, LogSink log)
    : sources_(sources.begin(), sources.end()), known_(sources.size()), log_(std::move(log)) {
  for (std::size_t i = 0; i < std::min(names.size(), known_.size()); ++i) known_[i].name = names[i];
  read_stats();
}

std::size_t Connections::add(PoseSource& source, const std::string& name) {
  const auto at = std::find(sources_.begin(), sources_.end(), &source);
  if (at != sources_.end()) return static_cast<std::size_t>(at - sources_.begin());
  sources_.push_back(&source);
  known_.push_back({name, {}, {}, {}});
  read_stats();
  return sources_.size() - 1;
}

PoseSource* Connections::remove(std::size_t source) {
  const auto at = static_cast<std::ptrdiff_t>(source);
  PoseSource* gone = sources_[source];
  sources_.erase(sources_.begin() + at);
  known_.erase(known_.begin() + at);
  read_stats();
  return gone;
}

void Connections::refresh(TimeUs now_us) {
  read_stats();
  download_.sample(all_.asset_bytes_downloaded, now_us);
  for (Known& known : known_) {
    if (is_well(known.stats.state)) {
      known.lost_since_us.reset();
    } else if (!known.lost_since_us) {
      known.lost_since_us = now_us;
    }
  }
  log_states();
}

void Connections::read_stats() {
  for (std::size_t i = 0; i < sources_.size(); ++i) known_[i].stats = sources_[i]->stats();
  const auto bad =
      std::find_if(known_.begin(), known_.end(), [](const Known& known) { return !is_well(known.stats.state); });
  troubled_ = bad == known_.end() ? 0 : static_cast<std::size_t>(bad - known_.begin());
  all_ = known_.empty() ? Subscriber::Stats{} : known_[troubled_].stats;
  for (std::size_t i = 0; i < known_.size(); ++i) {
    if (i != troubled_) add_counts(known_[i].stats, all_);
  }
}

void Connections::log_states() {
  for (std::size_t i = 0; i < known_.size(); ++i) {
    Known& known = known_[i];
    const Subscriber::Stats& stats = known.stats;
    if (known.logged == stats.state) continue;
    known.logged = stats.state;
    if (stats.state == Subscriber::State::kRefused && stats.surface_refused) continue;  // which was said when it came
    const bool is_file = stats.state == Subscriber::State::kLive && sources_[i]->timeline() != nullptr;
    std::string line = is_file && stats.detail.empty() ? "it can be shown" : text_from_state(stats);
    if (sources_.size() > 1) line = known.name + ": " + line;
    const bool fine = is_well(stats.state) || stats.state == Subscriber::State::kConnecting ||
                      stats.state == Subscriber::State::kWaiting;
    log(log_, fine ? LogLevel::kInfo : LogLevel::kWarning, line);
  }
}

bool Connections::are_well() const {
  return known_.empty() || is_well(all_.state);
}

std::string Connections::line(bool has_banner) const {
  if (sources_.empty()) return {};
  Subscriber::Stats stats = all_;
  const bool plays = stats.state == Subscriber::State::kLive && sources_[troubled_]->timeline() != nullptr;
  if (plays && stats.detail.empty())
    stats.detail = text_from_timeline(*sources_[troubled_]->timeline(), steady_now_us());
  const std::string line = connection_line(stats, sources_[troubled_]->info(), download_.per_second(), has_banner);
  if (known_.size() == 1) return line;
  if (std::ranges::all_of(sources_, [](const PoseSource* source) { return source->timeline() != nullptr; }))
    return formatted("%zu files \xC2\xB7 ", known_.size()) + line;
  const auto live = static_cast<std::size_t>(std::count_if(
      known_.begin(), known_.end(), [](const Known& k) { return k.stats.state == Subscriber::State::kLive; }));
  const bool complete = all_.asset_bytes_downloaded + all_.asset_bytes_cached >= all_.asset_bytes_total;
  const std::string count = formatted("%zu of %zu live", live, known_.size());
  return live == known_.size() && complete ? count : count + " \xC2\xB7 " + line;
}

std::string Connections::banner(std::optional<TimeUs> since_us) const {
  if (sources_.empty()) return {};
  const std::string text = banner_text(all_, since_us);
  return text.empty() || known_.size() == 1 ? text : known_[troubled_].name + ": " + text;
}

}  // namespace eigencast
