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

/// The sources of a session by their numbers, and how they stand, one by one and all together; says on the log when that changes.
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
  const std::string& name(std::size_t source) const { return names_[source]; }

  /// To be called in every turn; returns stats().
  Subscriber::Stats look(TimeUs now_us);

  /// Counts of all added up; the state of the first that is not well.
  Subscriber::Stats stats() const;
  bool are_well() const;
  /// Since when one of them has not been well, as look() saw it.
  const std::optional<TimeUs>& lost_since_us() const { return lost_since_us_; }
  /// See connection_line and banner_text; empty without sources.
  std::string line() const;
  std::string banner(std::optional<TimeUs> newest_arrival_us, TimeUs now_us) const;

 private:
  const PoseSource& troubled() const;
  void say_states();

  std::vector<PoseSource*> sources_;
  std::vector<std::string> names_;
  std::vector<std::optional<Subscriber::State>> said_;
  LogSink log_;
  RateMeter download_;
  std::optional<TimeUs> lost_since_us_;
};

}  // namespace eigencast
