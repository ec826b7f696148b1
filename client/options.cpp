// SPDX-License-Identifier: MIT
#include "client/options.h"

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <map>

#include "client/clip_source.h"
#include "client/settings.h"
#include "common/command_line/documents.h"
#include "common/command_line/shared_options.h"
#include "common/net/url.h"
#include "sdk/asset_cache.h"
#include "sdk/contexts.h"

namespace eigencast {
namespace {

constexpr const char* kDefaultUrl = "ws://127.0.0.1:7490/demo";
constexpr const char* kExamples =
    R"(eigencast-client                                        # a window that asks what to show
eigencast-client ws://localhost:7490/demo               # the stream "demo" of a broker on this machine
eigencast-client ws://host:7490/heart --lod 0.3         # three tenths of the vertices
eigencast-client ws://host:7490/heart --rate raw --playout interpolate
eigencast-client wss://host/heart --token @FILE         # a broker that asks who comes
eigencast-client view horse.obj                         # a file, without a broker
eigencast-client view frames --watch                    # a folder that is being written
eigencast-client --headless --frames 90 --out pictures  # no display needed
eigencast-client completion bash                        # or zsh, fish: a script for your shell; man: the manual page
)";
constexpr const char* kExitStatus = R"(0 good
1 failed: no display, a file that cannot be written
2 wrong usage
4 no stream came
)";

const std::map<std::string, Profile::Scheme> kSchemes{{"linear", Profile::Scheme::kLinear},
                                                      {"catmull-rom", Profile::Scheme::kCatmullRom},
                                                      {"hermite", Profile::Scheme::kHermite},
                                                      {"damped", Profile::Scheme::kDamped}};

struct RawOptions {
  std::string reconstruct = "auto", scene, resolver, size = "1280x720", colour = "clay", colour_map = "viridis",
              colour_range, rate, form, scheme, playout = "latest", context;
  Credentials credentials;
  int k = 3, bands = 8;
  double delay_ms = 0, smooth = 1, ahead_ms = 200;
};

bool size_from_text(const std::string& text, int& width, int& height) {
  char rest = 0;
  return std::sscanf(text.c_str(), "%5dx%5d%c", &width, &height, &rest) == 2 && width >= 16 && height >= 16 &&
         width <= 16384 && height <= 16384;
}

/// "speed", "channel:4".
bool colour_from_text(const std::string& text, SurfacePainter::Wish& wish) {
  const std::size_t colon = text.find(':');
  const auto colouring = colouring_from_name(text.substr(0, colon));
  if (!colouring || (colon != std::string::npos) != (*colouring == Colouring::kChannel)) return false;
  wish.colouring = *colouring;
  char rest = 0;
  return colon == std::string::npos ||
         (std::sscanf(text.c_str() + colon, ":%3u%c", &wish.channel, &rest) == 1 && wish.channel >= 3);
}

/// What the surfaces look like; the complaint if the command line cannot mean it.
std::string read_style(const RawOptions& raw, Style& style) {
  if (!colour_from_text(raw.colour, style.colour))
    return "--colour " + raw.colour +
           ": give clay, own, textured, normals, movement, speed, error, or channel:K with K from 3, the first beyond "
           "x, y, z";
  const auto map = colour_map_from_name(raw.colour_map);
  if (!map) return "--colour-map " + raw.colour_map + ": give viridis, cividis, coolwarm, turbo or grey";
  style.colour_map = *map;
  if (raw.colour_range.empty()) return {};
  float low = 0, high = 0;
  char rest = 0;
  if (std::sscanf(raw.colour_range.c_str(), "%f,%f%c", &low, &high, &rest) != 2 || !(low < high) ||
      !(std::isfinite(low) && std::isfinite(high)))
    return "--colour-range " + raw.colour_range + ": give the lowest and the highest value, such as 0,0.5";
  style.colour_range = {low, high};
  return {};
}

