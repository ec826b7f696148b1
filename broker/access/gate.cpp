// SPDX-License-Identifier: MIT
#include "broker/access/gate.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/core/share.h"

namespace eigencast::broker {
namespace {

constexpr const char* kResourceNames[] = {"connections", "publishers",   "streams",
                                          "uploads",     "sent_streams", "waiting_streams"};

std::string quoted_list(const StreamPatterns& patterns) {
  std::string out;
  for (const std::string& text : patterns.texts()) {
    if (out.size() > 200) return out + ", ...";
    out += (out.empty() ? "'" : ", '") + text + "'";
  }
  return out.empty() ? "nothing" : out;
}

Result<void> check_right(const Identity& identity, const std::string& right, const StreamPatterns& patterns,
                         std::string_view stream) {
  if (patterns.matches(stream)) return {};
  return fail(ErrorCode::kRefused,
              identity.name + " may not " + right + (right == "speak" ? " in '" : " '") + std::string(stream) +
                  "', only " + quoted_list(patterns) + ": ask the operator of the broker for a token with " +
                  "that right (eigencast-broker token create --" + right + " '" + std::string(stream) + "')");
}

constexpr int kLookedAt = 8;            ///< Of a full ledger's accounts.
constexpr double kTokenCheckUs = 200;   ///< A signature.
constexpr double kFailuresOfSite = 10;  ///< Times those of one of its networks.
constexpr double kWorkAtOnceS = 0.02;   ///< By default 5 ms: others wait no longer for each holder.

TimeUs wait_from(double paid_until_us, double amount, double per_s, double burst, TimeUs now_us) {
  const double ahead_us = std::max(paid_until_us - static_cast<double>(now_us), 0.0) + amount * 1e6 / per_s;
  // An amount over the burst is taken when idle, or it never would be.
  const double allowed_us = std::max(burst, amount) * 1e6 / per_s;
  return ahead_us <= allowed_us + 0.5 ? 0 : static_cast<TimeUs>(std::ceil(ahead_us - allowed_us));
}

Error too_few_free(const char* limit, std::int64_t max) {
  return fail(ErrorCode::kRefused, "of limits." + std::string(limit) + " = " + std::to_string(max) +
                                       " too few are free for one that holds more: try again later");
}

Result<void> without_wait(const Result<TimeUs>& taken) {
  return taken ? Result<void>() : taken.error();
}

}  // namespace

std::optional<TimeUs> RateLimiter::take(double amount, double per_s, double burst, TimeUs now_us, TimeUs max_wait_us) {
  if (per_s <= 0) return 0;
  double paid_until_us = paid_until_us_;
  double then = 0;
  TimeUs wait_us = 0;
  do {
    wait_us = wait_from(paid_until_us, amount, per_s, burst, now_us);
    if (wait_us > max_wait_us) return std::nullopt;
    then = std::max(paid_until_us, static_cast<double>(now_us)) + amount * 1e6 / per_s;
  } while (!paid_until_us_.compare_exchange_weak(paid_until_us, then));
  return wait_us;
}

TimeUs RateLimiter::wait_us(double amount, double per_s, double burst, TimeUs now_us) const {
  return per_s <= 0 ? 0 : wait_from(paid_until_us_, amount, per_s, burst, now_us);
}

bool UseCount::take(std::int64_t max, std::int64_t amount) {
  std::int64_t count = count_;
  do {
    if (count > max - amount) return false;
  } while (!count_.compare_exchange_weak(count, count + amount));
  return true;
}

bool Account::is_idle(TimeUs now_us) const {
  return std::all_of(resources.begin(), resources.end(), [](const UseCount& resource) { return resource.is_idle(); }) &&
         unfinished_bytes.is_idle() && wide_bytes.is_idle() && messages.is_idle(now_us) && requests.is_idle(now_us) &&
         listings.is_idle(now_us) && work.is_idle(now_us) && poses.is_idle(now_us) && profile_keys.is_idle(now_us) &&
         deliveries.is_idle(now_us) && news.is_idle(now_us) && http_work.is_idle(now_us) &&
         upload_bytes.is_idle(now_us) && download_bytes.is_idle(now_us) && failures.is_idle(now_us) &&
         announcements.is_idle(now_us);
}

std::shared_ptr<Account> Ledger::account(const std::string& key, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  if (const auto found = accounts_.find(key); found != accounts_.end()) {
    by_use_.splice(by_use_.end(), by_use_, found->second.use);
    return found->second.account;
  }
  if (accounts_.size() >= max_ && !forget_one(now_us)) return overflow_;
  const auto added = accounts_.try_emplace(key).first;
  added->second.use = by_use_.insert(by_use_.end(), &added->first);
  return added->second.account;
}

bool Ledger::forget_one(TimeUs now_us) {
  auto forgotten = by_use_.end();
  auto next = by_use_.begin();
  for (int i = 0; i < kLookedAt && next != by_use_.end(); ++i) {
    const auto use = next++;
    const auto& account = accounts_.find(**use)->second.account;
    if (account.use_count() > 1) {
      by_use_.splice(by_use_.end(), by_use_, use);
      continue;
    }
    const bool is_idle = account->is_idle(now_us);
    if (is_idle || forgotten == by_use_.end()) forgotten = use;
    if (is_idle) break;
  }
  if (forgotten == by_use_.end()) return false;
  accounts_.erase(accounts_.find(**forgotten));
  by_use_.erase(forgotten);
  return true;
}

Grant::Grant(Gate& gate, Identity identity, const IpAddress& peer, std::shared_ptr<const AccessPolicy> policy,
             TimeUs now_us)
    : gate_(gate), identity_(std::move(identity)), spared_(policy->is_own_machine(peer)), policy_(std::move(policy)) {
  holders_.reserve(identity_.key.empty() ? 1 : 2);
  const IpAddress& address = identity_.client.address;
  holders_.push_back({gate_.addresses_.account(address.limit_key(), now_us), false});
  if (!identity_.key.empty()) holders_.push_back({gate_.tokens_.account(holder(), now_us), true});
  site_ = holders_.back().account;
  if (identity_.key.empty() && !address.is_v4()) site_ = gate_.addresses_.account(holder(), now_us);
}

Grant::~Grant() {
  for (std::size_t i = 0; i < kResources; ++i) {
    while (taken_[i] > 0) give_back(static_cast<Resource>(i));
  }
}

std::string Grant::label() const {
  return identity_.name + " from " + identity_.client.address.text();
}

Result<void> Grant::may_publish(std::string_view stream) const {
  return check_right(identity_, "publish", identity_.rights.publish, stream);
}

Result<void> Grant::may_subscribe(std::string_view stream) const {
  return check_right(identity_, "subscribe", identity_.rights.subscribe, stream);
}

Result<void> Grant::may_rewind(std::string_view stream) const {
  return check_right(identity_, "rewind", identity_.rights.rewind, stream);
}

Result<void> Grant::may_speak(std::string_view room) const {
  return check_right(identity_, "speak", identity_.rights.speak, room);
}

Result<void> Grant::may_store_assets() const {
  if (!identity_.rights.publish.empty()) return {};
  return fail(ErrorCode::kRefused, identity_.name + " may not publish, and so not store assets");
}

Result<void> Grant::may_fetch_assets() const {
  const Rights& rights = identity_.rights;
  if (!rights.publish.empty() || !rights.subscribe.empty() || rights.admin) return {};
  return fail(ErrorCode::kRefused, identity_.name + " may neither publish nor subscribe, and so not fetch assets");
}

bool Grant::may_see(std::string_view stream) const {
  const Rights& rights = identity_.rights;
  return rights.admin || rights.subscribe.matches(stream) || rights.publish.matches(stream);
}

std::size_t Grant::patterns() const {
  return identity_.rights.subscribe.texts().size() + identity_.rights.publish.texts().size();
}

Result<void> Grant::may_administer() const {
  if (identity_.rights.admin) return {};
  return fail(ErrorCode::kRefused, identity_.name + " lacks the right 'admin' (eigencast-broker token create --admin)");
}

bool Grant::has_expired(std::int64_t now_unix_s) const {
  return identity_.expires_s && now_unix_s >= *identity_.expires_s && policy_->expiry_disconnects();
}

bool Grant::is_void() {
  auto now = gate_.policy();
  if (now == policy_) return false;
  if (!now->vouches_for(identity_, *policy_)) return true;
  policy_ = std::move(now);
  return false;
}

Error Grant::over(const Holder& holder, const char* limit, std::int64_t max) const {
  return fail(ErrorCode::kRefused,
              (holder.is_token ? identity_.name : "address " + identity_.client.address.limit_key()) +
                  " has reached a limit of this broker: " + (holder.is_token ? "per_token." : "per_address.") + limit +
                  " = " + std::to_string(max));
}

Result<void> Grant::take(Resource resource) {
  const auto index = static_cast<std::size_t>(resource);
  for (std::size_t i = 0; i < holders_.size(); ++i) {
    const std::int64_t max = policy_->quota(holders_[i].is_token).resources[index];
    if (holders_[i].account->resources[index].take(max)) continue;
    if (i > 0) holders_[0].account->resources[index].give_back();
    return over(holders_[i], kResourceNames[index], max);
  }
  if (has_site()) site_->resources[index].add(1);
  if (resource == Resource::kStream) gate_.watched_streams_.add(1);
  ++taken_[index];
  return {};
}

Result<void> Grant::take_watched_stream() {
  const std::int64_t max = policy_->max_watched_streams();
  const std::int64_t own = site_->resources[static_cast<std::size_t>(Resource::kStream)].count();
  if (own >= share_of(max, gate_.watched_streams_.count(), own, spared_))
    return too_few_free("max_watched_streams", max);
  return take(Resource::kStream);
}

void Grant::give_back(Resource resource) {
  count(resource, -1);
}

void Grant::count(Resource resource, std::int64_t amount) {
  const auto index = static_cast<std::size_t>(resource);
  taken_[index] += amount;
  for (Holder& holder : holders_) holder.account->resources[index].add(amount);
  if (resource == Resource::kStream) gate_.watched_streams_.add(amount);
  if (has_site()) site_->resources[index].add(amount);
}

Result<void> Grant::take_share(Resource resource, std::int64_t max, std::int64_t used) {
  if (auto taken = take(resource); !taken) return taken;
  const auto index = static_cast<std::size_t>(resource);
  const std::int64_t own = site_->resources[index].count();
  if (own <= share_of(max, used, own - 1, spared_)) return {};
  give_back(resource);
  return too_few_free(("max_" + std::string(kResourceNames[index])).c_str(), max);
}

Result<void> Grant::take_place(std::int64_t open, Grant* former) {
  constexpr Resource kPlace = Resource::kConnection;
  const std::int64_t had = former != nullptr ? former->taken_[static_cast<std::size_t>(kPlace)] : 0;
  if (had > 0) former->give_back(kPlace);
  auto taken = take_share(kPlace, policy_->max_connections(), open);
  if (!taken && had > 0) former->count(kPlace, 1);
  return taken;
}

Result<std::shared_ptr<void>> Grant::hold(Resource resource) const {
  const Holder& holder = holders_.back();
  const auto index = static_cast<std::size_t>(resource);
  const std::int64_t most = policy_->quota(holder.is_token).resources[index];
  if (!site_->resources[index].take(most)) return over(holder, kResourceNames[index], most);
  return std::shared_ptr<void>(site_.get(), [site = site_, index](void*) { site->resources[index].give_back(); });
}

Result<std::shared_ptr<void>> Grant::hold_bytes(std::size_t bytes, double part) const {
  if (bytes <= kFreeBytes) return std::shared_ptr<void>();
  const Holder& holder = holders_.back();
  const auto amount = static_cast<std::int64_t>(bytes);
  const std::int64_t quota = policy_->quota(holder.is_token).unfinished_bytes;
  const std::int64_t max = policy_->max_unfinished_bytes();
  const std::int64_t own = site_->unfinished_bytes.count();
  const auto parted = [part](std::int64_t of) { return static_cast<std::int64_t>(static_cast<double>(of) * part); };
  if (own + amount > parted(share_of(max, gate_.unfinished_bytes_.count(), own)))
    return too_few_free("max_unfinished_bytes", max);
  if (!holder.account->unfinished_bytes.take(parted(quota), amount)) return over(holder, "unfinished_bytes", quota);
  if (has_site()) site_->unfinished_bytes.add(amount);
  gate_.unfinished_bytes_.add(amount);
  const auto give_back = [account = holder.account, site = has_site() ? site_ : nullptr, amount,
                          &all = gate_.unfinished_bytes_](void*) {
    account->unfinished_bytes.give_back(amount);
    if (site) site->unfinished_bytes.give_back(amount);
    all.give_back(amount);
  };
  return std::shared_ptr<void>(holder.account.get(), give_back);
}

Result<std::shared_ptr<void>> Grant::hold_wide(std::size_t bytes) const {
  const auto amount = static_cast<std::int64_t>(bytes);
  const std::int64_t max = policy_->max_unfinished_bytes() / 2, own = site_->wide_bytes.count();
  if (own + amount > share_of(max, gate_.wide_bytes_.count(), own)) return too_few_free("max_unfinished_bytes", max);
  site_->wide_bytes.add(amount);
  gate_.wide_bytes_.add(amount);
  return std::shared_ptr<void>(site_.get(), [site = site_, amount, &all = gate_.wide_bytes_](void*) {
    site->wide_bytes.give_back(amount);
    all.give_back(amount);
  });
}

std::string Grant::holder() const {
  const std::string site = identity_.client.address.site_key();
  if (identity_.key.empty()) return "address " + site;
  return identity_.rights.publish.empty() ? identity_.key + " at " + site : identity_.key;
}

Result<void> Grant::take_message(TimeUs now_us) {
  return without_wait(take_rate({"messages_per_s", &Account::messages, &Quota::messages_per_s, 1}, 1, now_us));
}

Result<void> Grant::take_upload(std::uint64_t bytes, TimeUs now_us) {
  return without_wait(take_rate({"upload_bytes_per_hour", &Account::upload_bytes, &Quota::upload_bytes_per_hour, 3600},
                                static_cast<double>(bytes), now_us));
}

Result<void> Grant::take_download(std::uint64_t bytes, TimeUs now_us) {
  return without_wait(
      take_rate({"download_bytes_per_hour", &Account::download_bytes, &Quota::download_bytes_per_hour, 3600},
                static_cast<double>(bytes), now_us));
}

std::optional<TimeUs> Grant::take_work(double work_us, TimeUs now_us, TimeUs max_wait_us) {
  return take_loop_time(&Account::work, work_us, now_us, max_wait_us);
}

bool Grant::charge_poses(double work_us, TimeUs now_us) {
  return take_loop_time(&Account::poses, work_us, now_us, kForeverUs) == 0;
}

bool Grant::take_profile_key(double work_us, TimeUs now_us) {
  constexpr TimeUs kMaxAheadUs = 1'000'000;  // Keys come in bursts, and what is left out is not sent again.
  return take_loop_time(&Account::profile_keys, work_us, now_us, kMaxAheadUs).has_value();
}

void Grant::charge_profile_key(double work_us, TimeUs now_us) {
  (void)take_loop_time(&Account::profile_keys, work_us, now_us, kForeverUs);
}

TimeUs Grant::charge_deliveries(double work_us, TimeUs now_us) {
  return is_spared() ? 0 : *take_loop_time(&Account::deliveries, work_us, now_us, kForeverUs);
}

TimeUs Grant::charge_news(double work_us, TimeUs now_us) {
  return *take_loop_time(&Account::news, work_us, now_us, kForeverUs);
}

std::optional<TimeUs> Grant::take_http_work(double work_us, TimeUs now_us, TimeUs max_wait_us) {
  return take_loop_time(&Account::http_work, work_us, now_us, max_wait_us);
}

std::optional<TimeUs> Grant::take_loop_time(RateLimiter Account::*limiter, double us, TimeUs now_us,
                                            TimeUs max_wait_us) {
  const auto per_s = static_cast<double>(policy_->quota(holders_.back().is_token).work_us_per_s);
  return ((*site_).*limiter).take(us, per_s, per_s * kWorkAtOnceS, now_us, max_wait_us);
}

Result<void> Grant::take_announcement(bool is_new, TimeUs now_us) {
  RateLimiter& rate = site_->announcements;
  const double amount = is_new ? kNewName : 1;
  if (rate.take(amount, kAnnouncementsPerHour / 3600, kAnnouncementsPerHour, now_us)) return {};
  return fail(ErrorCode::kRefused, label() + " has announced streams too often, more than " +
                                       std::to_string(static_cast<int>(kAnnouncementsPerHour)) +
                                       " times in an hour (a new name counts as " +
                                       std::to_string(static_cast<int>(kNewName)) + "): try again in a minute");
}

Result<TimeUs> Grant::take_request(double listing, TimeUs now_us, TimeUs max_wait_us) {
  const auto take = [&](RateLimiter Account::*limiter, double cost) {
    const Rate rate{"requests_per_s", limiter, &Quota::requests_per_s, 1};
    return take_rate(rate, holders_.back(), cost, now_us, max_wait_us);
  };
  const auto list_wait_us = listing > 0 ? take(&Account::listings, listing) : Result<TimeUs>(0);
  if (!list_wait_us) return list_wait_us;
  const auto wait_us = take(&Account::requests, 1);
  return wait_us ? Result<TimeUs>(std::max(*wait_us, *list_wait_us)) : wait_us;
}

Result<TimeUs> Grant::take_rate(const Rate& rate, double amount, TimeUs now_us, TimeUs max_wait_us) {
  TimeUs longest_us = 0;
  for (const Holder& holder : holders_) {
    const auto wait_us = take_rate(rate, holder, amount, now_us, max_wait_us);
    if (!wait_us) return wait_us;
    longest_us = std::max(longest_us, *wait_us);
  }
  return longest_us;
}

Result<TimeUs> Grant::take_rate(const Rate& rate, const Holder& holder, double amount, TimeUs now_us,
                                TimeUs max_wait_us) {
  const std::int64_t max = policy_->quota(holder.is_token).*rate.max;
  const auto in_period = static_cast<double>(max);
  RateLimiter& limiter = (*holder.account).*rate.limiter;
  const auto wait_us = limiter.take(amount, in_period / rate.period_s, in_period, now_us, max_wait_us);
  if (!wait_us) return over(holder, rate.setting, max);
  return *wait_us;
}

TimeUs Grant::failure_wait_us(TimeUs now_us) const {
  const auto max = static_cast<double>(policy_->failures_per_minute());
  const auto of = [&](const Account& account, double most) {
    return account.failures.wait_us(1, most / 60, most, now_us);
  };
  return std::max(of(*holders_.back().account, max), has_site() ? of(*site_, max * kFailuresOfSite) : 0);
}

void Grant::note_failure(TimeUs now_us) {
  const auto max = static_cast<double>(policy_->failures_per_minute());
  (void)holders_.back().account->failures.take(1, max / 60, max, now_us);
  const double most = max * kFailuresOfSite;
  if (has_site()) (void)site_->failures.take(1, most / 60, most, now_us);
}

double Gate::check_us(const AccessRequest& request, std::int64_t now_unix_s) const {
  return policy()->must_verify(request, now_unix_s) ? kTokenCheckUs : 0;
}

std::variant<GrantPtr, Denial> Gate::admit(const AccessRequest& request, TimeUs now_us, std::int64_t now_unix_s,
                                           bool is_paid) {
  const auto rules = policy();
  // Requests without a token are not throttled: they guess none.
  const bool with_token = !request.authorization.empty() || !request.query_token.empty();
  const auto payer = with_token ? stranger(request, now_us) : nullptr;
  const TimeUs wait_us = payer ? payer->failure_wait_us(now_us) : 0;
  const Denial slowed{429, "too many failed tries to log in from this address: wait before the next",
                      static_cast<int>(wait_us / 1'000'000 + 1)};
  // A good token (of 256 bits, none is guessed) is let in beside others' wrong ones, while the site pays for both.
  const double us = is_paid ? 0 : check_us(request, now_unix_s);
  if (us > 0 && !payer->take_http_work(us, now_us, 0)) {
    ++denied_;
    return slowed;
  }
  auto found = rules->identify(request, now_unix_s);
  if (auto* denied = std::get_if<Denial>(&found)) {
    ++denied_;
    if (!payer || !denied->failed_login) return std::move(*denied);
    if (wait_us > 0) return slowed;
    payer->note_failure(now_us);
    return std::move(*denied);
  }
  return GrantPtr(new Grant(*this, std::move(std::get<Identity>(found)), request.peer, rules, now_us));
}

std::optional<Denial> Gate::admit_admin(const AccessRequest& request, AdminRequest ask, TimeUs now_us,
                                        std::int64_t now_unix_s) {
  const auto rules = policy();
  const bool free = ask == AdminRequest::kRead || !rules->has_tokens();
  if (free && rules->is_local(request, false)) return std::nullopt;
  if (ask == AdminRequest::kRead && rules->is_monitor(request)) return std::nullopt;
  auto admitted = admit(request, now_us, now_unix_s);
  if (auto* denied = std::get_if<Denial>(&admitted)) return std::move(*denied);
  const auto& grant = std::get<GrantPtr>(admitted);
  const auto may = grant->may_administer();
  if (may) return std::nullopt;
  ++denied_;
  if (grant->identity().key.empty()) return Denial{401, "the admin port asks for a token with the right admin"};
  return Denial{403, may.error().message};
}

GrantPtr Gate::nameless(const IpAddress& address, const IpAddress& peer, std::shared_ptr<const AccessPolicy> rules,
                        TimeUs now_us) {
  Identity identity;
  identity.name = "connection";
  identity.client.address = address;
  return GrantPtr(new Grant(*this, std::move(identity), peer, std::move(rules), now_us));
}

GrantPtr Gate::stranger(const AccessRequest& request, TimeUs now_us) {
  const auto rules = policy();
  return nameless(rules->client_address(request).address, request.peer, rules, now_us);
}

std::variant<GrantPtr, Denial> Gate::accept(const IpAddress& peer, std::int64_t open, TimeUs now_us) {
  const auto rules = policy();
  if (open >= rules->max_connections()) {
    return Denial{503, "all connections that limits.max_connections allows are in use: try again later", 5};
  }
  GrantPtr grant = nameless(peer, peer, rules, now_us);
  const auto placed = rules->is_trusted_proxy(peer) ? Result<void>() : grant->take_place(open);
  if (!placed) return Denial{429, placed.error().message, 1};
  return grant;
}

void Gate::replace_policy(std::shared_ptr<const AccessPolicy> policy) {
  const std::lock_guard lock(policy_mutex_);
  policy_ = std::move(policy);
}

std::shared_ptr<const AccessPolicy> Gate::policy() const {
  const std::lock_guard lock(policy_mutex_);
  return policy_;
}

}  // namespace eigencast::broker
