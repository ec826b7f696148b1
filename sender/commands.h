// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/codec/key.h"
#include "common/net/url.h"
#include "sdk/contexts.h"
#include "sdk/publisher.h"
#include "sender/clip_part.h"
#include "sender/console.h"
#include "sender/evaluate.h"
#include "sender/source.h"

namespace eigencast {

struct BakeCommand {
  SourceOptions source;
  std::string out_dir;  ///< Copy the asset's objects there, each under its hash; empty: only into the cache.
  std::string json;     ///< Write a report there; empty: no.
};

struct TargetOptions {
  std::string url;  ///< Before resolve(): what --to says.
  Credentials credentials;
  std::string context;  ///< Empty: the current one.
  std::string codec = "quantised";
  double error = 0;                     ///< Model units; 0: the publisher's default.
  double bitrate_kbit = 0;              ///< As of SourceOptions; 0: as the error bound takes.
  MemoryUse memory = MemoryUse::kAuto;  ///< Of float codecs: none.
  LearnUse learn = LearnUse::kOff;      ///< Likewise. Of play and pipe.
  double still_s = 0;                   ///< Heartbeat of still surfaces; 0: every pose is sent.
};

struct PlayCommand {
  SourceOptions source;
  TargetOptions target;
  double rate_hz = 0;  ///< 0: the clip's own.
  double speed = 1;
  bool velocities = false;  ///< Send those that the clip states beside its poses.
  bool once = false;
  double duration_s = 0;     ///< 0: no end.
  std::uint64_t frames = 0;  ///< 0: no end.
  std::string json;
  std::string record;  ///< JSON lines: capture time, frame and outcome of each pose; empty: no.
};

struct PipeCommand {
  SourceOptions source;  ///< The mesh.
  TargetOptions target;
  double rate_hz = 0;  ///< 0: as poses arrive, or at the times they state.
  std::string json;
};

struct DeformCommand {
  SourceOptions source;  ///< The model.
  TargetOptions target;
  std::string cage_out;  ///< Write the cage there; empty: no.
  std::string handles;   ///< JSON file: no cage, but handles, as rigid as possible.
  std::string script;    ///< JSON file, or twist, bend, both; empty: by hand, in a window.
  double rate_hz = 0;    ///< 0: 30 of a script, 60 by hand.
  double speed = 1;
  bool once = false;
  double duration_s = 0;             ///< 0: until the script ends.
  std::uint64_t frames = 0;          ///< 0: no end.
  std::vector<TargetOptions> watch;  ///< Streams of others, shown in the window.
  std::string view = "front";        ///< Sets the window's, see Camera::set_view.
  int width = 1280, height = 800;    ///< The window's.
  std::string json;
};

struct ContextCommand {
  std::string action;  ///< add, list, use, remove
  std::string name, url;
  Credentials credentials;
  bool json = false;
};

struct ExportCommand {
  SourceOptions source;
  ClipPart part;
  std::string to;
  int targets = 0;     ///< Of glTF; 0: the fewest that show all.
  bool force = false;  ///< Into a folder that holds files, too.
  std::string json;
};

struct EvaluateCommand {
  SourceOptions source;                                    ///< But for its basis and rank.
  std::vector<BasisKind> bases = {BasisKind::kAugmented};  ///< All combinations of these are evaluated.
  std::vector<int> ranks = {0};                            ///< As of SourceOptions.
  std::vector<double> levels = {1};                        ///< Fractions of the vertices.
  std::string codec = "quantised";
  std::vector<double> errors;  ///< Model units.
  std::vector<double> steps;   ///< See eps_from_step. Neither: an error of 1e-3 of the diagonal.
  double rate_hz = 30;         ///< For kbit/s.
  bool again = false;          ///< With these:
  AgainOptions again_options;
  bool sweep = false;  ///< Print the curve of error and rate that the rank is chosen of.
  double loop_s = 0;   ///< 0: no loop.
  double learn_s = 0;  ///< 0: it does not learn.
  std::string json;
};

struct InfoCommand {
  std::string file;
  std::string thumbnail;  ///< PNG of the pose in the middle; may be empty.
  std::string json;
};

struct CutCommand {
  std::vector<std::string> files;
  std::string to;
  double from_s = 0;
  double duration_s = 0;  ///< 0: to the end.
  double rate_hz = 0;     ///< 0: all poses.
};

struct ReplayCommand {
  std::string file;
  TargetOptions target;  ///< The codec is the recording's.
  double speed = 1;
  double from_s = 0;      ///< Since the start of the recording.
  double duration_s = 0;  ///< Limits the recording; 0: to its end.
  bool loop = false;
  std::string asset_dir;  ///< Objects by hash (bake --out); empty: those of the recording, or the broker's.
  std::string json;
};

// Each runs a command to its end and returns the program's exit status; errors go to the log.
int run(const BakeCommand& command, const Console& console, Interrupt& interrupt);
int run(const PlayCommand& command, const Console& console, Interrupt& interrupt);
int run(const PipeCommand& command, const Console& console, Interrupt& interrupt);
int run(const DeformCommand& command, const Console& console, Interrupt& interrupt);
int run(const ContextCommand& command, const Console& console, Interrupt& interrupt);
int run(const ExportCommand& command, const Console& console, Interrupt& interrupt);
int run(const EvaluateCommand& command, const Console& console, Interrupt& interrupt);
int run(const ReplayCommand& command, const Console& console, Interrupt& interrupt);
int run(const InfoCommand& command, const Console& console, Interrupt& interrupt);
int run(const CutCommand& command, const Console& console, Interrupt& interrupt);

/// opened: as bake_source().
Result<Source> bake_with_progress(const SourceOptions& options, const Console& console, Interrupt& interrupt,
                                  OpenedSource opened = {});

/// Where a stream goes that is not named: its input's name, at the context's broker or, without one (null), this
/// machine's. Empty: the context names a stream.
std::string unnamed_target(const std::string& input, const Context* context);

/// A command to run, or an exit status at once: help, version, or an error that was printed.
struct Invocation {
  std::function<int(Interrupt&)> run;
  int status = kExitOk;
  bool verbose = false;
};

Invocation parse_command_line(int argc, char** argv);

}  // namespace eigencast
