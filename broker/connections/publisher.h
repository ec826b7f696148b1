// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "broker/connections/connection.h"
#include "broker/relay/stream.h"
#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// The connection of a sender: /v1/publish/{stream}. Belongs to its event loop.
class Publisher final : public Connection, public PublisherLink {
 public:
  Publisher(Context& context, Transport transport, GrantPtr grant, std::string stream_name);

  void on_watcher_count(std::uint32_t count) override;
  void on_replaced() override;
  bool yields() const override;
  void describe(ClientInfo& info) const override;

 private:
  void on_open() override;
  void on_message(const ControlMessage& message) override;
  void on_binary(ByteView message) override;
  double binary_work_us(std::uint64_t bytes, bool last) const override;
  void on_closed() override;
  void on_tick() override;
  std::string label() const override { return "sender of '" + name_ + "'"; }
  std::string stream_name() const override { return name_; }
  Result<void> claim(Stream& stream, bool replace);
  void on_announce(control::Announce announce);
  void on_remember(const control::Remember& memory);
  /// `epoch`: of the stream when it was asked for.
  void remember(std::uint32_t generation, std::uint32_t epoch, std::vector<Generation::Segment> segments,
                const Result<void>& loaded);
  void answer_memory(std::uint32_t generation, const Result<void>& held);
  /// REQUIRES: no stream yet. False: refused.
  bool claim_contested(const std::string& shown);
  /// What viewers are to fetch before the epoch begins that continues the present one.
  void prepare(control::Announce announce);
  void announce_prepared();
  void on_progress(const control::Progress& progress);
  void begin(const control::Announce& announce, const std::string& secret, const std::string& proof,
             const Result<std::uint32_t>& epoch);
  /// REQUIRES: stream_.
  bool is_announced() const { return stream_->snapshot().live; }
  void release();
  void report_count();
  void request_trace();

  std::string name_;
  Stream* stream_ = nullptr;  ///< Set while this is the stream's publisher.
  TimeUs claimed_us_ = 0;     ///< Since then.
  /// Until when it may show that the sender that is there is its own past; nothing: it was let in, or is refused.
  std::optional<TimeUs> contested_until_us_;
  std::uint32_t watchers_ = 0;
  std::optional<std::uint32_t> reported_;
  std::uint32_t requested_trace_ = 0;
  std::optional<control::Announce> preparing_;  ///< What viewers fetch the asset of now.
  TimeUs preparing_since_us_ = 0, progress_us_ = 0;
  std::uint32_t loading_ = 0;  ///< The epoch of the memory that is being read; 0: none.
};

}  // namespace eigencast::broker
