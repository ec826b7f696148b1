// SPDX-License-Identifier: MIT
#include "sender/commands.h"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "common/command_line/command_line.h"
#include "common/core/files.h"
#include "common/surface/formats/read.h"
#include "common/surface/formats/write.h"
#include "common/wire/control.h"
#include "sdk/asset_cache.h"
#include "sdk/contexts.h"
#include "sdk/recorded_clip.h"
#include "sender/option_groups.h"

namespace eigencast {
namespace {

constexpr const char* kExamples =
    R"(eigencast-sender play heart                                            # to this machine's broker, as "heart"
eigencast-sender play clip.npy --to http://broker:7490/live/clip
simulation | eigencast-sender pipe --mesh rest.obj --to http://broker:7490/sim
eigencast-sender play --help                                           # more of each command)";
constexpr const char* kBakeExamples =
    R"(eigencast-sender bake scan.ply --rank 300
eigencast-sender bake rest.obj --target-error 1e-3 --poses clip.npy    # as many coefficients as that takes)";
constexpr const char* kPlayExamples =
    R"(eigencast-sender play heart                                            # to this machine's broker, as "heart"
eigencast-sender play clip.npy --to http://broker:7490/live/clip --rate 15    # poses a second; the broker triples them
eigencast-sender play fox.glb --animation Run --to http://broker:7490/fox
eigencast-sender play cloth.pc2 --rest cloth.obj --once --to http://broker:7490/cloth
eigencast-sender play 'frames/*.obj' --once --to http://broker:7490/show
eigencast-sender play heart --to demo                                  # at the context's broker)";
constexpr const char* kPipeExamples =
    R"(simulation | eigencast-sender pipe --mesh rest.obj --to http://broker:7490/sim)";
constexpr const char* kDeformExamples =
    R"(eigencast-sender deform heart --to http://broker:7490/heart                   # a window: drag the cage around it
eigencast-sender deform heart --to studio/ann --watch studio/bob         # and see what another one does
eigencast-sender deform heart --script twist --to http://broker:7490/heart     # by a cage that is made around it
eigencast-sender deform dragon.ply --cage cage.obj --script keys.json --to http://broker:7490/dragon)";
constexpr const char* kExportExamples =
    R"(eigencast-sender export fox.glb --to fox.mdd
eigencast-sender export clip.npy --to frames/
eigencast-sender export show.ecrec --to show.html
eigencast-sender export show.ecrec --to show.glb --from 10 --duration 5 --level 0.3)";
constexpr const char* kEvaluateExamples =
    R"(eigencast-sender evaluate clip.npy                                     # error and bit rate, without a network
eigencast-sender evaluate clip.npy -r 50,100,200 --lod 1,0.5,0.1 --json report.json)";
constexpr const char* kReplayExamples = R"(eigencast-sender replay show.ecrec --to http://broker:7490/show --from 60)";
constexpr const char* kInfoExamples = "eigencast-sender info show.ecrec";
constexpr const char* kCutExamples =
    R"(eigencast-sender cut show.ecrec --from 60 --duration 30 --to best.ecrec
eigencast-sender cut monday.ecrec tuesday.ecrec --to both.ecrec)";
constexpr const char* kContextExamples =
    R"(eigencast-sender context add studio https://broker.example --token "$TOKEN")";
constexpr const char* kCompletionExamples =
    R"(eigencast-sender completion bash > ~/.local/share/bash-completion/completions/eigencast-sender)";

/// Longer than anything runs, short enough to be counted in microseconds.
constexpr double kMaxSeconds = 1e9;

constexpr const char* kOwnGroup = "What is done";

constexpr const char* kExitStatus = R"(0  done
1  failed
2  wrong usage
4  the broker was not reached, or said no)";

struct Settings {
  Console console;
  bool no_progress = false;
  bool verbose = false;
  bool loop = false;
  std::string shell;
  std::function<int(Interrupt&)> run;  ///< Set by the command that was named.
  BakeCommand bake;
  PlayCommand play;
  ExportCommand export_clip;
  PipeCommand pipe;
  DeformCommand deform;
  ContextCommand context;
  EvaluateCommand evaluate;
  ReplayCommand replay;
  InfoCommand info;
  CutCommand cut;
};