/// The profile that URL and options ask for together; options win.
Result<std::optional<Profile>> profile_from(const CLI::App& app, const std::string& url, const RawOptions& raw) {
  const Result<BrokerUrl> parsed = parse_broker_url(url);
  if (!parsed) return parsed.error();
  const Result<Profile> asked = profile_from_query(parsed->query);
  if (!asked) return asked.error();
  const std::size_t making = app.count("--k") + app.count("--form") + app.count("--scheme");
  if (app.count("--rate") + making + app.count("--bands") == 0) return std::optional<Profile>();
  Profile profile = *asked;
  if (app.count("--k") > 0) profile.k = static_cast<std::uint8_t>(raw.k);
  if (app.count("--bands") > 0) profile.bands = static_cast<std::uint8_t>(raw.bands);
  if (app.count("--form") > 0) profile.form = raw.form == "compact" ? Profile::Form::kCompact : Profile::Form::kFull;
  if (app.count("--rate") > 0) {
    const Profile::Rate rate = raw.rate == "raw"         ? Profile::Rate::kRaw
                               : raw.rate == "estimated" ? Profile::Rate::kEstimated
                                                         : Profile::Rate::kInterpolated;
    if (rate != profile.rate) profile.scheme = default_scheme(rate);
    profile.rate = rate;
  }
  if (app.count("--scheme") > 0) profile.scheme = kSchemes.at(raw.scheme);
  if (profile.rate == Profile::Rate::kRaw && making > 0) {
    return fail(
        ErrorCode::kInvalidArgument,
        "--k, --form and --scheme say how the broker makes poses, but rate raw asks for the keys alone; leave them "
        "out, or ask for --rate interpolated or estimated");
  }
  if (const auto checked = check_profile(profile); !checked) return checked.error();
  return std::optional<Profile>(profile);
}

std::string origin_of(const std::string& url) {
  const auto parsed = parse_broker_url(url);
  return parsed ? parsed->origin() : std::string();
}

/// Names and contexts become a URL with its credentials. home: the broker that token and certificate of the command
/// line are for; empty: this stream's, which it becomes. Others are only told what the contexts hold for them.
Result<Target> resolve(const std::string& stream, const RawOptions& raw, std::string& home) {
  const auto contexts = Contexts::load(Contexts::default_path());
  if (!contexts) return contexts.error();
  const bool nothing = stream.empty() && contexts->find(raw.context) == nullptr && raw.context.empty();
  const std::string to = nothing ? kDefaultUrl : stream;
  const auto meant = resolve_target(to, {}, raw.context, *contexts);
  if (!meant) return meant.error();
  const std::string broker = origin_of(meant->url);
  if (home.empty()) home = raw.context.empty() ? broker : origin_of(contexts->find(raw.context)->url);
  Credentials given = raw.credentials;
  if (broker != home) given = {"", raw.credentials.ca_file};
  auto target = resolve_target(to, given, raw.context, *contexts);
  if (!target) return target.error();
  const auto url = parse_broker_url(target->url);
  if (!url || url->credentials.token.empty()) return target;
  // Reports and titles show the URL: the token goes out of it.
  if (target->credentials.token.empty()) target->credentials.token = url->credentials.token;
  target->url = url->origin() + (url->prefix.empty() ? "" : url->prefix + "/v1/subscribe") + "/" + url->stream +
                (url->query.empty() ? "" : "?" + url->query);
  return target;
}

bool knows_a_broker(const RawOptions& raw) {
  const auto contexts = Contexts::load(Contexts::default_path());
  return !raw.context.empty() || !contexts || contexts->find("") != nullptr;
}

