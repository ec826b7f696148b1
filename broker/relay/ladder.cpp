// SPDX-License-Identifier: MIT
#include "broker/relay/ladder.h"

#include <algorithm>
#include <utility>

namespace eigencast::broker {
namespace {

constexpr std::uint16_t kBadSeconds = 2;
constexpr std::uint16_t kGoodSeconds = 10;
constexpr std::uint16_t kMaxGoodSeconds = 160;

// One join in a second may be chance.
constexpr std::uint64_t kManyJoins = 2;

bool is_bad(const Ladder::Counts& lately) {
  const bool many_dropped = lately.dropped >= 3 && lately.dropped * 10 > lately.sent + lately.dropped;
  return many_dropped || lately.joins >= kManyJoins;
}

std::string in_words(const Profile& profile) {
  std::string words = "raw keys";
  if (profile.rate != Profile::Rate::kRaw) {
    words = std::string(kSchemeNames[profile.scheme]) +
            (profile.rate == Profile::Rate::kInterpolated ? " interpolation x" : " estimates x") +
            std::to_string(profile.k);
  }
  return words + ", up to " + std::to_string(profile.bands) + " bands";
}

const char* rung_name(const Profile& rung, const Profile& requested) {
  if (rung == requested) return "asked";
  if (rung.bands < requested.bands) return "fewer-bands";
  return rung.rate == Profile::Rate::kRaw ? "raw" : "linear";
}

std::vector<Profile> rungs_below(const Profile& asked, std::uint8_t bands) {
  std::vector<Profile> rungs{asked};
  Profile next = asked;
  if (next.scheme == Profile::Scheme::kCatmullRom) {
    next.scheme = Profile::Scheme::kLinear;
    rungs.push_back(next);
  }
  if (next.rate != Profile::Rate::kRaw) {
    next = Profile{};
    next.rate = Profile::Rate::kRaw;
    next.bands = asked.bands;
    rungs.push_back(next);
  }
  next.bands = std::min(asked.bands, bands);
  while (next.bands > 1) {
    --next.bands;
    rungs.push_back(next);
  }
  return rungs;
}

}  // namespace

Ladder::Ladder(const Profile& asked) : requested_(asked), climbs_after_(kGoodSeconds) {}

std::optional<Ladder::Step> Ladder::check(const Counts& counts, std::uint8_t bands) {
  const Counts before = std::exchange(seen_, counts);
  const Counts lately{counts.sent - before.sent, counts.dropped - before.dropped, counts.joins - before.joins};
  if (lately.sent == 0) return std::nullopt;  // The reader or the stream pauses.
  if (rung_ == 0 && !is_bad(lately)) {        // The common case.
    bad_seconds_ = 0;
    return ++good_seconds_ < climbs_after_ ? std::nullopt : climb({});
  }
  const auto rungs = rungs_below(requested_, bands);
  rung_ = std::min(rung_, rungs.size() - 1);
  if (is_bad(lately)) {
    good_seconds_ = 0;
    return ++bad_seconds_ >= kBadSeconds ? descend(lately, rungs) : std::nullopt;
  }
  bad_seconds_ = 0;
  if (++good_seconds_ < climbs_after_) return std::nullopt;
  return climb(rungs);
}

std::optional<Ladder::Step> Ladder::descend(const Counts& lately, const std::vector<Profile>& rungs) {
  bad_seconds_ = 0;
  if (std::exchange(climbed_lately_, false)) {
    climbs_after_ = std::min<std::uint16_t>(static_cast<std::uint16_t>(climbs_after_ * 2), kMaxGoodSeconds);
  }
  if (rung_ + 1 >= rungs.size()) return std::nullopt;
  const Profile& next = rungs[++rung_];
  return Step{next, true, rung_name(next, requested_),
              "the link takes less than it is offered (in the last second " + std::to_string(lately.dropped) +
                  " frames dropped, " + std::to_string(lately.joins) + " joins needed): now " + in_words(next) +
                  " instead of " + in_words(rungs[rung_ - 1]) + ", and back when the link recovers"};
}

std::optional<Ladder::Step> Ladder::climb(const std::vector<Profile>& rungs) {
  good_seconds_ = 0;
  if (rung_ == 0) {  // It lasted.
    climbed_lately_ = false;
    climbs_after_ = kGoodSeconds;
    return std::nullopt;
  }
  climbed_lately_ = true;
  const Profile& next = rungs[--rung_];
  return Step{next, false, rung_name(next, requested_),
              "the link took everything for a while: now " + in_words(next) + " again"};
}

}  // namespace eigencast::broker