void show_examples(CLI::App& app, const char* examples) {
  app.footer(std::string("examples:\n") + examples);
}

template <typename Command>
void runs(CLI::App& app, Settings& s, Command& command, const char* examples) {
  show_examples(app, examples);
  app.callback(
      [&s, &command] { s.run = [&s, &command](Interrupt& interrupt) { return run(command, s.console, interrupt); }; });
}

void add_context_commands(CLI::App& app, Settings& s) {
  CLI::App* context = app.add_subcommand("context", "Brokers by name, with their tokens");
  context->require_subcommand(1);
  show_examples(*context, kContextExamples);
  const auto add = [&](const std::string& action, const std::string& description) {
    CLI::App* command = context->add_subcommand(action, description);
    command->callback([&s, action] {
      s.context.action = action;
      s.run = [&s](Interrupt& interrupt) { return run(s.context, s.console, interrupt); };
    });
    return command;
  };
  CLI::App* added = add("add", "Add a broker, or change it; the first is the current one");
  added->add_option("name", s.context.name, "what to call it")->required();
  added->add_option("url", s.context.url, "http://host[:port] or https://..., or of one stream")->required();
  // Not that of the environment: it would be kept, and it may be another broker's.
  add_credential_options(*added, s.context.credentials);
  add("list", "List them; the current one has a star")->add_flag("--json", s.context.json, "as JSON");
  add("use", "Make one the current one")->add_option("name", s.context.name, "which")->required();
  add("remove", "Forget one")->add_option("name", s.context.name, "which")->required();
}

void add_completion_command(CLI::App& app, Settings& s) {
  CLI::App* completion = app.add_subcommand("completion", "Write a completion script to standard output");
  show_examples(*completion, kCompletionExamples);
  completion->add_option("shell", s.shell, "for which shell")->required()->check(CLI::IsMember({"bash", "zsh"}));
  completion->callback([&app, &s] {
    s.run = [&app, &s](Interrupt&) {
      std::fputs(completion_script(app, s.shell)->c_str(), stdout);
      return kExitOk;
    };
  });
}

void add_deform_command(CLI::App& app, Settings& s) {
  DeformCommand& command = s.deform;
  CLI::App* deform = app.add_subcommand("deform", "Deform a model in a window, or by a script, while it goes out");
  runs(*deform, s, command, kDeformExamples);
  add_source_options(*deform, command.source);
  add_target_options(*deform, command.target);
  add_memory_option(*deform, command.target);
  deform->option_defaults()->group(kOwnGroup);
  deform->add_option("--cage-out", command.cage_out, "write the cage, to edit it or to number its vertices (.obj, ...)")
      ->check(output_path(check_surface_path));
  deform->add_option("--handles", command.handles, "no cage: handles.json, and all else as rigid as possible")
      ->excludes(deform->get_option("--cage"));
  CLI::Option* script = deform->add_option("--script", command.script,
                                           "keys.json, or twist, bend, both (default: a window, and your hand)");
  deform
      ->add_option_function<std::vector<std::string>>(
          "--watch",
          [&command](const std::vector<std::string>& streams) {
            for (const std::string& stream : streams) command.watch.emplace_back().url = stream;
          },
          "streams of others, shown beside the model: as --to")
      ->excludes(script);
  deform->add_option("--view", command.view, "of the window at first: front, back, left, right, top, bottom, iso")
      ->check(CLI::IsMember({"front", "back", "left", "right", "top", "bottom", "iso"}))
      ->capture_default_str();
  deform
      ->add_option_function<std::string>(
          "--size",
          [&command](const std::string& size) {
            char end = 0;
            if (std::sscanf(size.c_str(), "%5dx%5d%c", &command.width, &command.height, &end) != 2 ||
                command.width < 64 || command.height < 64) {
              throw CLI::ValidationError("--size", "give width x height, such as 1280x800");
            }
          },
          "of the window, width x height")
      ->default_str("1280x800")
      ->excludes(script);
  bounded(*deform, "--rate", command.rate_hz, "key poses a second (default: 30, by hand at most 60)", 0.1, 1000.0);
  bounded(*deform, "--speed", command.speed, "of the script", 0.001, 1000.0)->capture_default_str();
  deform->add_flag("--once", command.once, "stop at the end of a script that loops");
  bounded(*deform, "--duration", command.duration_s, "stop after so many seconds", 1e-3, kMaxSeconds);
  deform->add_option("--frames", command.frames, "stop after so many poses")->check(positive());
  deform->add_option("--json", command.json, "write a report at the end")->check(output_path(check_output_file));
}

