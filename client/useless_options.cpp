// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cassert>
#include <string_view>

#include "client/raw_options.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

enum Where : unsigned { kWindow = 1, kHeadless = 2, kFilm = 4, kList = 8 };
constexpr unsigned kLive = kWindow | kHeadless, kShown = kLive | kFilm, kAll = kShown | kList;
constexpr std::pair<Where, std::string_view> kWhereNames[] = {
    {kWindow, "the window"}, {kHeadless, "--headless"}, {kFilm, "--film"}, {kList, "list"}};
enum class Of { kAnything, kBrokers, kFiles };

/// Where options do something, whatever their values are.
struct Use {
  std::vector<std::string_view> options;
  unsigned where = 0;  ///< Of Where.
  Of of = Of::kAnything;
  std::string_view instead = {};
};

const std::vector<Use>& uses() {
  static const std::vector<Use> all{
      {{"--help", "--help-all", "--version", "--verbose", "--json"}, kAll},
      {{"--context", "--token", "--ca", "--cert", "--key", "--insecure"}, kAll, Of::kBrokers},
      {{"--scene", "--cache", "--size", "--view", "--camera-path", "--colour", "--colour-map", "--colour-range",
        "--normals", "--crease", "--edges", "--wireframe", "--points", "--transparent", "--ui-scale", "--lod",
        "--quality", "--reconstruct"},
       kShown},
      {{"--rate", "--scheme", "--k", "--bands", "--memory", "--ago", "--speed"}, kShown, Of::kBrokers},
      {{"--room", "--name", "--sync"}, kLive, Of::kBrokers},
      {{"--truth"}, kLive, Of::kBrokers, "files are their own"},
      {{"--compare", "--resolver", "--target-fps", "--lod-floor", "--playout", "--smooth", "--delay", "--ahead",
        "--record", "--record-shown"},
       kLive},
      {{"--frames", "--duration"}, kLive, Of::kAnything, "--seconds says how long a film is"},
      {{"--screenshot"}, kLive, Of::kAnything, "--film says where its own pictures go"},
      {{"--headless"}, kHeadless | kFilm},
      {{"--out"}, kHeadless, Of::kAnything, "--film says where its own pictures go, in the window --screenshot"},
      {{"--first"}, kHeadless},
      {{"--hud"}, kHeadless | kFilm, Of::kAnything, "in the window key F shows the figures"},
      {{"--wait"}, kHeadless | kFilm, Of::kBrokers},
      {{"--film", "--fps", "--seconds"}, kFilm},
      {{"--turntable"}, kWindow | kFilm},
      {{"--watch"}, kWindow, Of::kFiles, "a stream follows its sender, and without a window a file is read once"},
      {{"--settings"}, kWindow, Of::kAnything, "nothing else remembers"}};
  return all;
}

const Use* use_of(const std::string& option) {
  const auto names = [&](const Use& use) {
    return std::find(use.options.begin(), use.options.end(), option) != use.options.end();
  };
  const auto at = std::find_if(uses().begin(), uses().end(), names);
  return at == uses().end() ? nullptr : &*at;
}

/// "the window and --film"
std::string words_from(unsigned where) {
  std::string text;
  for (const auto& [bit, name] : kWhereNames) {
    if ((where & bit) == 0) continue;
    where &= ~unsigned{bit};
    text.append(text.empty() ? "" : where == 0 ? " and " : ", ").append(name);
  }
  return text;
}

bool is_tls(const std::string& stream) {
  const auto url = parse_broker_url(stream);
  return url && url->tls;
}

}  // namespace

