// SPDX-License-Identifier: MIT
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <variant>

#include "common/core/text.h"
#include "sdk/asset_cache.h"
#include "sdk/asset_folder.h"
#include "sdk/recorded_stream.h"
#include "sender/commands.h"
#include "sender/cut.h"
#include "sender/live.h"

namespace eigencast {
namespace {

std::string utc(std::uint64_t unix_us) {
  const auto seconds = static_cast<std::time_t>(unix_us / 1'000'000);
  std::tm parts{};
  char text[32];
  if (gmtime_r(&seconds, &parts) == nullptr || std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts) == 0)
    return "";
  return text;
}

/// From the recording, or the cache.
Result<WholeAsset> surface_of(RecordedStream& stream, const control::Announce& announce) {
  const AssetCache cache(default_cache_dir());
  return assemble_asset(*Sha256::from_hex(announce.asset), [&](const Sha256& id) -> Result<Bytes> {
    auto held = stream.object(id);
    if (held || held.error().code != ErrorCode::kNotFound) return held;
    if (auto cached = cache.load(id)) return *std::move(cached);
    return held;
  });
}

/// The first pose in the second half.
Result<void> draw(const std::string& file, const std::string& to) {
  auto stream = RecordedStream::open(file);
  if (!stream) return stream.error();
  const TimeUs middle_us = stream->info().duration_us / 2;
  if (const auto sought = stream->seek(middle_us); !sought) return sought;
  std::optional<control::Announce> announce;
  for (;;) {
    const auto event = stream->next();
    if (!event) return event.error();
    if (!*event) return fail(ErrorCode::kCorrupt, file + ": the recording has no poses there");
    if (const auto* said = std::get_if<control::Announce>(&(**event).what)) announce = *said;
    const auto* pose = std::get_if<RecordedPose>(&(**event).what);
    if (pose == nullptr || (**event).time_us < middle_us || !announce) continue;
    const auto whole = surface_of(*stream, *announce);
    if (!whole) return in_context(file, whole.error());
    const std::vector<double> all = stream->coefficients(pose->key);
    const std::size_t channels = stream->layout().channels;
    std::vector<double> C;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (i % channels < 3) C.push_back(all[i]);
    }
    return write_thumbnail(whole->asset, C, to);
  }
}

/// Of a surface, as far as it is here.
nlohmann::json facts_of(RecordedStream& stream, const control::Announce& announce) {
  nlohmann::json facts{{"asset", announce.asset},
                       {"rank", announce.format.rows},
                       {"codec", announce.format.codec},
                       {"key_rate_hz", announce.key_rate_hz},
                       {"scalars", nlohmann::json::array()}};
  for (const ScalarChannel& scalar : announce.format.scalars)
    facts["scalars"].push_back({{"name", scalar.name}, {"unit", scalar.unit}});
  const auto whole = surface_of(stream, announce);
  facts["is_held"] = static_cast<bool>(stream.object(*Sha256::from_hex(announce.asset)));
  if (!whole) return facts;
  facts["name"] = whole->asset.name;
  facts["vertices"] = whole->asset.vertex_count;
  facts["faces"] = whole->asset.face_total;
  return facts;
}

Result<nlohmann::json> facts_of(const std::string& file) {
  auto stream = RecordedStream::open(file);
  if (!stream) return stream.error();
  const recording::Info info = stream->info();
  nlohmann::json surfaces = nlohmann::json::array();
  std::set<std::string> seen;
  std::uint64_t poses = 0;
  std::size_t announcements = 0, remembered = 0;
  for (;;) {
    const auto event = stream->next();
    if (!event) return in_context(file, event.error());
    if (!*event) break;
    poses += std::holds_alternative<RecordedPose>((**event).what) ? 1 : 0;
    if (const auto* memory = std::get_if<RecordedStream::Memory>(&(**event).what))
      remembered = std::max(remembered, memory->size());
    const auto* announce = std::get_if<control::Announce>(&(**event).what);
    if (announce == nullptr) continue;
    ++announcements;
    if (seen.insert(announce->asset).second) surfaces.push_back(facts_of(*stream, *announce));
  }
  const double seconds = 1e-6 * static_cast<double>(info.duration_us);
  std::error_code ignored;
  const auto bytes = std::filesystem::file_size(file, ignored);
  return nlohmann::json{{"file", file},
                        {"stream", info.start.stream},
                        {"started", utc(info.start.started_unix_us)},
                        {"software", info.start.software},
                        {"duration_s", seconds},
                        {"poses", poses},
                        {"frames", info.frames},
                        {"dropped", info.dropped},
                        {"complete", info.complete},
                        {"torn_bytes", info.torn_bytes},
                        {"bytes", bytes},
                        {"announcements", announcements},
                        {"segments_remembered", remembered},
                        {"surfaces", surfaces}};
}

void print(const nlohmann::json& facts) {
  const auto number = [&](const char* name) { return facts[name].get<double>(); };
  std::string text = facts["file"].get<std::string>() + "\n";
  text +=
      "  stream    " + escaped(facts["stream"].get<std::string>()) + ", " + facts["started"].get<std::string>() + "\n";
  text += formatted("  length    %.1f s, %.0f poses, %.0f dropped%s\n", number("duration_s"), number("poses"),
                    number("dropped"), facts["complete"].get<bool>() ? "" : "; it was cut off");
  text += formatted("  size      %.0f bytes\n", number("bytes"));
  for (const nlohmann::json& surface : facts["surfaces"]) {
    text += "  surface   " + escaped(surface.value("name", surface["asset"].get<std::string>().substr(0, 12)));
    if (surface.contains("vertices"))
      text +=
          formatted(", %u vertices, %u faces", surface["vertices"].get<unsigned>(), surface["faces"].get<unsigned>());
    text += formatted(", %u coefficients, %g keys/s; %s\n", surface["rank"].get<unsigned>(),
                      surface["key_rate_hz"].get<double>(),
                      surface["is_held"].get<bool>() ? "held in the file" : "not held in the file");
  }
  std::fputs(text.c_str(), stdout);
}

}  // namespace

int run(const InfoCommand& command, const Console&, Interrupt&) {
  const auto facts = facts_of(command.file);
  if (!facts) return report_failure(facts.error());
  if (!command.thumbnail.empty()) {
    if (const auto drawn = draw(command.file, command.thumbnail); !drawn) return report_failure(drawn.error());
  }
  if (command.json.empty()) print(*facts);
  return end_with_report(command.json, facts->dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
}

int run(const CutCommand& command, const Console&, Interrupt&) {
  const auto cut = cut_recordings(command.files, command.from_s, command.duration_s, command.rate_hz, command.to);
  if (!cut) return report_failure(cut.error());
  const double seconds = 1e-6 * static_cast<double>(cut->duration_us);
  std::puts(formatted("%s: %.1f s, %llu frames, %llu bytes", command.to.c_str(), seconds,
                      static_cast<unsigned long long>(cut->frames), static_cast<unsigned long long>(cut->bytes))
                .c_str());
  return kExitOk;
}

}  // namespace eigencast
