// SPDX-License-Identifier: MIT
// Which profile each viewer of a stream gets, and who pays for what that takes.
#include <algorithm>
#include <utility>

#include "broker/relay/profile_budget.h"
#include "broker/relay/stream.h"

namespace eigencast::broker {
namespace {

/// Makes profiles that request the same frames equal, whatever the epoch's format.
Profile canonical(Profile profile) {
  if (profile.rate == Profile::Rate::kRaw) {
    profile.k = Profile{}.k;
    profile.scheme = Profile{}.scheme;
  }
  return profile;
}

// Asked to pay for a pose, at most: a crowd that cannot must not cost more than the pose.
constexpr std::size_t kMaxPayersAsked = 8;
// What a key costs a profile besides poses: pacing, cutting bands.
constexpr double kProfileKeyUs = 5, kProfileKeyBytesPerUs = 2'000;
constexpr TimeUs kRetryUs = 50'000;  ///< After a key that nobody paid for.

}  // namespace

Result<void> Stream::watch(Watcher& watcher, const Profile& wanted) {
  if (const auto checked = check_profile(wanted); !checked) return checked;
  deliver();
  const auto before = watched_.find(&watcher);
  const bool known = before != watched_.end();
  const std::uint32_t generation = known ? before->second.generation : 0;
  const std::uint32_t came_to = known ? before->second.came_to : present_.memory ? present_.memory->number : 0;
  const bool prepared = known && before->second.prepared;
  auto tracing = known ? std::move(before->second.tracing) : nullptr;
  auto place = known ? forget(watcher) : share_->take_place(watcher.holder(), settings_.max_watchers);
  if (!place) return place.error();
  if (!known) order_.push_back(&watcher);
  Watched& watched = watched_[&watcher] = {canonical(wanted), nullptr, std::move(*place), generation, came_to};
  watched.tracing = std::move(tracing);
  if (prepared && present_.next) note_prepared(watcher, present_.next->asset);
  if (present_.epoch != 0) join_group(watcher, watched);
  if (!awaits_snapshot_) watcher.on_stream_changed(*this, true);
  if (!known) report_count();
  return {};
}

bool Stream::improve(Watcher& watcher) {
  const auto found = watched_.find(&watcher);
  if (found == watched_.end() || found->second.group == nullptr) return false;
  const Profile present = found->second.group->feed.profile(), wanted = found->second.wanted;
  if (present == effective(wanted) || present == affordable(found->second, watcher)) return false;
  return static_cast<bool>(watch(watcher, wanted));
}

void Stream::unwatch(Watcher& watcher) {
  if (!watched_.contains(&watcher)) return;
  deliver();
  forget(watcher);
  std::erase(order_, &watcher);
  trace(watcher, 0);
  report_count();
}

Profile Stream::profile_of(const Watcher& watcher) const {
  const auto found = watched_.find(&watcher);
  if (found == watched_.end()) return {};
  return found->second.group != nullptr ? found->second.group->feed.profile() : found->second.wanted;
}

Profile Stream::effective(const Profile& wanted) const {
  Profile profile = wanted;
  profile.bands = std::clamp<std::uint8_t>(profile.bands, 1, bands());
  if (profile.scheme == Profile::Scheme::kHermite && present_.announced.format.velocity_channels == 0)
    profile.scheme = Profile::Scheme::kLinear;
  return profile;
}

/// What a new watcher of the profile gets. The `stream` message reports it.
Profile Stream::affordable(const Watched& watched, const Watcher& watcher) const {
  const Profile profile = effective(watched.wanted);
  const bool plain = needs_plain(watched);
  if (groups_.contains({profile, plain})) return profile;
  std::size_t cost = 0;
  std::vector<Profile> served;
  for (const auto& [key, group] : groups_) {
    const Profile& other = key.first;
    if (group->plain == plain) served.push_back(other);
    if (!is_common(other)) cost += cost_of(other);
  }
  const bool in_budget = is_common(profile) || cost + cost_of(profile) <= settings_.max_profiles;
  const Profile next = in_budget ? profile : nearest_profile(profile, served, true);
  const bool fits = groups_.contains({next, plain}) ||
                    settings_.memory->encoded.fits(watcher.holder(), encoded_bytes(layout_, next), settings_.max_bytes);
  return fits ? next : nearest_profile(profile, served, false);
}

void Stream::join_group(Watcher& watcher, Watched& watched, const Feed* former) {
  const Profile profile = affordable(watched, watcher);
  const bool plain = needs_plain(watched);
  auto& group = groups_[{profile, plain}];
  if (!group) {
    const VelocityChannels velocities{present_.announced.format.velocity_channels,
                                      present_.announced.format.velocity_us};
    group = std::make_unique<Group>(profile, plain,
                                    Feed::Source{layout_, velocities, id(), present_.epoch, present_.tag,
                                                 settings_.max_span_us, settings_.max_ahead_us});
    group->memory = settings_.memory->encoded.hold(watcher.holder(), encoded_bytes(layout_, profile));
    if (former != nullptr) group->feed.keep_pace_of(*former);
    double work_us = 0;
    if (present_.newest) group->feed.begin_at(plain ? this->plain(&work_us) : present_.newest);
    watcher.charge_key(work_us);
  }
  group->watchers.push_back(&watcher);
  watched.group = group.get();
}

/// Gives up its profile and its slot in the group. Returns its place.
std::shared_ptr<void> Stream::forget(const Watcher& watcher) {
  const auto found = watched_.find(&watcher);
  leave_group(watcher, found->second);
  if (found->second.prepared && present_.next) share_->note_prepared(present_.next->asset, watcher.holder(), -1);
  auto place = std::move(found->second.place);
  watched_.erase(found);
  return place;
}

void Stream::leave_group(const Watcher& watcher, Watched& watched) {
  Group* group = std::exchange(watched.group, nullptr);
  if (group == nullptr) return;
  group->remove(watcher);
  if (group->watchers.empty()) groups_.erase(GroupKey(group->feed.profile(), group->plain));
}

/// Who pays stays the same.
void Stream::Group::remove(const Watcher& watcher) {
  const auto found = std::find(watchers.begin(), watchers.end(), &watcher);
  if (static_cast<std::size_t>(found - watchers.begin()) < payer) --payer;
  watchers.erase(found);
}

template <typename Pays>
bool Stream::Group::find_payer(Pays pays) {
  std::vector<const void*> empty;
  for (std::size_t left = watchers.size(); left > 0; --left, ++payer) {
    Watcher& watcher = *watchers[payer %= watchers.size()];
    if (std::find(empty.begin(), empty.end(), watcher.purse()) != empty.end()) continue;
    if (empty.size() == kMaxPayersAsked) return false;
    if (pays(watcher)) return true;
    empty.push_back(watcher.purse());
  }
  return false;
}

bool Stream::Group::charge_poses(double work_us) {
  if (work_us > 0) return watchers[payer % watchers.size()]->charge_poses(work_us);
  return find_payer([](Watcher& watcher) { return watcher.charge_poses(0); });
}

void Stream::Group::add_key(const Stream& stream, TimeUs now_us) {
  const KeyRecordPtr& record = stream.present_.newest;
  const double work_us = kProfileKeyUs + static_cast<double>(record->payload.size()) / kProfileKeyBytesPerUs;
  retry_us.reset();
  stream.profiles_us_ += work_us;
  if ((feed.profile().rate == Profile::Rate::kRaw && !plain) ||
      find_payer([&](Watcher& watcher) { return watcher.take_key(work_us); })) {
    // A few bytes of a key may name any of its sender's poses, so that the plain one is long.
    double coding_us = 0;
    feed.add_key(plain ? stream.plain(&coding_us) : record, now_us, pending);
    // Its sender pays, too: viewers at many addresses have many budgets.
    stream.unpaid_us_ += coding_us;
    return watchers[payer % watchers.size()]->charge_key(coding_us);
  }
  feed.leave_gap();
  retry_us = now_us + kRetryUs;
}

}  // namespace eigencast::broker