Result<void> check_uses(const CommandLine& line, const RawOptions& raw, const ClientOptions& options) {
  const auto refused = [](const std::string& option, std::string_view why, std::string_view more) {
    return fail(ErrorCode::kInvalidArgument,
                option + " " + std::string(why) + (more.empty() ? "" : "; " + std::string(more)));
  };
  assert(std::ranges::all_of(line.names(), [](const std::string& name) { return use_of(name) != nullptr; }));
  const auto& streams = options.scene.streams;
  const std::size_t files = files_in(streams);
  const bool files_only = !streams.empty() && files == streams.size(), no_files = !streams.empty() && files == 0;
  const bool film = options.film.has_value();
  const bool headless = options.headless && !film;
  const Where here = options.list ? kList : film ? kFilm : headless ? kHeadless : kWindow;
  const std::vector<std::string> given = line.given();
  for (const std::string& option : given) {
    const Use* use = use_of(option);
    if (use == nullptr || (use->where & here) == 0)
      return refused(option, "is for " + words_from(use == nullptr ? 0 : use->where),
                     use == nullptr ? "" : use->instead);
    if (use->of == Of::kBrokers && files_only)
      return refused(option, "is for streams of brokers", use->instead.empty() ? "files are read here" : use->instead);
    if (use->of == Of::kFiles && no_files) return refused(option, "is for files", use->instead);
  }
  const bool numbers = shows_numbers(options.style.colour);
  const bool unwritten = headless && options.out.empty() && options.screenshot.empty();
  const bool plain = !is_tls(options.home.url) && !is_tls(options.compare) && std::ranges::none_of(streams, is_tls);
  const Style& style = options.style;
  const bool unknown_truth =
      options.truth.empty() && options.compare.empty() && (no_files || (streams.empty() && options.headless));
  const struct {
    std::vector<const char*> options;
    bool useless;
    const char* why;
  } cases[] = {
      {{"--ca", "--cert", "--key", "--insecure"}, plain, "is for https://; http:// has no certificates"},
      {{"--cert"}, !line.has("--key"), "goes with --key"},
      {{"--key"}, !line.has("--cert"), "goes with --cert"},
      {{"--first"}, options.frames == 0, "goes with --frames"},
      {{"--hud", "--transparent"}, unwritten, "is for pictures that are written: say --out or --screenshot"},
      {{"--edges"}, style.wireframe || style.points, "is overridden by --wireframe and --points"},
      {{"--wireframe"}, style.points, "and --points both say what is drawn; give one of them"},
      {{"--colour"},
       style.colour.colouring == Colouring::kError && unknown_truth,
       "error of a stream: say by --truth or --compare what it is compared with (a film has neither)"},
      {{"--speed"}, film && options.speed == 0, "shows one pose, and a film moves"},
      {{"--sync"}, options.ago_s > 0, "is for what is live; --ago is not"},
      {{"--speed"}, options.ago_s == 0, "goes with --ago; in the window keys [ and ] change it"},
      {{"--speed"}, options.speed != 0 && options.speed * limits::kMaxSpeed < 1, "is 0, or at least a tenth"},
      {{"--smooth", "--delay"},
       !options.sync.empty(),
       "says how long poses are held, which --sync leaves to the broker"},
      {{"--name"}, options.room.empty(), "goes with --room"},
      {{"--truth"}, !options.compare.empty(), "and --compare both say what colours compare with; give one of them"},
      {{"--transparent"},
       film && options.film->target.kind != FilmTarget::Kind::kPictures,
       "is for pictures: --film frame_%04d.png"},
      {{"--turntable"}, !options.camera_path.empty(), "is overridden by --camera-path"},
      {{"--ui-scale"},
       options.headless && !options.hud && options.room.empty(),
       "sizes texts, of which --headless has none without --hud"},
      {{"--target-fps", "--lod-floor"},
       options.headless && options.levels.kind == ResolverKind::kNone,
       "goes with --resolver budget or paper"},
      {{"--quality"},
       raw.quality == "auto" && options.levels.kind != ResolverKind::kBudget,
       "auto goes with --resolver budget"},
      {{"--colour-map", "--colour-range", "--truth"},
       options.headless && !numbers,
       "goes with --colour movement, speed, channel or error"},
      {{"--smooth", "--delay", "--ahead"},
       raw.playout == "latest",
       "is for --playout interpolate or estimate; latest holds nothing back"},
      {{"--ahead"}, raw.playout == "interpolate", "is for --playout estimate"},
      {{"--crease"}, raw.normals == "smooth" || raw.normals == "flat", "is for --normals authored or crease"},
      {{"--view"}, !options.camera_path.empty(), "is overridden by --camera-path"}};
  for (const auto& each : cases) {
    for (const char* option : each.options) {
      if (each.useless && std::ranges::find(given, option) != given.end()) return refused(option, each.why, "");
    }
  }
  return {};
}

}  // namespace eigencast
