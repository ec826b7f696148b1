// SPDX-License-Identifier: MIT
#include "client/options.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <span>
#include <string_view>
#include <utility>

#include "client/clip_source.h"
#include "client/hud_text.h"
#include "client/raw_options.h"
#include "client/settings.h"
#include "common/core/files.h"
#include "common/wire/limits.h"
#include "sdk/asset_cache.h"

namespace eigencast {
namespace {

constexpr const char* kExamples =
    R"(eigencast-client                                        # this machine's one live stream, or what to choose from
eigencast-client horse.obj                              # a file, a folder or a scene, without a broker
eigencast-client frames --watch                         # a folder that is being written
eigencast-client http://localhost:7490/demo             # the stream "demo" of a broker on this machine
eigencast-client http://host:7490/heart --lod 0.3       # three tenths of the vertices
eigencast-client http://host:7490/heart --rate raw --playout interpolate
eigencast-client https://host/heart --token @FILE       # a broker that wants a token
eigencast-client list http://host:7490                  # the streams of a broker
eigencast-client --compare http://host:7490/a http://host:7490/b  # how far apart two streams of one surface are
eigencast-client view heart                             # a built-in shape: heart, bar, torus, sphere
eigencast-client --headless --frames 90 --out pictures  # no display needed
eigencast-client fox.glb --film fox.mp4                 # every picture at its time; --turntable 12 goes round it
eigencast-client completion bash                        # or zsh: a script for your shell
)";
constexpr const char* kExitStatus = R"(0 good
1 failed: no display, a file that cannot be read or written, a sender that went before the end of a film
2 wrong usage; a file that is not there
4 no stream came, or the broker said no
130, 143 a film that a signal (SIGINT, SIGTERM) ended early: what it has can be played
)";

bool size_from_text(const std::string& text, int& width, int& height) {
  char rest = 0;
  return std::sscanf(text.c_str(), "%5dx%5d%c", &width, &height, &rest) == 2 && width >= 16 && height >= 16 &&
         width <= 16384 && height <= 16384;
}

bool colour_from_text(const std::string& text, SurfacePainter::Wish& wish) {
  const std::size_t colon = text.find(':');
  const auto colouring = kColouringNames.find(text.substr(0, colon));
  if (!colouring || (colon != std::string::npos) != (*colouring == Colouring::kChannel)) return false;
  wish.colouring = *colouring;
  if (colon == std::string::npos) return true;
  const std::string which = text.substr(colon + 1);
  if (which.find_first_not_of("0123456789") != std::string::npos) return wish.scalar = which, true;
  return std::sscanf(which.c_str(), "%3u", &wish.channel) == 1 && wish.channel >= 3;
}

/// What is wrong; empty if nothing is.
std::string read_style(const RawOptions& raw, Style& style) {
  if (!colour_from_text(raw.colour, style.colour))
    return "--colour " + raw.colour +
           ": give auto, clay, own, textured, normals, movement, speed, error, or channel:NAME or channel:K with K "
           "from 3, the first beyond x, y, z";
  const auto map = kColourMapNames.find(raw.colour_map);
  if (!map) return "--colour-map " + raw.colour_map + ": give viridis, cividis, coolwarm, turbo or grey";
  style.colour_map = *map;
  style.normals = kNormalsNames.find(raw.normals).value_or(Normals::kAuthored);
  style.crease_deg = static_cast<float>(raw.crease_deg);
  if (raw.colour_range.empty()) return {};
  float low = 0, high = 0;
  char rest = 0;
  if (std::sscanf(raw.colour_range.c_str(), "%f,%f%c", &low, &high, &rest) != 2 || !(low < high) ||
      !(std::isfinite(low) && std::isfinite(high)))
    return "--colour-range " + raw.colour_range + ": give the lowest and the highest value, such as 0,0.5";
  style.colour_range = {low, high};
  return {};
}

/// Before anything is read or connected.
Result<void> check_outputs(const ClientOptions& options) {
  for (const std::string* path : {&options.json, &options.screenshot, &options.record, &options.record_shown}) {
    if (const auto writable = *path == "-" ? Result<void>() : check_output_file(*path); !writable) return writable;
  }
  return options.out.empty() ? Result<void>() : check_output_folder(options.out);
}

