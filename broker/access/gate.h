// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <limits>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "broker/access/policy.h"
#include "common/core/clock.h"

namespace eigencast::broker {

/// What a read costs an event loop, however few bytes it brings: a system call, or a TLS record.
inline constexpr double kReadUs = 3;
inline constexpr double kPauseUs = 20;  ///< And a pause before the next.
inline constexpr TimeUs kForeverUs = std::numeric_limits<TimeUs>::max();

/// Takes an amount while no more than `burst` is ahead of the steady rate (the generic cell rate algorithm, ATM Forum
/// 1996). Thread-safe, without a lock.
class RateLimiter {
 public:
  /// How long to wait before using what was taken; nothing: longer than max_wait_us, and it was not taken.
  /// `per_s` <= 0: no limit.
  std::optional<TimeUs> take(double amount, double per_s, double burst, TimeUs now_us, TimeUs max_wait_us = 0);
  TimeUs wait_us(double amount, double per_s, double burst, TimeUs now_us) const;
  bool is_idle(TimeUs now_us) const { return paid_until_us_ <= static_cast<double>(now_us); }

 private:
  std::atomic<double> paid_until_us_{0};
};

/// Counts objects or bytes in use. Thread-safe, without a lock.
class UseCount {
 public:
  bool take(std::int64_t max, std::int64_t amount = 1);
  void add(std::int64_t amount) { count_ += amount; }
  void give_back(std::int64_t amount = 1) { count_ -= amount; }
  std::int64_t count() const { return count_; }
  bool is_idle() const { return count_ == 0; }

 private:
  std::atomic<std::int64_t> count_{0};
};

/// Usage of one address or token. Thread-safe.
struct Account {
  std::array<UseCount, kResources> resources;
  UseCount unfinished_bytes, wide_bytes;
  RateLimiter messages;
  RateLimiter requests;
  RateLimiter listings;
  RateLimiter work;
  RateLimiter poses;
  RateLimiter profile_keys;
  RateLimiter deliveries;
  RateLimiter news;
  RateLimiter http_work;
  RateLimiter upload_bytes;
  RateLimiter download_bytes;
  RateLimiter failures;
  RateLimiter announcements;
  bool is_idle(TimeUs now_us) const;
};

/// Accounts by key. When it is full, of the few used longest ago one that nobody holds is forgotten for each new key,
/// an idle one if there is one, else rates and all: strangers with many addresses must not spend the rates of
/// newcomers. If all of these are held, the key shares an account with others such, which is stricter for them.
/// Thread-safe: the lock covers lookup, not use.
class Ledger {
 public:
  explicit Ledger(std::size_t max = 65'536) : max_(max) {}

  std::shared_ptr<Account> account(const std::string& key, TimeUs now_us);

 private:
  using Uses = std::list<const std::string*>;  ///< Keys.
  struct Entry {
    std::shared_ptr<Account> account = std::make_shared<Account>();
    Uses::iterator use{};
  };
  bool forget_one(TimeUs now_us);  ///< REQUIRES: mutex_.

  std::size_t max_;
  std::mutex mutex_;
  std::map<std::string, Entry> accounts_;  ///< GUARDED_BY(mutex_)
  Uses by_use_;                            ///< Longest ago first. GUARDED_BY(mutex_)
  std::shared_ptr<Account> overflow_ = std::make_shared<Account>();
};

class Gate;

/// The rights of one connection and its usage, which the destructor returns. Not thread-safe. The Gate outlives it.
class Grant {
 public:
  ~Grant();
  Grant(const Grant&) = delete;
  Grant& operator=(const Grant&) = delete;

  const Identity& identity() const { return identity_; }
  std::string label() const;  ///< For logs: name and address.
  /// Errors: kRefused; the message names the missing right.
  Result<void> may_publish(std::string_view stream) const;
  Result<void> may_subscribe(std::string_view stream) const;
  Result<void> may_speak(std::string_view room) const;
  Result<void> may_rewind(std::string_view stream) const;
  Result<void> may_store_assets() const;
  Result<void> may_fetch_assets() const;
  bool may_see(std::string_view stream) const;  ///< In the list of streams.
  std::size_t patterns() const;                 ///< That may_see() compares, at most.
  Result<void> may_administer() const;
  bool has_expired(std::int64_t now_unix_s) const;  ///< If access.expiry_disconnects is set.
  bool is_void();                                   ///< A reload has revoked it.

