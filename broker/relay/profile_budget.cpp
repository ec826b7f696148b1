// SPDX-License-Identifier: MIT
#include "broker/relay/profile_budget.h"

#include <tuple>

namespace eigencast::broker {
namespace {

using Rate = Profile::Rate;

bool may_replace(const Profile& asked, const Profile& other) {
  if (other.bands > asked.bands) return false;
  if (other.rate == Rate::kRaw) return true;
  return other.rate == asked.rate && other.k <= asked.k &&
         (other.scheme == asked.scheme || other.scheme == default_scheme(asked.rate));
}

/// REQUIRES: may_replace().
auto nearness(const Profile& asked, const Profile& other) {
  return std::tuple(other.bands, other.rate == asked.rate, other.scheme == asked.scheme, other.k);
}

}  // namespace

bool is_common(const Profile& profile) {
  return profile.rate == Rate::kRaw || (profile.k == Profile{}.k && profile.scheme == default_scheme(profile.rate));
}

std::size_t cost_of(const Profile& profile) {
  return profile.scheme == Profile::Scheme::kCatmullRom ? profile.k : 1;
}

Profile nearest_profile(const Profile& asked, std::span<const Profile> served, bool common) {
  Profile nearest{Rate::kRaw};
  nearest.bands = asked.bands;
  const auto consider = [&](const Profile& other) {
    if (may_replace(asked, other) && nearness(asked, other) > nearness(asked, nearest)) nearest = other;
  };
  Profile usual = asked;
  usual.k = Profile{}.k;
  usual.scheme = default_scheme(asked.rate);
  if (common) consider(usual);
  for (const Profile& other : served) consider(other);
  return nearest;
}

}  // namespace eigencast::broker