ExitNow usage(const std::string& message) {
  std::fprintf(stderr, "eigencast-client: %s\nTry eigencast-client --help\n", message.c_str());
  return {kExitUsage};
}

/// What the words in the streams' place do.
struct Word {
  std::string_view name, usage, does, examples;
};
constexpr std::array<Word, 3> kWords{
    {{"list",
      "list [URL] [--context NAME] [--token TEXT] [--ca FILE] [--cert FILE --key FILE] [--insecure] [--json FILE]",
      "Lists the streams of a broker: that of the URL, of the context, of $EIGENCAST_URL, or this machine's. --json "
      "writes them as JSON, to standard output where it is -.",
      "eigencast-client list                           # of this machine's broker\n"
      "eigencast-client list http://host:7490\n"
      "eigencast-client list https://host --token @FILE\n"},
     {"view", "view FILES... [OPTIONS]",
      "Shows files, folders, globs and built-in shapes (heart, bar, torus, sphere), without a broker. It takes all "
      "options of eigencast-client --help but those of connections.",
      "eigencast-client view heart\n"
      "eigencast-client view 'frames/*.obj' --watch    # read again when they change\n"
      "eigencast-client view heart --film heart.mp4\n"},
     {"completion", "completion SHELL", "Writes the script that completes options in your shell: bash or zsh.",
      "source <(eigencast-client completion bash)\n"}}};

/// "WORD --help".
std::optional<ExitNow> write_help_of_word(std::span<const char* const> words) {
  const auto asks = [](std::string_view word) { return word == "-h" || word == "--help"; };
  if (words.size() < 2 || std::none_of(words.begin() + 1, words.end(), asks)) return std::nullopt;
  const auto* const word =
      std::find_if(kWords.begin(), kWords.end(), [&](const Word& w) { return w.name == words[0]; });
  if (word == kWords.end()) return std::nullopt;
  const std::string text = std::string(word->does) + "\nUsage: eigencast-client " + std::string(word->usage) +
                           "\n\nexamples:\n" + std::string(word->examples) + "\nexit status:\n" + kExitStatus;
  std::fputs(text.c_str(), stdout);
  return ExitNow{kExitGood};
}

/// "completion SHELL" in the streams' place.
std::optional<ExitNow> write_completion(const CLI::App& app, const std::vector<std::string>& words) {
  if (words.empty() || words.front() != "completion") return std::nullopt;
  const auto script = words.size() == 2 ? completion_script(app, words[1]) : std::nullopt;
  if (!script) return usage("completion: name your shell: bash or zsh");
  std::fputs(script->c_str(), stdout);
  return ExitNow{kExitGood};
}

using Choices = std::vector<std::string>;
using Range = OptionEntry::Range;

struct OptionGroup {
  const char* name;
  std::vector<OptionEntry> entries;
};

