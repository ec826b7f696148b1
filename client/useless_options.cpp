// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "client/raw_options.h"
#include "common/wire/limits.h"

namespace eigencast {

Result<void> check_uses(const CommandLine& line, const RawOptions& raw, const ClientOptions& options) {
  const std::size_t streams = options.scene.streams.size(), files = files_in(options.scene.streams);
  const bool files_only = streams > 0 && files == streams, no_files = streams > 0 && files == 0;
  const bool numbers = shows_numbers(options.style.colour);
  const bool endless = options.frames == 0, film = options.film.has_value();
  constexpr const char* kOfBrokers = "is for streams of brokers; files are read here";
  const struct {
    std::vector<const char*> options;
    bool useless;
    const char* why;
  } uses[] = {
      {{"--watch"}, options.headless, "is for the window; headless a file is read once"},
      {{"--watch"}, no_files, "is for files; a stream follows its sender anyway"},
      {{"--settings"}, options.headless, "is what the window remembers; --headless remembers nothing"},
      {{"--out"}, !options.headless, "is for --headless; in the window use --screenshot or key S"},
      {{"--hud", "--wait", "--first"}, !options.headless, "is for --headless"},
      {{"--first"}, endless, "goes with --frames"},
      {{"--fps", "--seconds"}, !film, "goes with --film"},
      {{"--frames", "--duration"}, film, "is for live pictures; --seconds says how long a film is"},
      {{"--out", "--screenshot"}, film, "is for live pictures; --film says where its own go"},
      {{"--resolver", "--target-fps", "--playout"}, film, "is for live pictures; a film takes the time that it takes"},
      {{"--record", "--record-shown", "--room"}, film, "is for live pictures"},
      {{"--room", "--sync", "--ago"}, files_only, kOfBrokers},
      {{"--sync"}, film, "is for live pictures"},
      {{"--speed"}, film && options.speed == 0, "shows one pose, and a film moves"},
      {{"--sync"}, options.ago_s > 0, "is for what is live; --ago is not"},
      {{"--speed"}, options.ago_s == 0, "goes with --ago; in the window keys [ and ] change it"},
      {{"--speed"}, options.speed != 0 && options.speed * limits::kMaxSpeed < 1, "is 0, or at least a tenth"},
      {{"--smooth", "--delay"},
       !options.sync.empty(),
       "says how long poses are held, which --sync leaves to the broker"},
      {{"--name"}, options.room.empty() && std::getenv("EIGENCAST_NAME") == nullptr, "goes with --room"},
      {{"--truth"}, film, "is for live pictures; a file that is filmed is its own"},
      {{"--compare"}, film, "is for live pictures"},
      {{"--truth"}, !options.compare.empty(), "and --compare both say what colours compare with; give one of them"},
      {{"--wait"}, film && files_only, kOfBrokers},
      {{"--transparent"},
       film && options.film->target.kind != FilmTarget::Kind::kPictures,
       "is for pictures: --film frame_%04d.png"},
      {{"--turntable"}, options.headless && !film, "is for the window and --film"},
      {{"--turntable"}, !options.camera_path.empty(), "is overridden by --camera-path"},
      {{"--ui-scale"}, options.headless && !options.hud, "sizes texts, of which --headless has none without --hud"},
      {{"--target-fps", "--lod-floor"},
       options.headless && options.levels.kind == ResolverKind::kNone,
       "goes with --resolver budget or paper"},
      {{"--quality"},
       raw.quality == "auto" && options.levels.kind != ResolverKind::kBudget,
       "auto goes with --resolver budget"},
      {{"--colour-map", "--colour-range", "--truth"},
       options.headless && !numbers,
       "goes with --colour movement, speed, channel or error"},
      {{"--rate", "--scheme", "--k", "--bands", "--ca", "--cert", "--key", "--insecure", "--memory"},
       files_only,
       kOfBrokers},
      {{"--context"}, files_only && std::getenv("EIGENCAST_CONTEXT") == nullptr, kOfBrokers},
      {{"--token"}, files_only && std::getenv("EIGENCAST_TOKEN") == nullptr, kOfBrokers},
      {{"--smooth", "--delay", "--ahead"},
       raw.playout == "latest",
       "is for --playout interpolate or estimate; latest holds nothing back"},
      {{"--ahead"}, raw.playout == "interpolate", "is for --playout estimate"},
      {{"--crease"}, raw.normals == "smooth" || raw.normals == "flat", "is for --normals authored or crease"},
      {{"--view"}, !options.camera_path.empty(), "is overridden by --camera-path"},
      {{"--scene", "--headless", "--film", "--frames", "--out", "--lod", "--colour"},
       options.list,
       "does nothing for list"}};
  for (const auto& use : uses) {
    for (const char* option : use.options) {
      if (use.useless && line.has(option))
        return fail(ErrorCode::kInvalidArgument, std::string(option) + " " + use.why);
    }
  }
  return {};
}

}  // namespace eigencast
