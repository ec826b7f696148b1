// SPDX-License-Identifier: MIT
#include "broker/backbone/member.h"

#include <unistd.h>

#include <boost/asio/post.hpp>
#include <cctype>
#include <chrono>
#include <ctime>
#include <fstream>
#include <utility>

#include "broker/backbone/nats_link.h"

namespace eigencast::broker {
namespace {

/// Period of reconciliation without events.
constexpr auto kTick = std::chrono::milliseconds(25);

/// The setting, or the host's name as far as it fits.
std::string name_of(const Config& config) {
  if (!config.backbone.name.empty()) return config.backbone.name;
  char host[33] = {};
  (void)::gethostname(host, sizeof host - 1);
  for (char& c : host) {
    if (c != 0 && std::isalnum(static_cast<unsigned char>(c)) == 0) c = '-';
  }
  return *host != 0 ? host : "broker";
}

}  // namespace

Result<void> Member::check(const Config& config) {
  if (config.backbone.servers.empty()) return {};
  // libnats reads this file only when it connects, and reports its absence like an unreachable server.
  const std::string credentials = resolved_path(config.backbone.credentials);
  if (!credentials.empty() && !std::ifstream(credentials)) {
    return fail(ErrorCode::kInvalidArgument, "backbone.credentials: cannot read " + credentials);
  }
  auto link = make_nats_link(config, "check", [](const std::function<void()>&) {});
  return link ? Result<void>() : Result<void>(link.error());
}

Result<std::unique_ptr<Member>> Member::create(const Config& config, const std::string& run, AssetStore& assets,
                                               LogSink log) {
  const std::string id = name_of(config) + "." + run;
  std::unique_ptr<Member> member(new Member);
  Member* self = member.get();
  const auto on_loop = [self](std::function<void()> work) { boost::asio::post(self->host_->loop, std::move(work)); };
  const auto on_disk = [self](std::function<void()> work) { boost::asio::post(self->host_->disk, std::move(work)); };
  if (const auto good = store(member->link_, make_nats_link(config, id, on_loop)); !good) return good.error();
  member->exchange_ = std::make_unique<AssetExchange>(*member->link_, assets, config.backbone.prefix, on_disk, on_loop);
  const auto next_epoch = [self](std::uint32_t above) {
    return self->host_->epochs.next(static_cast<std::uint64_t>(std::time(nullptr)), above);
  };
  const auto note_epoch = [self](std::uint32_t seen) {
    self->host_->epochs.note(static_cast<std::uint64_t>(std::time(nullptr)), seen);
  };
  Backbone::Environment around{steady_now_us,
                               next_epoch,
                               note_epoch,
                               [self] { return self->host_->replaces(); },
                               [self] { return self->host_->remembers(); },
                               [self](const std::string& holder, FairReads::Read read) {
                                 return self->host_->memory_reads.push(holder, std::move(read));
                               },
                               [self] { self->host_->frames_came(); },
                               std::move(log)};
  Backbone::Settings settings{.id = id, .prefix = config.backbone.prefix};
  member->backbone_ =
      std::make_unique<Backbone>(std::move(settings), *member->link_, *member->exchange_, std::move(around));
  return member;
}

void Member::start(const Host& host) {
  host_.emplace(host);
  timer_.emplace(host.loop);
  backbone_->start(host.hub);
  tick();
}

void Member::tick() {
  timer_->expires_after(kTick);
  timer_->async_wait([this](boost::system::error_code error) {
    if (error || !timer_) return;  // It may have expired before stop().
    backbone_->tick();
    tick();
  });
}

void Member::stop() {
  timer_.reset();  // Its loop ends before this object.
  backbone_->stop();
}

}  // namespace eigencast::broker
