// SPDX-License-Identifier: MIT
#include "client/open_source.h"

#include <algorithm>
#include <filesystem>

#include "client/clip_source.h"
#include "client/clip_truth.h"
#include "client/compared_source.h"
#include "sdk/contexts.h"

namespace eigencast {
namespace {

Result<std::unique_ptr<PoseSource>> subscribe(const std::string& stream, const Credentials* credentials,
                                              const ClientOptions& options, const LogSink& log) {
  SubscriberOptions wanted;
  wanted.url = stream;
  wanted.profile = options.profile;
  wanted.cache_dir = options.cache_dir;
  wanted.sync = options.sync;
  if (credentials != nullptr) {
    wanted.credentials = *credentials;
    return subscribe_to(std::move(wanted), log);
  }
  const auto contexts = Contexts::load(Contexts::default_path());
  if (!contexts) return contexts.error();
  const Credentials given = credentials_for(stream, options.scene.streams, options.credentials);
  auto target = resolve_target(stream, given, "", *contexts);
  if (!target) return target.error();
  wanted.url = target->url;
  wanted.credentials = target->credentials;
  return subscribe_to(std::move(wanted), log);
}

}  // namespace

Wanted wanted_from(const std::string& text) {
  constexpr const char* kAround = " \t\r\n\"'";
  const std::size_t first = text.find_first_not_of(kAround);
  if (first == std::string::npos) return {};
  const std::string what = text.substr(first, text.find_last_not_of(kAround) - first + 1);
  if (clip_in(what)) return {Wanted::Kind::kClip, what};
  // Unknown schemes, too: opening them names the known ones.
  if (what.find("://") != std::string::npos) return {Wanted::Kind::kStream, what};
  std::error_code ignored;
  if (what.ends_with(".json") && std::filesystem::is_regular_file(what, ignored)) return {Wanted::Kind::kScene, what};
  return {Wanted::Kind::kClip, "file:" + what};
}

Wanted wanted_from_word(const std::string& word) {
  const Wanted wanted = wanted_from(word);
  const std::optional<std::string> input = clip_in(wanted.what);
  std::error_code ignored;
  const bool is_path = wanted.kind != Wanted::Kind::kClip || input == clip_in(word) ||
                       input->find('*') != std::string::npos || std::filesystem::exists(*input, ignored);
  return is_path ? wanted : Wanted{Wanted::Kind::kStream, word};
}

Credentials credentials_for(const std::string& stream, std::span<const std::string> streams,
                            std::span<const Credentials> credentials) {
  const auto wanted = parse_broker_url(stream);
  for (std::size_t i = 0; wanted && i < std::min(streams.size(), credentials.size()); ++i) {
    const auto known = parse_broker_url(streams[i]);
    if (clip_in(streams[i]) || !known || known->origin() != wanted->origin()) continue;
    Credentials given = credentials[i];
    if (!wanted->credentials.token.empty()) given.token.clear();
    return given;
  }
  return {};
}

Result<std::unique_ptr<PoseSource>> open_source(const std::string& stream, const Credentials* credentials,
                                                const ClientOptions& options, bool in_background,
                                                const std::atomic<bool>& stop, const LogSink& log) {
  if (!options.compare.empty()) {
    ClientOptions alone = options;
    alone.compare.clear();
    auto other = open_source(options.compare, &options.compare_credentials, alone, in_background, stop, log);
    if (!other) return other;
    auto source = open_source(stream, credentials, alone, in_background, stop, log);
    return source ? compared(std::move(*source), std::move(*other)) : std::move(source);
  }
  const std::optional<std::string> input = clip_in(stream);
  if (!input) {
    auto source = subscribe(stream, credentials, options, log);
    return source && !options.truth.empty() ? with_truth(std::move(*source), options.truth) : std::move(source);
  }
  eigencast::log(log, LogLevel::kInfo, *input + ": baking, or looking it up");
  if (in_background)
    return std::unique_ptr<PoseSource>(std::make_unique<OpeningClip>(*input, options.cache_dir, options.watch, log));
  const auto clip = BakedClip::open(
      *input, options.cache_dir, [&stop](double, std::string_view) { return !stop.load(); }, log);
  if (!clip) return clip.error();
  return std::unique_ptr<PoseSource>(std::make_unique<ClipSource>(*clip));
}

}  // namespace eigencast
