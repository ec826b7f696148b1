// SPDX-License-Identifier: MIT
#include "broker/backbone/member.h"

#include <boost/asio/post.hpp>
#include <chrono>
#include <ctime>
#include <fstream>
#include <utility>

namespace eigencast::broker {
namespace {

/// Period of reconciliation without events.
constexpr auto kTick = std::chrono::milliseconds(25);

NatsSettings link_settings(const Config& config, const std::string& id) {
  const auto& from = config.backbone;
  NatsSettings settings;
  settings.servers = from.servers;
  settings.name = "eigencast-broker " + id;
  settings.prefix = from.prefix;
  settings.replicas = static_cast<int>(from.replicas);
  settings.ca_file = resolved_path(from.ca);
  settings.certificate_file = resolved_path(from.certificate);
  settings.key_file = resolved_path(from.key);
  settings.credentials_file = resolved_path(from.credentials);
  settings.user = from.user;
  settings.password = from.password;
  settings.token = from.token;
  return settings;
}

}  // namespace

Result<void> Member::check(const Config& config) {
  if (config.backbone.servers.empty()) return {};
  const auto settings = link_settings(config, "check");
  // libnats reads this file only when it connects, and reports its absence like an unreachable server.
  if (!settings.credentials_file.empty() && !std::ifstream(settings.credentials_file)) {
    return fail(ErrorCode::kInvalidArgument, "backbone.credentials: cannot read " + settings.credentials_file);
  }
  auto link = make_nats_link(settings, [](const std::function<void()>&) {});
  return link ? Result<void>() : Result<void>(link.error());
}

Result<std::unique_ptr<Member>> Member::create(const Config& config, const std::string& id, AssetStore& assets,
                                               LogSink log) {
  std::unique_ptr<Member> member(new Member);
  Member* self = member.get();
  const auto on_loop = [self](std::function<void()> work) { boost::asio::post(self->host_->loop, std::move(work)); };
  const auto on_disk = [self](std::function<void()> work) { boost::asio::post(self->host_->disk, std::move(work)); };
  auto link = make_nats_link(link_settings(config, id), on_loop);
  if (!link) return link.error();
  member->link_ = std::move(*link);
  member->exchange_ = std::make_unique<AssetExchange>(*member->link_, assets, config.backbone.prefix, on_disk, on_loop);
  Backbone::Settings settings;
  settings.id = id;
  settings.prefix = config.backbone.prefix;
  Backbone::Environment around;
  around.now_us = [] { return steady_now_us(); };
  around.next_epoch = [self](std::uint32_t above) {
    return self->host_->epochs.next(static_cast<std::uint64_t>(std::time(nullptr)), above);
  };
  around.replaces = [self] { return self->host_->replaces(); };
  around.frames_came = [self] { self->host_->frames_came(); };
  around.log = std::move(log);
  member->backbone_ = std::make_unique<Backbone>(settings, *member->link_, *member->exchange_, around);
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
    if (error) return;
    backbone_->tick();
    tick();
  });
}

void Member::stop() {
  if (timer_) timer_->cancel();
  backbone_->stop();
}

}  // namespace eigencast::broker