  /// Errors: kRefused: a limit of the address or the token is reached; the message names it.
  Result<void> take(Resource resource);
  void give_back(Resource resource);
  /// Takes one of `max` of all, of which `used` are in use, within the holder's share_of() them. Errors: as take().
  Result<void> take_share(Resource resource, std::int64_t max, std::int64_t used);
  /// Takes kStream, within the holder's share_of() limits.max_watched_streams. Errors: as take().
  Result<void> take_watched_stream();
  /// Takes kConnection, within the holder's share_of() limits.max_connections while `open` others are open, over from
  /// `former`, if that has it, whose it stays on failure. On the thread of Gate::accept(). Errors: as take().
  Result<void> take_place(std::int64_t open, Grant* former = nullptr);
  /// take() for what outlasts the connection: the holder()'s, until the pointer ends.
  Result<std::shared_ptr<void>> hold(Resource resource) const;
  /// Whose limits, shares and time it takes: a token, or an address without one. Many may have a token that only views
  /// (a link of --share), so that each address with it is one.
  std::string holder() const;
  /// Whether it comes from this machine, through no proxy known to be one, and so may have more than its share.
  bool is_spared() const { return spared_; }
  /// Memory of a message that came in part, or of an answer sent in part: counts until the pointer ends, towards the
  /// token's limit and share_of() all, or the address's without one. The first kFreeBytes of a connection are free
  /// (null). Only `part` of what it may have counts as there. Errors: kRefused.
  static constexpr std::size_t kFreeBytes = 4096;
  Result<std::shared_ptr<void>> hold_bytes(std::size_t bytes, double part = 1) const;
  /// Memory that stays as long as its connection: counts apart, towards share_of() half as much, so that what comes and
  /// goes finds its share whatever stays. Errors: kRefused.
  Result<std::shared_ptr<void>> hold_wide(std::size_t bytes) const;
  Result<void> take_message(TimeUs now_us);
  Result<void> take_upload(std::uint64_t bytes, TimeUs now_us);
  Result<void> take_download(std::uint64_t bytes, TimeUs now_us);
  /// Microseconds that a message takes of an event loop, by an estimate that depends on its bytes only: the token's, or
  /// the address's without one, whatever the connection. Returns how long it must wait; nothing: longer than
  /// max_wait_us, and it was not taken.
  std::optional<TimeUs> take_work(double work_us, TimeUs now_us, TimeUs max_wait_us);
  /// The same for poses between keys that it watches, apart, once they are made: false: the next one has to wait.
  bool charge_poses(double work_us, TimeUs now_us);
  /// The same for keys in the profiles that it watches. False: it was not taken, the key has to be left out.
  bool take_profile_key(double work_us, TimeUs now_us);
  void charge_profile_key(double work_us, TimeUs now_us);  ///< Once it is made: whatever is left.
  /// The same for frames that were written to it, apart: how long no more should be. This machine's have no limit.
  TimeUs charge_deliveries(double work_us, TimeUs now_us);
  /// The same for what it is told of rooms and moments, apart: it does not choose what others say.
  TimeUs charge_news(double work_us, TimeUs now_us);
  const void* purse() const { return site_.get(); }  ///< The same for all who share these budgets.
  /// The same for HTTP and TLS handshakes, apart: newcomers must not delay the messages of those that are in.
  std::optional<TimeUs> take_http_work(double work_us, TimeUs now_us, TimeUs max_wait_us);
  /// An epoch: there are four billions, for all time. At most kAnnouncementsPerHour, where one under a name that is new
  /// here, of which all brokers keep a row for a while, counts kNewName. Errors: as take().
  Result<void> take_announcement(bool is_new, TimeUs now_us);
  static constexpr double kNewName = 36;
  static constexpr double kAnnouncementsPerHour = 36'000;
  /// An HTTP request, and what a list costs beyond one, in requests: lists have as many a second to themselves, so that
  /// they delay nothing else. Returns how long the answer must wait, up to max_wait_us.
  Result<TimeUs> take_request(double listing, TimeUs now_us, TimeUs max_wait_us);

