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
#include "broker/config/config.h"
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
    Ledger* ledger = nullptr;
    std::shared_ptr<Account> account;
    bool is_token = false;
  };
  Grant(Gate& gate, Identity identity, std::shared_ptr<const AccessPolicy> policy, TimeUs now_us);
  Result<void> take_bytes(Pace Account::*pace, const char* limit, std::uint64_t bytes, TimeUs now_us);
  Error over(const Holder& holder, const char* limit, std::int64_t most) const;

  Gate& gate_;
  Identity identity_;
  std::shared_ptr<const AccessPolicy> policy_;  ///< By which it was let in, or that confirmed it last.
  std::vector<Holder> holders_;
  std::array<std::int64_t, kShares> taken_{};
};
using GrantPtr = std::shared_ptr<Grant>;

/// The door: asks the policy, counts, and slows down who guesses. Thread-safe.
class Gate {
 public:
  /// `config` is read at each use, so that reloaded limits count at once.
  Gate(const Config& config, std::shared_ptr<const AccessPolicy> policy)
      : config_(config), policy_(std::move(policy)) {}

  std::variant<GrantPtr, Denial> admit(const AccessRequest& request, TimeUs now_us, std::int64_t now_unix_s);
  /// What is asked of the admin port: its state, or to change something.
  enum class AdminAsk { kRead, kControl };
  /// Nothing: go on. On loopback without any tokens configured everybody may, to read in any case, as may monitors; else
  /// it takes the right admin.
  std::optional<Denial> admit_admin(const AccessRequest& request, AdminAsk ask, TimeUs now_us, std::int64_t now_unix_s);
  /// Before anything was read from it. Null: its address has too many connections. A trusted proxy's are not counted:
  /// those of whom it forwards are, at admit().
  GrantPtr accept(const IpAddress& peer, TimeUs now_us);

  void replace_policy(std::shared_ptr<const AccessPolicy> policy);
  std::shared_ptr<const AccessPolicy> policy() const;
  std::uint64_t denied() const { return denied_; }

 private:
  friend class Grant;
  struct Quota {
    std::array<std::int64_t, kShares> shares{};
    std::int64_t messages_per_s = 0;
    std::int64_t upload_bytes_per_hour = 0;
    std::int64_t download_bytes_per_hour = 0;
  };
  Quota quota(bool of_token) const;
  std::optional<Denial> slowed(const std::string& address, TimeUs now_us);
  void count_failure(const std::string& address, TimeUs now_us);

  const Config& config_;
  mutable std::mutex policy_mutex_;
  std::shared_ptr<const AccessPolicy> policy_;  ///< GUARDED_BY(policy_mutex_)
  Ledger addresses_;
  Ledger tokens_;
  std::atomic<std::uint64_t> denied_{0};
};

}  // namespace eigencast::broker