std::vector<OptionGroup> groups_for(ClientOptions& options, RawOptions& raw) {
  return {
      {"What to show",
       {{"streams",
         &options.scene.streams,
         "files, folders, recordings and scene files; or http://host[:port]/stream (https:// for TLS; "
         "http://a,b/stream: the brokers a and b of a cluster in turn); or streams at the context's broker; after the "
         "word view, globs and built-in shapes, too; or list and a broker",
         {},
         false,
         "EIGENCAST_URL"},
        {"--scene", &raw.scene, "a JSON file that says which streams are where (client/README.md)"},
        {"--truth", &options.truth,
         "the clip that the streams play (file, folder, glob or built-in shape), for --colour error; files that are "
         "played here are their own"},
        {"--compare", &options.compare,
         "a second stream, recording or file of the same surface (asset): colours show how far apart both are, figures "
         "how much"},
        {"--watch", &options.watch, "in the window: files that are played here are read again when they change"}}},
      {"Connection",
       {{"--context",
         &raw.context,
         "broker by name, see eigencast-sender context (default: the current one)",
         {},
         false,
         "EIGENCAST_CONTEXT"},
        {"--rate", &raw.rate, "poses that the broker sends", Choices{"raw", "interpolated", "estimated"}},
        {"--scheme", &raw.scheme,
         "how the broker makes poses: linear, catmull-rom, hermite (interpolated); damped, linear (estimated)",
         Choices{"catmull-rom", "damped", "hermite", "linear"}},
        {"--k", &raw.k, "poses per key unless raw (default 3)", Range{2, 15}},
        {"--bands", &raw.bands, "coefficient bands wanted, from the lowest", Range{1, 8}},
        {"--sync", &options.sync,
         "show the same moment as all who give this name for their group, as late as the slowest of them needs (300 ms "
         "at most); goes with --playout estimate (default then: poses that come later are estimated) or interpolate"},
        {"--ago", &options.ago_s,
         "begin so many seconds ago, where the broker keeps what it streamed and the token may see it again (rewind)",
         Range{0.001, 1e9}},
        {"--speed", &options.speed, "how fast --ago goes on; 0: it shows one pose", Range{0, limits::kMaxSpeed}, true},
        {"--room", &options.room,
         "be in this room of the first stream's broker: people see each other's pointers and pinned notes, and follow "
         "one who leads"},
        {"--name", &options.person, "how others see you there (default: $USER)", {}, false, "EIGENCAST_NAME"},
        {"--cache", &options.cache_dir,
         "folder for downloaded models, up to $EIGENCAST_CACHE_BYTES (4 GiB); \"\" keeps none (default: "
         "~/.cache/eigencast)"},
        {"--memory", &options.memory_mb,
         "memory that surfaces and textures from brokers may take in all, in MB; larger ones are refused (default: "
         "three quarters of what is free)",
         Range{0, 1e9}}}},
      {"Picture",
       {{"--size", &raw.size, "width x height in pixels", {}, true},
        {"--view", &options.view, "first view", Choices{"iso", "front", "back", "left", "right", "top", "bottom"}},
        {"--camera-path", &options.camera_path,
         "a JSON file that moves the camera (client/README.md); headless it says how long the flight takes"},
        {"--colour",
         &raw.colour,
         "what the surfaces' colours say: auto (the texture or colours that they bring, else clay), clay, own (those "
         "of the file), textured, normals, movement (from the rest pose), speed, channel:NAME or channel:K (a scalar "
         "of the stream), error (against the truth)",
         {},
         true},
        {"--colour-map", &raw.colour_map, "colours of numbers",
         Choices{"viridis", "cividis", "coolwarm", "turbo", "grey"}, true},
        {"--colour-range", &raw.colour_range,
         "LOW,HIGH: the values of the map's ends, in the stream's units (default: those of a whole film; live, those "
         "seen so far, which grow)"},
        {"--normals", &raw.normals,
         "authored: hard and smooth edges as the file's own normals have them, where it has none as crease: smooth but "
         "along edges that bend by --crease or more; smooth; flat: each face by itself",
         Choices{"authored", "crease", "smooth", "flat"}, true},
        {"--crease", &raw.crease_deg, "degrees", Range{1, 180}, true},
        {"--edges", &options.style.edges, "draw the triangles' edges"},
        {"--wireframe", &options.style.wireframe, "draw edges only"},
        {"--points", &options.style.points, "draw vertices as points"},
        {"--transparent", &options.style.transparent, "pictures without a background"},
        {"--ui-scale", &options.ui_scale, "size of texts, panels and lines (default: the display's)", Range{0.5, 8}},
        {"--settings", &options.settings,
         "file in which the window remembers its size and switches; \"\": nowhere (default: "
         "~/.config/eigencast/viewer.json)"}}},
      {"Detail",
       {{"--lod", &options.view_options.lod, "level of detail: fraction of the vertices, 0..1", Range{0, 1}},
        {"--resolver", &raw.resolver,
         "what chooses levels below --lod, so that pictures come in time: budget (default in the window), paper, none "
         "(default headless)",
         Choices{"budget", "paper", "none"}},
        {"--quality", &raw.quality,
         "how pictures are drawn: auto (pixels, samples, shadow, ground and vertices go so that pictures come in time, "
         "what is least seen first; default with --resolver budget), full, low",
         Choices{"auto", "full", "low"}},
        {"--target-fps", &options.levels.target_fps,
         "pictures a second that the resolver holds (default: the display's, or 30 where that is far off; headless 60)",
         Range{1, 1000}},
        {"--lod-floor", &options.levels.floor, "smallest part of its vertices that a surface keeps", Range{0, 1}, true},
        {"--reconstruct", &raw.reconstruct,
         "what rebuilds surfaces from their coefficients: the processor, the GPU, or the quicker one when the program "
         "starts",
         Choices{"auto", "cpu", "gpu"}, true}}},
      {"Motion between arrivals",
       {{"--playout", &raw.playout, "poses between arrivals: the latest one, or made by this program",
         Choices{"latest", "interpolate", "estimate"}, true},
        {"--smooth", &raw.smooth,
         "how long --playout interpolate or estimate holds poses: 0 live, 1 smooth: an interval and the jitter "
         "(default: 1 of interpolate, 0 of estimate)",
         Range{0, 1}},
        {"--delay", &raw.delay_ms, "hold them for just so many ms; 0 follows the stream", Range{0, 10'000}, true},
        {"--ahead", &raw.ahead_ms, "ms after which --playout estimate stops and holds the pose", Range{0, 10'000},
         true}}},
      {"Without a window",
       {{"--headless", &options.headless, "no window: render into memory, no display needed"},
        {"--out", &options.out, "headless: folder for frame_0001.png ... and report.json"},
        {"--hud", &options.hud,
         "headless: draw the figures and the colours' legend into the pictures too (of a film timecode and legend)"},
        {"--wait", &options.wait_s,
         "seconds after which it gives up: of no news before the first picture, of no sender before --frames",
         Range{0, 1e7}, true},
        {"--first", &options.first,
         "count pictures before the whole surface has come (default: --frames waits for it)"}}},
      {"Films",
       {{"--film", &raw.film,
         "write a film and end: .mp4 or .webm (by ffmpeg), or pictures such as frame_%04d.png; each picture shows its "
         "time however long it takes to draw. Streams are kept first. Needs no display"},
        {"--fps", &raw.fps, "pictures a second of the film", Range{0.01, 1000}, true},
        {"--seconds", &raw.seconds,
         "length of the film (default: of --camera-path, one turn of --turntable, else one round of the longest file)",
         Range{0.001, 1e6}},
        {"--turntable", &options.turntable_s, "the camera goes once round the scene in so many seconds (key Y)",
         Range{0.1, 1e6}}}},
      {"End and results",
       {{"--frames", &options.frames, "end after so many new poses were drawn (0: never)"},
        {"--duration", &options.duration_s, "end after so many seconds (0: never)", Range{0, 1e7}},
        {"--screenshot", &options.screenshot, "write the last picture to this PNG file at the end"},
        {"--json,--report", &options.json, "write the report to this file at the end"},
        {"--record", &options.record, "write every received pose to this file, one JSON object a line"},
        {"--record-shown", &options.record_shown,
         "write what each picture shows, and when, to this file, one JSON object a line"},
        {"-v,--verbose", &options.verbose, "log more"}}}};
}

Result<void> interpret(const CommandLine& line, const RawOptions& raw, ClientOptions& options) {
  const auto wrong = [](const std::string& what) { return fail(ErrorCode::kInvalidArgument, what); };
  if (!size_from_text(raw.size, options.width, options.height))
    return wrong("--size " + raw.size + ": give width x height of 16 to 16384 pixels, such as 1280x720");
  if (const std::string complaint = read_style(raw, options.style); !complaint.empty()) return wrong(complaint);
  if (!options.screenshot.empty() && !options.screenshot.ends_with(".png"))
    return wrong("--screenshot " + options.screenshot + ": it is a PNG file; give a name that ends in .png");
  if (line.has("--film")) {
    const auto target = FilmTarget::from_path(raw.film);
    if (!target) return in_context("--film", target.error());
    options.film = FilmOptions{*target, raw.fps, raw.seconds};
    options.headless = true;
  }
  if (!options.sync.empty() && line.has("--playout") && raw.playout == "latest")
    return wrong("--sync: goes with --playout interpolate or estimate; latest shows each pose when it comes");
  if (!options.room.empty() && options.person.empty()) {
    const char* const user = std::getenv("USER");
    options.person = user != nullptr && *user != '\0' ? user : "viewer";
  }
  options.size_given = line.has("--size");
  options.resolver_given = line.has("--resolver");
  for (const char* of_style :
       {"--edges", "--wireframe", "--points", "--transparent", "--colour-map", "--normals", "--crease"})
    options.style_given |= line.has(of_style);
  if (const Result<void> found = find_streams(raw, options); !found) return found;
  if (!options.compare.empty() && !line.has("--colour")) options.style.colour = {Colouring::kError, 3};
  std::vector<std::string> asked = options.scene.streams;
  if (asked.empty()) asked = {kLocalBroker};  // for streams that the window opens
  for (const std::string& stream : asked) {
    if (clip_in(stream)) continue;
    Result<std::optional<Profile>> profile = profile_from(line, stream, raw);
    if (!profile) return in_context("the stream's URL", profile.error());
    options.profile = *profile;
  }
  const ResolverKind usual = options.headless ? ResolverKind::kNone : ResolverKind::kBudget;
  options.levels.kind = kResolverNames.find(raw.resolver).value_or(usual);
  const bool adapts = !options.headless || options.levels.kind == ResolverKind::kBudget;
  options.levels.quality = kQualityNames.find(raw.quality).value_or(adapts ? QualityMode::kAuto : QualityMode::kFull);
  options.reconstruct = kRebuildOnNames.find(raw.reconstruct).value_or(RebuildOn::kAuto);
  if (options.headless) options.levels.deadline = 1.25;  // no display to miss
  options.follow_display = !options.headless && !line.has("--target-fps");
  if (const Result<void> used = check_uses(line, raw, options); !used) return used;
  const bool has_length = line.has("--seconds") || line.has("--turntable") || !options.camera_path.empty();
  const std::size_t streams = options.scene.streams.size();
  if (options.film && !has_length && (streams == 0 || files_in(options.scene.streams) < streams))
    return wrong("--film of a stream: say how long it is with --seconds, --turntable or --camera-path");
  const bool has_delay = line.has("--smooth") || line.has("--delay") || line.has("--ahead");
  options.playout_given = has_delay || line.has("--playout") || !options.sync.empty();
  if (line.has("--smooth") && line.has("--delay"))
    return wrong("--smooth and --delay both say how long poses are held back; give one of them");
  PlayoutSettings& playout = options.view_options.playout;
  playout.mode = kPlayoutNames.find(raw.playout).value_or(PlayoutMode::kLatest);
  // Who has a late pose yet to get shows the moment of all by an estimate; in the past, which has no lag, all wait.
  if (!options.sync.empty() && !line.has("--playout")) playout.mode = PlayoutMode::kEstimate, playout.smoothness = 1;
  // So that poses of both have come.
  if (!options.compare.empty() && !options.playout_given) playout.mode = PlayoutMode::kInterpolate;
  if (line.has("--smooth")) playout.smoothness = raw.smooth;
  playout.delay_us = static_cast<TimeUs>(raw.delay_ms * 1000);
  playout.max_ahead_us = static_cast<TimeUs>(raw.ahead_ms * 1000);
  return {};
}

}  // namespace

std::variant<ClientOptions, ExitNow> options_from_command_line(int argc, const char* const* argv) {
  if (argc > 1) {
    const std::span<const char* const> words(argv + 1, static_cast<std::size_t>(argc) - 1);
    if (const auto helped = write_help_of_word(words)) return *helped;
  }
  ClientOptions options;
  RawOptions raw;
  options.cache_dir = default_cache_dir();
  options.settings = Settings::default_path();
  CommandLine line("eigencast-client", "Shows surfaces that move: streams of brokers, and files.", EIGENCAST_VERSION);
  line.set_footer("examples:\n" + std::string(kExamples) + "in the window, H shows the keys\n\nexit status:\n" +
                  kExitStatus);
  for (const OptionGroup& group : groups_for(options, raw)) {
    line.add(group.entries, group.name);
    if (group.name == std::string_view("What to show")) add_credential_options(line.app(), raw.credentials);
  }
  line.amend("--token",
             "token, or @FILE that holds it, for the broker of --context, else of the first stream, and for no other",
             "EIGENCAST_TOKEN");
  if (const std::optional<bool> was_help = line.parse(argc, argv)) return ExitNow{*was_help ? kExitGood : kExitUsage};
  if (const auto documents = write_completion(line.app(), options.scene.streams)) return *documents;
  if (const std::string fault = fault_of_numbers(line.app()); !fault.empty()) return usage(fault);
  if (const Result<void> good = interpret(line, raw, options); !good) return usage(good.error().message);
  if (const Result<void> writable = check_outputs(options); !writable)
    return std::fprintf(stderr, "eigencast-client: %s\n", writable.error().message.c_str()), ExitNow{kExitFailed};
  return options;
}

}  // namespace eigencast