/// The streams of the scene file or of the command line; or the context's; or, without a window to ask in, the usual
/// one. For each its credentials.
Result<void> find_streams(const RawOptions& raw, ClientOptions& options) {
  SceneDescription& scene = options.scene;
  if (!raw.scene.empty()) {
    if (!scene.streams.empty())
      return fail(ErrorCode::kInvalidArgument, "--scene names the streams; leave those of the command line out");
    Result<SceneDescription> read = read_scene_file(raw.scene);
    if (!read) return read.error();
    scene = std::move(*read);
  }
  if (!scene.streams.empty() && scene.streams.front() == "view") {
    scene.streams.erase(scene.streams.begin());
    if (scene.streams.empty())
      return fail(ErrorCode::kInvalidArgument,
                  "view: name a file, a folder, a glob or a built-in shape, such as heart");
    for (std::string& stream : scene.streams) stream = "file:" + stream;
  }
  if (scene.streams.empty() && (options.headless || knows_a_broker(raw))) scene.streams = {""};
  std::string home;
  for (std::string& stream : scene.streams) {
    Target target;
    if (clip_in(stream)) {
      target.url = stream;
    } else {
      auto resolved = resolve(stream, raw, home);
      if (!resolved) return resolved.error();
      target = std::move(*resolved);
    }
    stream = target.url;
    options.credentials.push_back(target.credentials);
  }
  return {};
}

ExitNow usage(const std::string& message) {
  std::fprintf(stderr, "eigencast-client: %s\nTry eigencast-client --help\n", message.c_str());
  return {kExitUsage};
}

/// "man" and "completion SHELL" in the streams' place: what the program says about itself, on standard output.
std::optional<ExitNow> write_documents(const CLI::App& app, const std::vector<std::string>& words) {
  if (words == std::vector<std::string>{"man"}) {
    std::fputs(man_page_from(app, EIGENCAST_VERSION, kExitStatus, kExamples).c_str(), stdout);
    return ExitNow{kExitGood};
  }
  if (words.empty() || words.front() != "completion") return std::nullopt;
  const auto shell = words.size() == 2 ? shell_from_name(words[1]) : std::nullopt;
  if (!shell) return usage("completion: name your shell: bash, zsh or fish");
  std::fputs(completion_from(app, *shell).c_str(), stdout);
  return ExitNow{kExitGood};
}

}  // namespace

