// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/net/url.h"
#include "common/wire/control.h"

namespace eigencast {

inline constexpr TimeUs kPingIntervalUs = 250'000;

/// "; next try in 400 ms", "; next try in 3.9 s", or nothing when there is none.
inline std::string try_again_in(std::chrono::milliseconds wait) {
  if (wait.count() <= 0) return {};
  const auto tenths = (wait.count() + 50) / 100;
  if (wait.count() < 1000) return "; next try in " + std::to_string(wait.count()) + " ms";
  return "; next try in " + std::to_string(tenths / 10) + (tenths < 100 ? "." + std::to_string(tenths % 10) : "") +
         " s";
}

/// Says each trouble of a connection once, then counts: the 10th try in a row that fails, the 100th, ... Not
/// thread-safe.
class RetryLog {
 public:
  /// The line to log of a try that failed; empty: none.
  std::string failed(const std::string& why) {
    constexpr std::size_t kMaxKnown = 16;
    if (++tries_ == next_count_) {
      next_count_ *= 10;
      return why + " (try " + std::to_string(tries_) + ")";
    }
    if (std::find(known_.begin(), known_.end(), why) != known_.end()) return {};
    if (known_.size() < kMaxKnown) known_.push_back(why);
    return why;
  }
  /// Likewise of one that succeeded.
  std::string succeeded() {
    const std::uint64_t tries = std::exchange(*this, {}).tries_;
    return tries > 1 ? "connected after " + std::to_string(tries) + " tries in vain" : std::string();
  }

 private:
  std::uint64_t tries_ = 0, next_count_ = 10;
  std::vector<std::string> known_;
};

/// Nothing: its kind is unknown here, which newer brokers may send, or it is malformed, which is logged.
inline std::optional<ControlMessage> read_control(std::string_view text, const LogSink& log) {
  auto message = control_from_text(text);
  if (message) return std::move(*message);
  if (message.error().code != ErrorCode::kUnsupported)
    eigencast::log(log, LogLevel::kWarning, "from the broker: " + message.error().message);
  return std::nullopt;
}

/// Where to, with its credentials. Errors: kInvalidArgument (URL, stream name, credentials).
inline Result<BrokerUrl> stream_url(const std::string& given, const Credentials& credentials, const LogSink& log) {
  auto url = parse_broker_url(given);
  if (!url) return url;
  if (const auto good = complete_credentials(*url, credentials, log); !good) return good.error();
  if (auto name = check_stream_name(url->stream); !name)
    return in_context("stream name in \"" + url->shown() + "\"", name.error());
  return url;
}

/// The same where a proxy has a path in front, as the URL itself says when asked by HTTP (docs/protocol.md, section 9):
/// for a stream that was refused. Blocks while the first broker is silent, 500 ms a step at most, and for the lookup of
/// its name. What answers can only choose a part of the URL's own path. Nothing: nobody there says so.
std::optional<BrokerUrl> located(const BrokerUrl& url);

/// What the streams of one broker with the same credentials share, as long as one uses it. Thread-safe.
template <typename Shared>
class SharedByBroker {
 public:
  /// The first that `accepts`, or a new one, made from the URL, that must accept.
  template <typename Accepts>
  std::shared_ptr<Shared> get(const BrokerUrl& url, const Accepts& accepts) {
    const std::lock_guard lock(mutex_);
    known_.remove_if([](const Known& known) { return known.shared.expired(); });
    for (const Known& known : known_) {
      if (!is_same_broker(known.url, url)) continue;
      if (auto shared = known.shared.lock(); shared && accepts(*shared)) return shared;
    }
    auto made = std::make_shared<Shared>(url);
    accepts(*made);
    known_.push_back({url, made});
    return made;
  }

 private:
  struct Known {
    BrokerUrl url;
    std::weak_ptr<Shared> shared;
  };
  std::mutex mutex_;
  std::list<Known> known_;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast
