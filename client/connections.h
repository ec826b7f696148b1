// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/meters.h"
#include "common/core/log.h"
#include "sdk/subscriber.h"
#include "view/pose_source.h"

namespace eigencast {

/// The sources of a session and their states, one by one and together. Logs changes of state. Not thread-safe.
class Connections final {
 public:
  /// names: for people, without secrets. The sources must outlive it.
  Connections(std::span<PoseSource* const> sources, std::span<const std::string> names, LogSink log);

  /// The index of a source, which is added if it is new and must then outlive its removal.
  std::size_t add(PoseSource& source, const std::string& name);
  /// Later sources move up.
  PoseSource* remove(std::size_t source);
  const std::vector<PoseSource*>& sources() const { return sources_; }
  const std::string& name(std::size_t source) const { return known_[source].name; }

  void refresh(TimeUs now_us);

  const Subscriber::Stats& stats(std::size_t source) const { return known_[source].stats; }
  /// The sums of all counts; the state of the troubled source.
  const Subscriber::Stats& stats() const { return all_; }
  bool are_well() const;
  /// Since when a source has not been well; nothing while it is.
  const std::optional<TimeUs>& lost_since_us(std::size_t source) const { return known_[source].lost_since_us; }
  /// The first that is not well, or the first of all.
  std::size_t troubled() const { return troubled_; }
  /// About the troubled source: see connection_line and banner_text. Empty without sources.
  std::string line(bool has_banner) const;
  std::string banner(std::optional<TimeUs> since_us) const;

 private:
  struct Known {
    std::string name;
    Subscriber::Stats stats;
    std::optional<Subscriber::State> logged;
    std::optional<TimeUs> lost_since_us;
  };
  void read_stats();
  void log_states();

  std::vector<PoseSource*> sources_;
  std::vector<Known> known_;  ///< One for each source.
  Subscriber::Stats all_;
  std::size_t troubled_ = 0;
  LogSink log_;
  RateMeter download_;
};

}  // namespace eigencast
