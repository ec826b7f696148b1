// SPDX-License-Identifier: MIT
#include "broker/backbone/member.h"

#include <boost/asio/post.hpp>
#include <chrono>
#include <ctime>
#include <fstream>
#include <utility>

#include "broker/config/places.h"

namespace eigencast::broker {
namespace {

/// How soon what should be follows from what is, where nothing that happens says so.
constexpr auto kTick = std::chrono::milliseconds(25);

NatsLink::Settings link_settings(const Config& config, const std::string& id) {
  const auto& from = config.backbone;
  NatsLink::Settings settings;
  settings.servers = from.servers;
  settings.name = "eigencast-broker " + id;
  settings.prefix = from.prefix;
  settings.replicas = static_cast<int>(from.replicas);
  settings.ca_file = located(from.ca);
  settings.certificate_file = located(from.certificate);
  settings.key_file = located(from.key);
  settings.credentials_file = located(from.credentials);
  settings.user = from.user;
  settings.password = from.password;
  settings.token = from.token;
  return settings;
}

}  // namespace

Result<void> Member::check(const Config& config) {
  if (config.backbone.servers.empty()) return {};
  const auto settings = link_settings(config, "check");
  // libnats reads this one only when it connects, where its absence looks like a server that is away.
  if (!settings.credentials_file.empty() && !std::ifstream(settings.credentials_file)) {
    return fail(ErrorCode::kInvalidArgument, "backbone.credentials: cannot read " + settings.credentials_file);
  }
  auto link = NatsLink::create(settings, [](const std::function<void()>&) {});
  return link ? Result<void>() : Result<void>(link.error());
}

Result<std::unique_ptr<Member>> Member::create(const Config& config, const std::string& id, AssetStore& assets,
                                               LogSink log) {
  std::unique_ptr<Member> member(new Member);
  Member* self = member.get();
  const auto on_loop = [self](std::function<void()> work) { boost::asio::post(self->place_->loop, std::move(work)); };
  const auto on_disk = [self](std::function<void()> work) { boost::asio::post(self->place_->disk, std::move(work)); };
  auto link = NatsLink::create(link_settings(config, id), on_loop);
  if (!link) return link.error();
  member->link_ = std::move(*link);
  member->exchange_ = std::make_unique<AssetExchange>(*member->link_, assets, config.backbone.prefix, on_disk, on_loop);
  Backbone::Settings settings;
  settings.id = id;
  settings.prefix = config.backbone.prefix;
  Backbone::Surroundings around;
  around.now_us = [] { return steady_now_us(); };
  around.next_epoch = [self](std::uint32_t above) {
    return self->place_->epochs.next(static_cast<std::uint64_t>(std::time(nullptr)), above);
  };
  around.replaces = [self] { return self->place_->replaces(); };
  around.frames_came = [self] { self->place_->frames_came(); };
  around.log = std::move(log);
  member->backbone_ = std::make_unique<Backbone>(settings, *member->link_, *member->exchange_, around);
  return member;
}

void Member::start(const Place& place) {
  place_.emplace(place);
  timer_.emplace(place.loop);
  backbone_->start(place.hub);
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