 private:
  friend class Gate;
  struct Holder {
    std::shared_ptr<Account> account;
    bool is_token = false;
  };
  Grant(Gate& gate, Identity identity, const IpAddress& peer, std::shared_ptr<const AccessPolicy> policy,
        TimeUs now_us);
  struct Rate {
    const char* setting;
    RateLimiter Account::*limiter;
    std::int64_t Quota::*max;  ///< In a period.
    double period_s;
  };
  std::optional<TimeUs> take_loop_time(RateLimiter Account::*limiter, double us, TimeUs now_us, TimeUs max_wait_us);
  Result<TimeUs> take_rate(const Rate& rate, const Holder& holder, double amount, TimeUs now_us, TimeUs max_wait_us);
  Result<TimeUs> take_rate(const Rate& rate, double amount, TimeUs now_us, TimeUs max_wait_us = 0);
  /// How long until one more try to log in may fail: of its address, and of its site.
  TimeUs failure_wait_us(TimeUs now_us) const;
  void note_failure(TimeUs now_us);
  Error over(const Holder& holder, const char* limit, std::int64_t max) const;
  void count(Resource resource, std::int64_t amount);

  Gate& gate_;
  Identity identity_;
  bool spared_;
  std::shared_ptr<const AccessPolicy> policy_;  ///< The policy that admitted or last confirmed it.
  /// Not the account of holders_.back(), but that of an IPv6 site without a token.
  bool has_site() const { return site_ != holders_.back().account; }

  std::vector<Holder> holders_;
  std::shared_ptr<Account> site_;  ///< Whose share_of() what all need it takes, and whose time of event loops.
  std::array<std::int64_t, kResources> taken_{};
};
using GrantPtr = std::shared_ptr<Grant>;

/// Admission: applies the policy, counts usage and throttles failed logins. Thread-safe.
class Gate {
 public:
  explicit Gate(std::shared_ptr<const AccessPolicy> policy) : policy_(std::move(policy)) {}

  /// What admit() takes to check a signature that it has not met yet; 0: it need not.
  double check_us(const AccessRequest& request, std::int64_t now_unix_s) const;
  /// The holder of stranger() pays for check_us(), unless that `is_paid`, and is refused where it cannot.
  std::variant<GrantPtr, Denial> admit(const AccessRequest& request, TimeUs now_us, std::int64_t now_unix_s,
                                       bool is_paid = false);
  enum class AdminRequest { kRead, kControl };
  /// Nothing: admitted. Reading is free on loopback and for monitors, control on loopback if no tokens are configured;
  /// all else needs the right admin.
  std::optional<Denial> admit_admin(const AccessRequest& request, AdminRequest ask, TimeUs now_us,
                                    std::int64_t now_unix_s);
  /// Call before reading from a connection, while `open` others are open. 503: they are all that there may be; 429: its
  /// address has its share. A trusted proxy has none; its clients have, in Grant::take_place().
  std::variant<GrantPtr, Denial> accept(const IpAddress& peer, std::int64_t open, TimeUs now_us);
  /// Who pays for a request that was not admitted: the client's address, whatever proxy it came through, or the
  /// proxy's, where that names none. No rights.
  GrantPtr stranger(const AccessRequest& request, TimeUs now_us);

  /// Applies to new requests at once, to existing grants at their next is_void().
  void replace_policy(std::shared_ptr<const AccessPolicy> policy);
  std::shared_ptr<const AccessPolicy> policy() const;
  std::uint64_t denied() const { return denied_; }

 private:
  friend class Grant;
  GrantPtr nameless(const IpAddress& address, const IpAddress& peer, std::shared_ptr<const AccessPolicy> rules,
                    TimeUs now_us);

  mutable std::mutex policy_mutex_;
  std::shared_ptr<const AccessPolicy> policy_;  ///< GUARDED_BY(policy_mutex_)
  Ledger addresses_;
  Ledger tokens_;
  UseCount watched_streams_, unfinished_bytes_, wide_bytes_;
  std::atomic<std::uint64_t> denied_{0};
};

}  // namespace eigencast::broker
