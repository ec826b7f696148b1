// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/rate_meter.h"
#include "common/core/log.h"
#include "sdk/subscriber.h"
#include "view/pose_source.h"

namespace eigencast {

/// The sources of a session by their numbers, and how they stand, one by one and all together; says on the log when
/// that changes.
///
/// Not thread-safe.
class Connections final {
 public:
  /// names: what people call the first of them; nothing secret. The sources must outlive it.
  Connections(std::span<PoseSource* const> sources, std::span<const std::string> names, LogSink log);

  /// The number of a source, which is taken in if it is new and must then outlive this or its removal.
  std::size_t add(PoseSource& source, const std::string& name);
  /// Forgets a source; those after it move up by one.
  PoseSource* remove(std::size_t source);
  const std::vector<PoseSource*>& sources() const { return sources_; }
  const std::string& name(std::size_t source) const { return known_[source].name; }

  /// To be called in every turn: asks each how it stands, which is what all below tell until the next turn.
  void refresh(TimeUs now_us);

  const Subscriber::Stats& stats(std::size_t source) const { return known_[source].stats; }
  /// Counts of all added up; the state of the first that is not well.
  const Subscriber::Stats& stats() const { return all_; }
  bool are_well() const;
  /// Since when a source has not been well, as of the last refresh(); nothing while it is.
  const std::optional<TimeUs>& lost_since_us(std::size_t source) const { return known_[source].lost_since_us; }
  /// The first that is not well; without one the first of all.
  std::size_t troubled() const { return troubled_; }
  /// Of the troubled one, whose last pose came `since_us` ago (nothing: none ever came). See connection_line and
  /// banner_text; empty without sources.
  std::string line(bool has_banner) const;
  std::string banner(std::optional<TimeUs> since_us) const;

 private:
  struct Known {
    std::string name;
    Subscriber::Stats stats;
    std::optional<Subscriber::State> said;
    std::optional<TimeUs> lost_since_us;
  };
  void ask();
  void say_states();

  std::vector<PoseSource*> sources_;
  std::vector<Known> known_;  ///< Of each source.
  Subscriber::Stats all_;
  std::size_t troubled_ = 0;
  LogSink log_;
  RateMeter download_;
};

}  // namespace eigencast
