// SPDX-License-Identifier: MIT
#include "sender/command_line.h"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdlib>

#include "sdk/asset_cache.h"

namespace eigencast {
namespace {

constexpr const char* kExamples = R"(examples:
  eigencast-sender play heart --to ws://localhost:7490/demo
  eigencast-sender play clip.npy --to ws://broker/live/clip --rate 15     (n poses a second; the broker triples them)
  eigencast-sender play 'frames/*.obj' --once --to ws://broker/show
  eigencast-sender bake scan.ply --rank 300
  eigencast-sender evaluate clip.npy                                      (error and bit rate, without a network)
exit status: 0 done, 1 failed, 2 wrong usage)";

/// Everything the options write to; lives as long as the invocation.
struct Settings {
  Console console;
  bool no_progress = false;
  bool verbose = false;
  bool loop = false;
  BakeCommand bake;
  PlayCommand play;
  ExportCommand export_clip;
  EvaluateCommand evaluate;
  CompareCommand compare;
};

void add_clip_options(CLI::App& app, SourceOptions& source) {
  app.add_option(
         "input", source.input,
         "built-in shape (heart, bar, torus, sphere, ...), clip.npy, .pc2, .mdd, .glb or .gltf, folder or 'glob' of "
         "OBJ/PLY/OFF/STL/XYZ, or one file")
      ->required();
  app.add_option("--rest", source.rest, "file of the rest pose (default: beside the clip, or its first frame)");
  app.add_option("--faces", source.faces, "faces of a .npy clip (default: faces.npy beside it)");
  app.add_option("--animation", source.animation, "name or number of a glTF file's animation (default: the first)");
  app.add_option("--sample-rate", source.sample_rate_hz, "poses a second that a glTF animation is sampled at")
      ->check(CLI::Range(0.1, 1000.0))
      ->capture_default_str();
}

void add_source_options(CLI::App& app, SourceOptions& source) {
  source.cache_dir = default_cache_dir();
  add_clip_options(app, source);
  app.add_option("--basis", source.basis, "augmented or harmonic")
      ->check(CLI::IsMember({"augmented", "harmonic"}))
      ->capture_default_str();
  app.add_option("--rank", source.rank, "coefficients per axis")->check(CLI::Range(4, 4096))->capture_default_str();
  app.add_option("--name", source.name, "name of the surface, for people");
  app.add_option("--cache", source.cache_dir, "folder where bakes are kept; '' for none")->capture_default_str();
}

void add_codec_options(CLI::App& app, std::string& codec, double& error) {
  app.add_option("--codec", codec, "quantised, float32 or float64")
      ->check(CLI::IsMember({"quantised", "float32", "float64"}))
      ->capture_default_str();
  app.add_option("--error", error,
                 "vertex error that quantising may add, in model units (default: 1e-3 of the diagonal)")
      ->check(CLI::PositiveNumber);
}

void add_commands(CLI::App& app, Settings& s) {
  CLI::App* bake = app.add_subcommand("bake", "Turn a surface into a streamable asset (cached by content)");
  add_source_options(*bake, s.bake.source);
  bake->add_option("-o,--out", s.bake.out_dir, "copy the asset's objects into this folder");
  bake->add_option("--json", s.bake.json, "write a report");

  CLI::App* play = app.add_subcommand("play", "Stream an animation to a broker");
  add_source_options(*play, s.play.source);
  add_codec_options(*play, s.play.target.codec, s.play.target.error);
  play->add_option("--to", s.play.target.url, "ws://host[:port]/stream")->envname("EIGENCAST_URL")->required();
  play->add_option("--rate", s.play.rate_hz, "key poses a second (default: the clip's)")
      ->check(CLI::Range(0.1, 1000.0));
  play->add_option("--speed", s.play.speed, "of the motion")->check(CLI::Range(0.001, 1000.0))->capture_default_str();
  CLI::Option* once = play->add_flag("--once", s.play.once, "stop at the end of the clip");
  play->add_flag("--loop", s.loop, "start again at the end of the clip (default)")->excludes(once);
  play->add_option("--duration", s.play.duration_s, "stop after so many seconds, counted from the first try to connect")
      ->check(CLI::PositiveNumber);
  play->add_option("--frames", s.play.frames, "stop after so many poses")->check(CLI::PositiveNumber);
  play->add_option("--json", s.play.json, "write a report at the end");
  play->add_option("--record", s.play.record, "write capture time and frame of each pose, as JSON lines");

  CLI::App* export_clip = app.add_subcommand("export", "Write a clip in another format");
  add_clip_options(*export_clip, s.export_clip.source);
  export_clip
      ->add_option("--to", s.export_clip.to,
                   "x.pc2, x.mdd, x.npy (rest pose beside it as x.obj), x.obj, x.ply, x.off (a file a pose) or folder/")
      ->required();
  export_clip->add_option("--json", s.export_clip.json, "write a report");

  CLI::App* evaluate = app.add_subcommand("evaluate", "State error and bit rate of a clip, without a network");
  add_source_options(*evaluate, s.evaluate.source);
  add_codec_options(*evaluate, s.evaluate.codec, s.evaluate.error);
  evaluate->add_option("--rate", s.evaluate.rate_hz, "poses a second, for kbit/s")
      ->check(CLI::Range(0.1, 1000.0))
      ->capture_default_str();
  evaluate->add_option("--json", s.evaluate.json, "write a report");

  CLI::App* compare = app.add_subcommand("compare", "Compare poses that a client recorded with the clip that was sent");
  add_source_options(*compare, s.compare.source);
  compare->add_option("--sent", s.compare.sent, "record of the sender (play --record)")->required();
  compare->add_option("--received", s.compare.received, "record of the client (eigencast-client --record)")->required();
  compare->add_option("--report", s.compare.report, "JSON file to add the result to");
}

}  // namespace

Invocation parse_command_line(int argc, char** argv) {
  auto settings = std::make_shared<Settings>();
  CLI::App app("Bakes deforming surfaces into streamable assets and streams their motion to a broker.",
               "eigencast-sender");
  app.footer(kExamples);
  app.set_version_flag("--version", "eigencast-sender " EIGENCAST_VERSION);
  app.add_flag("-v,--verbose", settings->verbose, "log more");
  app.add_flag("--no-progress", settings->no_progress, "no progress on standard error");
  app.require_subcommand(1);
  app.fallthrough();
  add_commands(app, *settings);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return {{}, app.exit(error) == 0 ? kExitOk : kExitUsage, false};
  }
  settings->console.progress = !settings->no_progress;
  settings->console.on_terminal = isatty(STDERR_FILENO) == 1;
  const std::string command = app.get_subcommands().front()->get_name();
  return {[settings, command](Interrupt& interrupt) {
            if (command == "bake") return run(settings->bake, settings->console, interrupt);
            if (command == "play") return run(settings->play, settings->console, interrupt);
            if (command == "export") return run(settings->export_clip, settings->console, interrupt);
            if (command == "evaluate") return run(settings->evaluate, settings->console, interrupt);
            return run(settings->compare, settings->console, interrupt);
          },
          kExitOk, settings->verbose};
}

}  // namespace eigencast