void add_evaluate_command(CLI::App& app, Settings& s) {
  EvaluateCommand& command = s.evaluate;
  CLI::App* evaluate = app.add_subcommand(
      "evaluate", "State error and bit rate of a clip, without a network; lists are tried in all combinations");
  runs(*evaluate, s, command, kEvaluateExamples);
  add_clip_options(*evaluate, command.source);
  add_basis_options(*evaluate, command.bases, command.ranks, command.source);
  add_asset_options(*evaluate, command.source);
  CLI::Option* error = add_codec_options(*evaluate, command.codec, command.errors);
  evaluate
      ->add_option("--step", command.steps,
                   "instead of --error: what one step of a coefficient moves the surface by, of the diagonal")
      ->check(positive())
      ->delimiter(',')
      ->excludes(error);
  evaluate->option_defaults()->group(kOwnGroup);
  bounded(*evaluate, "--lod", command.levels, "levels of detail: fractions of the vertices", 0.0, 1.0)
      ->delimiter(',')
      ->capture_default_str();
  bounded(*evaluate, "--rate", command.rate_hz, "poses a second, for kbit/s", 0.1, 1000.0)->capture_default_str();
  CLI::Option* again =
      evaluate->add_flag("--again", command.again, "code the clip again, with a memory of its first pass");
  bounded(*evaluate, "--warp", command.again_options.warp, "speed of the passes after the first", 0.1, 10.0)
      ->capture_default_str()
      ->needs(again);
  bounded(*evaluate, "--noise", command.again_options.noise,
          "by how much their poses differ: rms over the surface, anew at each pose, of the diagonal", 0.0, 1.0)
      ->capture_default_str()
      ->needs(again);
  bounded(*evaluate, "--passes", command.again_options.passes, "how often the clip is played, the first time counted",
          2u, 10'000u)
      ->capture_default_str()
      ->needs(again);
  evaluate
      ->add_flag("--sweep", command.sweep,
                 "print the curve of bits and error that the rank is chosen from (tools/plot_evaluation.py draws it of "
                 "the report)")
      ->excludes(evaluate->get_option("--rank"));
  evaluate->get_option("--bitrate")->excludes(evaluate->get_option("--rank"));
  bounded(*evaluate, "--loop", command.loop_s,
          "play the clip in a loop for so many seconds, with a memory that is kept as live", 1.0, 86'400.0);
  bounded(
      *evaluate, "--learn", command.learn_s,
      "learn columns that the basis misses from so many seconds at the start; judge the rest, and what --again plays",
      0.1, 60.0);
  evaluate->add_option("--json", command.json, "write a report")->check(output_path(check_output_file));
}

void add_commands(CLI::App& app, Settings& s) {
  CLI::App* bake = app.add_subcommand("bake", "Turn a surface into a streamable asset (cached by content)");
  runs(*bake, s, s.bake, kBakeExamples);
  add_source_options(*bake, s.bake.source);
  bake->get_option("--bitrate")->excludes(bake->get_option("--rank"));
  bake->option_defaults()->group(kOwnGroup);
  bake->add_option("-o,--out", s.bake.out_dir, "copy the asset's objects into this folder")
      ->check(output_path(check_output_folder));
  bake->add_option("--json", s.bake.json, "write a report")->check(output_path(check_output_file));

  CLI::App* play = app.add_subcommand("play", "Stream an animation to a broker");
  runs(*play, s, s.play, kPlayExamples);
  add_source_options(*play, s.play.source);
  add_target_options(*play, s.play.target);
  add_coding_options(*play, s.play.target);
  play->option_defaults()->group(kOwnGroup);
  bounded(*play, "--rate", s.play.rate_hz, "key poses a second (default: the clip's)", 0.1, 1000.0);
  bounded(*play, "--speed", s.play.speed, "of the motion", 0.001, 1000.0)->capture_default_str();
  play->add_flag("--velocities", s.play.velocities,
                 "send the motion's velocities as well, for viewers with scheme=hermite (built-in motions state them)");
  CLI::Option* once = play->add_flag("--once", s.play.once, "stop at the end of the clip");
  play->add_flag("--loop", s.loop, "start again at the end of the clip (default)")->excludes(once);
  bounded(*play, "--duration", s.play.duration_s, "stop after so many seconds, counted from the first try to connect",
          1e-3, kMaxSeconds);
  play->add_option("--frames", s.play.frames, "stop after so many poses")->check(positive());
  play->add_flag("--wait", s.play.source.waits,
                 "begin with all of the basis (default: with a coarse one while it is baked)");
  play->add_option("--json", s.play.json, "write a report at the end")->check(output_path(check_output_file));
  play->add_option("--record", s.play.record, "write capture time and frame of each pose, as JSON lines")
      ->check(output_path(check_output_file));

  CLI::App* pipe =
      app.add_subcommand("pipe", "Stream poses from standard input: 32-bit floats x, y, z for each vertex of the mesh");
  runs(*pipe, s, s.pipe, kPipeExamples);
  pipe->add_option("--mesh", s.pipe.source.input, "the mesh in its rest pose")->required();
  add_bake_options(*pipe, s.pipe.source);
  add_target_options(*pipe, s.pipe.target);
  add_coding_options(*pipe, s.pipe.target);
  pipe->option_defaults()->group(kOwnGroup);
  bounded(*pipe, "--rate", s.pipe.rate_hz, "poses a second (default: as they arrive, or at the times they state)", 0.1,
          1000.0);
  pipe->add_flag("--wait", s.pipe.source.waits,
                 "begin with all of the basis (default: with a coarse one while it is baked)");
  pipe->add_option("--json", s.pipe.json, "write a report at the end")->check(output_path(check_output_file));

  add_deform_command(app, s);

  CLI::App* export_clip = app.add_subcommand("export", "Write a clip in another format");
  runs(*export_clip, s, s.export_clip, kExportExamples);
  add_clip_options(*export_clip, s.export_clip.source);
  s.export_clip.source.cache_dir = default_cache_dir();
  export_clip->option_defaults()->group(kOwnGroup);
  export_clip
      ->add_option("--to", s.export_clip.to,
                   "x.html (a page that plays it, in one file), x.ecrec (a recording), x.glb (morph targets), x.usda, "
                   "x.pc2, x.mdd, x.npy (rest pose beside it as x.obj), x.obj, x.ply, x.off "
                   "(a file a pose) or folder/")
      ->required()
      ->check(output_path([](const std::string& path) -> Result<void> {
        if (path.ends_with(".html") || is_recording(path)) return check_output_file(path);
        const auto good = check_clip_path(path);
        return good || good.error().code != ErrorCode::kUnsupported
                   ? good
                   : fail(ErrorCode::kUnsupported, good.error().message + ", and pages (html) and recordings (ecrec)");
      }));
  bounded(*export_clip, "--from", s.export_clip.part.from_s, "begin so many seconds into the clip", 0.0, kMaxSeconds);
  bounded(*export_clip, "--duration", s.export_clip.part.duration_s, "write so many seconds (default: to the end)",
          1e-3, kMaxSeconds);
  bounded(*export_clip, "--rate", s.export_clip.part.rate_hz, "poses a second (default: the clip's)", 0.1, 1000.0);
  bounded(*export_clip, "--level", s.export_clip.part.level, "part of the vertices (default: 1)", 1e-6, 1.0);
  bounded(*export_clip, "--targets", s.export_clip.targets,
          "morph targets of a .glb (default: the fewest that move no vertex by over 1e-4 of the diagonal)", 1, 512);
  export_clip->add_flag("--force", s.export_clip.force,
                        "write into a folder that holds files, and over files that are there (recordings never)");
  export_clip->add_option("--json", s.export_clip.json, "write a report")->check(output_path(check_output_file));

  add_evaluate_command(app, s);

  CLI::App* replay = app.add_subcommand("replay", "Stream a recording of the broker again");
  runs(*replay, s, s.replay, kReplayExamples);
  replay->add_option("file", s.replay.file, "recording (.ecrec)")->required();
  add_target_options(*replay, s.replay.target);
  replay->option_defaults()->group(kOwnGroup);
  bounded(*replay, "--speed", s.replay.speed, "of the motion", 0.001, 1000.0)->capture_default_str();
  bounded(*replay, "--from", s.replay.from_s, "begin so many seconds into the recording", 0.0, kMaxSeconds);
  bounded(*replay, "--duration", s.replay.duration_s, "play so many seconds of the recording", 1e-3, kMaxSeconds);
  replay->add_flag("--loop", s.replay.loop, "begin again at the end");
  replay->add_option("--asset", s.replay.asset_dir, "folder with the asset's objects (bake --out)");
  replay->add_option("--json", s.replay.json, "write a report at the end")->check(output_path(check_output_file));

  CLI::App* info = app.add_subcommand("info", "What a recording holds");
  runs(*info, s, s.info, kInfoExamples);
  info->add_option("file", s.info.file, "recording (.ecrec)")->required();
  info->add_option("--thumbnail", s.info.thumbnail, "draw the pose in its middle into this PNG")
      ->check(output_path(check_output_file));
  info->add_option("--json", s.info.json, "as JSON, there; - for standard output")
      ->check(output_path(check_output_file));

  CLI::App* cut = app.add_subcommand("cut", "Copy a range of recordings, joined; coded again only at another rate");
  runs(*cut, s, s.cut, kCutExamples);
  cut->add_option("files", s.cut.files, "recordings (.ecrec), in order")->required();
  cut->add_option("--to", s.cut.to, "the new recording")->required()->check(output_path(check_output_file));
  bounded(*cut, "--from", s.cut.from_s, "begin so many seconds into them, at the checkpoint before", 0.0, kMaxSeconds);
  bounded(*cut, "--duration", s.cut.duration_s, "so many seconds (default: to the end)", 1e-3, kMaxSeconds);
  bounded(*cut, "--rate", s.cut.rate_hz, "keep about so many poses a second, coded again (default: all)", 0.01, 1000.0);

  add_context_commands(app, s);
  add_completion_command(app, s);
}

/// What an input is, as far as its name and a look at its folder say.
enum Of : unsigned { kShape = 1, kRecording = 2, kScene = 4, kArray = 8, kCache = 16, kMesh = 32, kSeveral = 64 };
constexpr unsigned kAnyInput = 127;

unsigned kind_of_name(const std::string& name) {
  if (is_recording(name)) return kRecording;
  const auto kind = kind_of_file(name);
  if (!kind) return 0;
  return *kind == FileKind::kMesh         ? kMesh
         : *kind == FileKind::kArray      ? kArray
         : *kind == FileKind::kPointCache ? kCache
                                          : kScene;
}

unsigned kind_of_input(const std::string& input) {
  std::error_code ignored;
  if (input.empty()) return kAnyInput;
  if (std::filesystem::is_directory(input, ignored)) {
    unsigned kinds = kSeveral;
    for (const auto& entry : std::filesystem::directory_iterator(input, ignored))
      kinds |= kind_of_name(entry.path().filename().string()) & ~unsigned{kMesh};
    return kinds;
  }
  if (input.find_first_of("*?[") != std::string::npos) return kSeveral | (kind_of_name(input) & ~unsigned{kMesh});
  const bool is_word = input.find_first_of("/.") == std::string::npos && !std::filesystem::exists(input, ignored);
  if (is_word) return kShape;
  const unsigned kind = kind_of_name(input);
  return kind == 0 ? kAnyInput : kind;
}

/// An option that would do nothing where it stands.
Result<void> check_uses(const CLI::App& app) {
  const CLI::App* command = app.get_subcommands().front();
  const auto text_of = [&](const char* name) {
    const CLI::Option* option = command->get_option_no_throw(name);
    return option != nullptr && option->count() > 0 ? option->as<std::string>() : std::string();
  };
  const unsigned input = kind_of_input(text_of("input"));
  const auto is_none_of = [&](unsigned kinds) { return (input & kinds) == 0; };
  const bool has_poses = !text_of("--poses").empty();
  const CLI::Option* basis = command->get_option_no_throw("--basis");
  const std::vector<std::string> bases = basis == nullptr ? std::vector<std::string>() : basis->reduced_results();
  const bool solves = bases.empty() || std::any_of(bases.begin(), bases.end(), [](const std::string& name) {
                        return name == name_of(BasisKind::kAugmented) || name == name_of(BasisKind::kHarmonic);
                      });
  const std::string codec = text_of("--codec");
  const struct {
    std::vector<const char*> options;
    bool useless;
    const char* why;
  } uses[] = {
      {{"--speed", "--once"},
       command == app.get_subcommand("deform") && text_of("--script").empty(),
       "goes with --script"},
      {{"--error", "--step"},
       !codec.empty() && codec != "quantised",
       "is for --codec quantised; the others keep their numbers' precision"},
      {{"--memory"},
       !codec.empty() && codec != "quantised" && text_of("--memory") != "off",
       "is for --codec quantised"},
      {{"--learn"}, !codec.empty() && codec != "quantised" && text_of("--learn") != "off", "is for --codec quantised"},
      {{"--rest"}, is_none_of(kArray | kCache | kMesh | kSeveral), "is for vertex caches and files of poses"},
      {{"--animation"}, is_none_of(kScene), "is for glTF files"},
      {{"--sample-rate"}, is_none_of(kScene | kRecording), "is for glTF files and recordings"},
      {{"--faces"}, is_none_of(kArray), "is for .npy clips"},
      {{"--any-order"},
       !has_poses && is_none_of(kRecording | kScene | kArray | kCache | kSeveral),
       "is for poses that are read; here are none"},
      {{"--solver"}, !solves, "is for --basis augmented and harmonic"},
      {{"--targets"}, !text_of("--to").ends_with(".glb"), "is for .glb files"}};
  for (const auto& use : uses) {
    for (const char* name : use.options) {
      const CLI::Option* option = command->get_option_no_throw(name);
      if (use.useless && option != nullptr && option->count() > 0)
        return fail(ErrorCode::kInvalidArgument, std::string(name) + " " + use.why);
    }
  }
  return {};
}

Result<void> check_together(const CLI::App& app, const Settings& s) {
  const CLI::App* command = app.get_subcommands().front();
  if (const auto used = check_uses(app); !used) return used;
  if (command->get_option_no_throw("--cage") == nullptr) return {};
  const bool deforms = command == app.get_subcommand("deform");
  const std::vector<std::string> bases = command->get_option("--basis")->reduced_results();
  const bool is_cage = std::find(bases.begin(), bases.end(), name_of(BasisKind::kCage)) != bases.end();
  if (is_cage && deforms && !s.deform.handles.empty())
    return fail(ErrorCode::kInvalidArgument, "--handles moves the model without a cage: take another --basis");
  if (is_cage || deforms) return {};
  for (const char* option : {"--cage", "--cage-resolution", "--coordinates"}) {
    if (command->get_option(option)->count() > 0)
      return fail(ErrorCode::kInvalidArgument, std::string(option) + " goes with --basis cage");
  }
  return {};
}

/// Without a context a stream's name is meant of this machine's broker.
void name_broker(std::string& to, const std::string& context, const Contexts& contexts) {
  if (!to.empty() && context.empty() && contexts.find("") == nullptr && to.find('/') == std::string::npos &&
      check_stream_name(to))
    to = "ws://127.0.0.1:7490/" + to;
}

/// Certificates, for brokers of which none has TLS.
Result<void> check_tls(const CLI::App& command, const std::vector<std::string>& urls) {
  const auto is_tls = [](const std::string& text) {
    const auto url = parse_broker_url(text);
    return !url || url->tls;
  };
  const auto has = [&](const char* name) { return command.get_option(name)->count() > 0; };
  for (const char* name : {"--ca", "--cert", "--key", "--insecure"}) {
    if (has(name) && std::none_of(urls.begin(), urls.end(), is_tls))
      return fail(ErrorCode::kInvalidArgument, std::string(name) + " is for https://; http:// has no certificates");
  }
  if (has("--cert") != has("--key")) return fail(ErrorCode::kInvalidArgument, "--cert and --key go together");
  return {};
}

Result<void> resolve_targets(const CLI::App& app, Settings& s) {
  TargetOptions* target = app.got_subcommand("play")     ? &s.play.target
                          : app.got_subcommand("pipe")   ? &s.pipe.target
                          : app.got_subcommand("deform") ? &s.deform.target
                          : app.got_subcommand("replay") ? &s.replay.target
                                                         : nullptr;
  s.play.target.bitrate_kbit = s.play.source.bitrate_kbit;
  s.pipe.target.bitrate_kbit = s.pipe.source.bitrate_kbit;
  s.deform.target.bitrate_kbit = s.deform.source.bitrate_kbit;
  if (target == nullptr) return {};
  const auto contexts = Contexts::load(Contexts::default_path());
  if (!contexts) return contexts.error();
  const Credentials given = target->credentials;
  const Context* context = contexts->find(target->context);
  if (target->url.empty() && (context != nullptr || target->context.empty())) {
    target->url = unnamed_target(app.got_subcommand("play")     ? s.play.source.input
                                 : app.got_subcommand("pipe")   ? s.pipe.source.input
                                 : app.got_subcommand("deform") ? s.deform.source.input
                                                                : s.replay.file,
                                 context);
  }
  name_broker(target->url, target->context, *contexts);
  const auto resolved = resolve_target(target->url, given, target->context, *contexts);
  if (!resolved) return resolved.error();
  target->url = resolved->url;
  target->credentials = resolved->credentials;
  std::vector<std::string> urls{resolved->url};
  for (TargetOptions& other : s.deform.watch) {
    name_broker(other.url, target->context, *contexts);
    const auto watched = resolve_beside(*resolved, other.url, given, target->context, *contexts);
    if (!watched) return watched.error();
    if (const auto url = parse_broker_url(watched->url); !url) return url.error();
    other.url = watched->url;
    other.credentials = watched->credentials;
    urls.push_back(watched->url);
  }
  return check_tls(*app.get_subcommands().front(), urls);
}

/// Empty: it is one, or an option.
std::string refusal_of_command(CLI::App& app, int argc, char** argv) {
  if (argc < 2 || *argv[1] == '-') return {};
  std::string names;
  for (const CLI::App* command : app.get_subcommands({})) {
    if (command->get_name() == argv[1]) return {};
    names += (names.empty() ? "" : ", ") + command->get_name();
  }
  return "unknown command \"" + std::string(argv[1]) + "\"; there are " + names;
}

}  // namespace

std::string unnamed_target(const std::string& input, const Context* context) {
  if (context != nullptr) {
    const auto url = parse_broker_url(context->url);
    if (!url || !url->stream.empty()) return {};
  }
  std::filesystem::path path(input);
  if (!path.has_filename()) path = path.parent_path();
  std::string name = path.stem().string();
  for (char& c : name) {
    const bool plain =
        (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
    if (!plain) c = '-';
  }
  if (!check_stream_name(name)) name = "stream";
  return context != nullptr ? name : "ws://127.0.0.1:7490/" + name;
}

Invocation parse_command_line(int argc, char** argv) {
  auto settings = std::make_shared<Settings>();
  auto app = std::make_shared<CLI::App>(
      "Bakes deforming surfaces into streamable assets and streams their motion to a broker.", "eigencast-sender");
  app->footer(std::string("examples:\n") + kExamples + "\nexit status:\n" + kExitStatus);
  add_help_all(*app);
  app->set_version_flag("--version", "eigencast-sender " EIGENCAST_VERSION "\nreads: " + readable_endings());
  app->add_flag("-v,--verbose", settings->verbose, "log more");
  app->add_flag("--no-progress", settings->no_progress, "no progress on standard error");
  app->require_subcommand(1);
  app->fallthrough();
  add_commands(*app, *settings);
  if (const std::string refusal = refusal_of_command(*app, argc, argv); !refusal.empty()) {
    std::fprintf(stderr, "%s\n", refusal.c_str());
    return {{}, kExitUsage, false};
  }
  try {
    app->parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return {{}, app->exit(error) == 0 ? kExitOk : kExitUsage, false};
  }
  settings->console.progress = !settings->no_progress && isatty(STDERR_FILENO) == 1;
  const std::string fault = fault_of_numbers(*app);
  auto usable = fault.empty() ? check_together(*app, *settings) : fail(ErrorCode::kInvalidArgument, fault);
  if (usable) usable = resolve_targets(*app, *settings);
  if (!usable) {
    std::fprintf(stderr, "%s\n", usable.error().message.c_str());
    return {{}, kExitUsage, false};
  }
  return {[app, settings](Interrupt& interrupt) { return settings->run(interrupt); }, kExitOk, settings->verbose};
}

}  // namespace eigencast
