// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "client/level_control.h"
#include "client/scene_file.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "view/rebuild.h"
#include "view/style.h"

namespace eigencast {

/// What the command line says.
struct ClientOptions {
  SceneDescription
      scene;  ///< Its streams as they were meant: of a context, where a name was given. None: the window welcomes.
  std::vector<Credentials> credentials;  ///< One for each stream.
  std::optional<Profile> profile;        ///< Set if an option asked for it; else the URL's query decides.
  SceneOptions view_options;
  LevelSettings levels;
  RebuildOn reconstruct = RebuildOn::kAuto;
  bool follow_display = false;  ///< The target is the display's own rate.
  std::string camera_path;      ///< File; empty: the user moves the camera.
  std::string view = "iso";
  Style style;
  int width = 1280, height = 720;
  bool headless = false, hud = false;
  std::uint64_t frames = 0;  ///< 0: no limit
  double duration_s = 0;     ///< 0: no limit
  double wait_s = 30;        ///< Headless: how long to wait for the first pose.
  std::string out, json, record, record_shown, screenshot;
  bool watch = false;        ///< Files that change are read again.
  std::string truth;         ///< File of the clip that the streams play; empty: none.
  std::string settings;      ///< File in which the window remembers; empty: it does not.
  bool style_given = false;  ///< The command line says something about `style`, so what is remembered does not count.
  bool size_given = false;   ///< Likewise of width and height,
  bool resolver_given = false;  ///< of who chooses the levels of detail,
  bool playout_given = false;   ///< and of motion between arrivals.
  double ui_scale = 0;          ///< Of texts and panels; 0: as the display says.
  std::uint64_t turntable = 0;  ///< Headless: so many pictures, once round the scene. 0: none.
  std::string cache_dir;
  bool verbose = false;
};

/// Stands for "the process is done": --help or a usage error have been printed.
struct ExitNow {
  int code = 0;
};

/// Exit codes of the program.
enum ExitCode : int { kExitGood = 0, kExitFailed = 1, kExitUsage = 2, kExitNoStream = 4 };

/// Reads the command line; prints help to stdout and usage errors to stderr.
std::variant<ClientOptions, ExitNow> options_from_command_line(int argc, const char* const* argv);

}  // namespace eigencast
