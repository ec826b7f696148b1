// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "broker/access/ledger.h"
#include "broker/access/policy.h"
#include "common/core/clock.h"

namespace eigencast::broker {

class Gate;

/// What one connection may do, and what it uses; gives all of it back when it ends, before its Gate does. Calls of one
/// Grant come one at a time; different Grants are independent.
class Grant {
 public:
  ~Grant();
  Grant(const Grant&) = delete;
  Grant& operator=(const Grant&) = delete;

  const Identity& identity() const { return identity_; }
  /// For logs: who and from where.
  std::string label() const;
  /// Errors: kRefused, with which right is missing and how to get it.
  Result<void> may_publish(std::string_view stream) const;
  Result<void> may_subscribe(std::string_view stream) const;
  Result<void> may_store_assets() const;
  Result<void> may_fetch_assets() const;
  /// Whether the list of streams shows it.
  bool may_see(std::string_view stream) const;
  Result<void> may_administer() const;
  /// Whether the token has run out, where the configuration asks for that to end connections.
  bool has_expired(std::int64_t now_unix_s) const;
  /// Whether a reload took away what let it in.
  bool is_void();

  /// Errors: kRefused: a limit of the address or the token is reached; the message names it.
  Result<void> take(Share share);
  void give_back(Share share);
  /// One message that came.
  Result<void> take_message(TimeUs now_us);
  Result<void> take_upload(std::uint64_t bytes, TimeUs now_us);
  Result<void> take_download(std::uint64_t bytes, TimeUs now_us);

 private:
  friend class Gate;
  /// One of those whose limits the connection counts towards.
  struct Holder {
    std::shared_ptr<Account> account;
    bool is_token = false;
  };
  Grant(Gate& gate, Identity identity, std::shared_ptr<const AccessPolicy> policy, TimeUs now_us);
  Result<void> take_bytes(Pace Account::*pace, const char* limit, std::uint64_t bytes, TimeUs now_us);
  Error over(const Holder& holder, const char* limit, std::int64_t most) const;

  Gate& gate_;
  Identity identity_;
  std::shared_ptr<const AccessPolicy> policy_;  ///< By which it was let in, or that confirmed it last (is_void()).
  std::vector<Holder> holders_;
  std::array<std::int64_t, kShares> taken_{};
};
using GrantPtr = std::shared_ptr<Grant>;

/// The door: asks the policy, counts, and slows down who guesses. Thread-safe.
class Gate {
 public:
  explicit Gate(std::shared_ptr<const AccessPolicy> policy) : policy_(std::move(policy)) {}

  std::variant<GrantPtr, Denial> admit(const AccessRequest& request, TimeUs now_us, std::int64_t now_unix_s);
  /// What is asked of the admin port: its state, or to change something.
  enum class AdminAsk { kRead, kControl };
  /// Nothing: go on. On loopback without any tokens configured everybody may, to read in any case, as may monitors;
  /// else it takes the right admin.
  std::optional<Denial> admit_admin(const AccessRequest& request, AdminAsk ask, TimeUs now_us, std::int64_t now_unix_s);
  /// Before anything was read from it. Null: its address has too many connections. A trusted proxy's are not counted:
  /// those of whom it forwards are, at admit().
  GrantPtr accept(const IpAddress& peer, TimeUs now_us);

  /// Counts at once for who comes, and for who is here from their next is_void() on.
  void replace_policy(std::shared_ptr<const AccessPolicy> policy);
  std::shared_ptr<const AccessPolicy> policy() const;
  std::uint64_t denied() const { return denied_; }

 private:
  friend class Grant;
  std::optional<Denial> slowed(const AccessPolicy& rules, const std::string& address, TimeUs now_us);
  void count_failure(const AccessPolicy& rules, const std::string& address, TimeUs now_us);

  mutable std::mutex policy_mutex_;
  std::shared_ptr<const AccessPolicy> policy_;  ///< GUARDED_BY(policy_mutex_)
  Ledger addresses_;
  Ledger tokens_;
  std::atomic<std::uint64_t> denied_{0};
};

}  // namespace eigencast::broker