std::variant<ClientOptions, ExitNow> options_from_command_line(int argc, const char* const* argv) {
  ClientOptions options;
  RawOptions raw;
  options.cache_dir = default_cache_dir();
  options.settings = Settings::default_path();
  CLI::App app{"Watches a deforming surface that a broker streams.", "eigencast-client"};
  app.footer("examples:\n" + std::string(kExamples) + "in the window, H shows the keys\n\nexit status:\n" +
             kExitStatus);
  app.set_version_flag("--version", "eigencast-client " EIGENCAST_VERSION);
  app.add_option("streams", options.scene.streams,
                 "ws://host[:port]/stream (wss:// for TLS; http:// and https:// do as well), or streams at the "
                 "context's broker; or, after the word view, "
                 "files, folders, "
                 "globs or built-in shapes, which are baked and played here without a broker")
      ->envname("EIGENCAST_URL");
  app.add_option("--scene", raw.scene, "a JSON file that says which streams stand where (client/README.md)");
  app.add_option("--context", raw.context, "broker by name, see eigencast-sender context (default: the current one)")
      ->envname("EIGENCAST_CONTEXT");
  add_credential_options(app, raw.credentials)
      ->description(
          "token, or @FILE that holds it, for the broker of --context, else of the first stream, and for no other")
      ->envname("EIGENCAST_TOKEN");
  app.add_flag("--headless", options.headless, "no window: render into memory, no display needed");
  app.add_option("--frames", options.frames, "end after so many new poses were drawn (0: never)");
  app.add_option("--duration", options.duration_s, "end after so many seconds (0: never)")->check(CLI::Range(0.0, 1e7));
  app.add_option("--out", options.out, "headless: folder for frame_0001.png ... and report.json");
  app.add_option("--size", raw.size, "width x height in pixels")->capture_default_str();
  app.add_option("--lod", options.view_options.lod, "level of detail: fraction of the vertices, 0..1")
      ->check(CLI::Range(0.0, 1.0));
  app.add_option(
         "--resolver", raw.resolver,
         "who chooses levels below --lod, so that pictures come in time: budget (default in the window), paper, "
         "none (default headless)")
      ->check(CLI::IsMember({"budget", "paper", "none"}));
  app.add_option("--target-fps", options.levels.target_fps,
                 "pictures a second that the resolver holds (default: the display's, headless 60)")
      ->check(CLI::Range(1.0, 1000.0));
  app.add_option("--lod-floor", options.levels.floor, "least part of its vertices that a surface keeps")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--reconstruct", raw.reconstruct,
                 "who rebuilds surfaces from their coefficients: the processor, the GPU, or whoever is quicker "
                 "when the program starts")
      ->check(CLI::IsMember({"auto", "cpu", "gpu"}))
      ->capture_default_str();
  app.add_option("--camera-path", options.camera_path,
                 "a JSON file that moves the camera (client/README.md); headless it says how long the flight takes");
  app.add_option("--rate", raw.rate, "poses that the broker sends")
      ->check(CLI::IsMember({"raw", "interpolated", "estimated"}));
  app.add_option("--scheme", raw.scheme,
                 "how the broker makes poses: linear, catmull-rom, hermite (interpolated); damped, linear (estimated)")
      ->check(CLI::IsMember(kSchemes));
  app.add_option("--k", raw.k, "poses per key unless raw (default 3)")->check(CLI::Range(2, 15));
  app.add_option("--form", raw.form, "who interpolates: the broker (full) or this program (compact)")
      ->check(CLI::IsMember({"full", "compact"}));
  app.add_option("--bands", raw.bands, "coefficient bands wanted, from the lowest")->check(CLI::Range(1, 8));
  app.add_option("--playout", raw.playout, "poses between arrivals: the latest one, or made by this program")
      ->check(CLI::IsMember({"latest", "interpolate", "estimate"}))
      ->capture_default_str();
  app.add_option("--smooth", raw.smooth,
                 "how long --playout interpolate or estimate holds poses: 0 live, 1 smooth: an interval and the jitter "
                 "(default: 1 of interpolate, 0 of estimate)")
      ->check(CLI::Range(0.0, 1.0));
  app.add_option("--delay", raw.delay_ms, "hold them for just so many ms; 0 follows the stream")
      ->check(CLI::Range(0.0, 10'000.0))
      ->capture_default_str();
  app.add_option("--ahead", raw.ahead_ms, "ms after which --playout estimate stops and holds the pose")
      ->check(CLI::Range(0.0, 10'000.0))
      ->capture_default_str();
  app.add_option("--view", options.view, "first view")
      ->check(CLI::IsMember({"iso", "front", "back", "left", "right", "top", "bottom"}));
  app.add_option("--colour", raw.colour,
                 "what the surfaces' colours say: clay, own (those of the file), textured, normals, movement (from the "
                 "rest pose), "
                 "speed, channel:K (a scalar that rides on the stream), error (against the truth)")
      ->capture_default_str();
  app.add_option("--colour-map", raw.colour_map, "colours of numbers")
      ->check(CLI::IsMember({"viridis", "cividis", "coolwarm", "turbo", "grey"}))
      ->capture_default_str();
  app.add_option("--colour-range", raw.colour_range,
                 "LOW,HIGH: the values of the map's ends, in the stream's units (default: what has been seen)");
  app.add_option(
      "--truth", options.truth,
      "the clip that the streams play (file, folder, glob or built-in shape), for --colour error; files that are "
      "played here are their own");
  app.add_flag("--watch", options.watch, "in the window: files that are played here are read again when they change");
  app.add_flag("--edges", options.style.edges, "draw the triangles' edges");
  app.add_flag("--wireframe", options.style.wireframe, "draw edges only");
  app.add_flag("--points", options.style.points, "draw vertices as points");
  app.add_flag("--transparent", options.style.transparent, "pictures without a background");
  app.add_flag("--hud", options.hud, "headless: draw the figures and the colours' legend into the pictures too");
  app.add_option("--json,--report", options.json, "write the report to this file at the end");
  app.add_option("--record", options.record, "write every received pose to this file, one JSON object a line");
  app.add_option("--record-shown", options.record_shown,
                 "write what each picture shows, and when, to this file, one JSON object a line");
  app.add_option("--screenshot", options.screenshot, "write the last picture to this PNG file at the end");
  app.add_option("--turntable", options.turntable, "headless: so many pictures, once round the scene, then end");
  app.add_option("--ui-scale", options.ui_scale, "size of texts, panels and lines (default: the display's)")
      ->check(CLI::Range(0.5, 8.0));
  app.add_option("--settings", options.settings,
                 "file in which the window remembers its size and switches; \"\": nowhere (default: "
                 "~/.config/eigencast/viewer.json)");
  app.add_option("--wait", options.wait_s, "headless: seconds to wait for the first pose")
      ->check(CLI::Range(0.0, 1e7))
      ->capture_default_str();
  app.add_option("--cache", options.cache_dir,
                 "folder for downloaded models; \"\" keeps none (default: ~/.cache/eigencast)");
  app.add_flag("-v,--verbose", options.verbose, "log more");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& stop) {
    return ExitNow{app.exit(stop) == 0 ? kExitGood : kExitUsage};
  }
  if (const auto documents = write_documents(app, options.scene.streams)) return *documents;
  if (const std::string fault = fault_of_numbers(app); !fault.empty()) return usage(fault);
  if (!size_from_text(raw.size, options.width, options.height)) {
    return usage("--size " + raw.size + ": give width x height of 16 to 16384 pixels, such as 1280x720");
  }
  if (const std::string complaint = read_style(raw, options.style); !complaint.empty()) return usage(complaint);
  options.size_given = app.count("--size") > 0;
  options.resolver_given = app.count("--resolver") > 0;
  for (const char* of_style : {"--edges", "--wireframe", "--points", "--transparent", "--colour-map"})
    options.style_given |= app.count(of_style) > 0;
  if (options.headless && options.watch) return usage("--watch is for the window; headless a file is read once");
  if (!options.headless && !options.out.empty())
    return usage("--out is for --headless; in the window use --screenshot or key S");
  if (const Result<void> found = find_streams(raw, options); !found) return usage(found.error().message);
  std::vector<std::string> asked = options.scene.streams;
  if (asked.empty()) asked = {kDefaultUrl};  // for those that will be opened in the window
  for (const std::string& stream : asked) {
    if (clip_in(stream)) continue;
    Result<std::optional<Profile>> profile = profile_from(app, stream, raw);
    if (!profile) return usage("the stream's URL: " + profile.error().message);
    options.profile = *profile;
  }
  options.levels.kind = raw.resolver == "paper"                                                ? ResolverKind::kPaper
                        : raw.resolver == "none" || (raw.resolver.empty() && options.headless) ? ResolverKind::kNone
                                                                                               : ResolverKind::kBudget;
  options.reconstruct = rebuild_on_from_name(raw.reconstruct).value_or(RebuildOn::kAuto);
  if (options.headless) options.levels.deadline = 1.25;  // no display to miss
  options.follow_display = !options.headless && app.count("--target-fps") == 0;
  const bool has_delay = app.count("--smooth") + app.count("--delay") + app.count("--ahead") > 0;
  options.playout_given = has_delay || app.count("--playout") > 0;
  if (raw.playout == "latest" && has_delay)
    return usage("--smooth, --delay and --ahead are for --playout interpolate or estimate; latest holds nothing back");
  if (app.count("--smooth") > 0 && app.count("--delay") > 0)
    return usage("--smooth and --delay both say how long poses are held back; give one of them");
  PlayoutSettings& playout = options.view_options.playout;
  playout.mode = raw.playout == "interpolate" ? PlayoutMode::kInterpolate
                 : raw.playout == "estimate"  ? PlayoutMode::kEstimate
                                              : PlayoutMode::kLatest;
  if (app.count("--smooth") > 0) playout.smoothness = raw.smooth;
  playout.delay_us = static_cast<TimeUs>(raw.delay_ms * 1000);
  playout.max_ahead_us = static_cast<TimeUs>(raw.ahead_ms * 1000);
  return options;
}

}  // namespace eigencast
