// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "client/film_plan.h"
#include "client/level_control.h"
#include "client/scene_file.h"
#include "common/command_line/command_line.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "sdk/contexts.h"
#include "view/rebuild.h"
#include "view/style.h"

namespace eigencast {

struct ClientOptions {
  SceneDescription scene;                ///< With resolved streams; none: see `home`.
  std::vector<Credentials> credentials;  ///< One for each stream.
  Target home;                           ///< Without streams: the broker whose one live stream is meant.
  bool list = false;                     ///< List the streams of `home` instead.
  std::optional<Profile> profile;        ///< Default: the URL's query.
  SceneOptions view_options;
  LevelSettings levels;
  RebuildOn reconstruct = RebuildOn::kAuto;
  bool follow_display = false;  ///< target_fps follows the display.
  std::string sync;             ///< Group of viewers that show the same moment; empty: none.
  std::string room, person;     ///< Empty room: none.
  double ago_s = 0, speed = 1;  ///< Begins so long ago and goes on at that speed, 0: paused; 0 s: live.
  std::string camera_path;      ///< Empty: the user moves the camera.
  std::string view = "iso";
  Style style;
  int width = 1280, height = 720;
  bool headless = false, hud = false;
  std::uint64_t frames = 0;  ///< 0: no limit
  bool first = false;        ///< Headless: pictures before the whole surface has come count.
  double duration_s = 0;     ///< 0: no limit
  double wait_s = 30;        ///< Headless: how long to wait before the first picture while nothing comes, or for a
                             ///< sender that is gone before the last of `frames`.
  std::string out, json, record, record_shown, screenshot;
  bool watch = false;   ///< Changed files are read again.
  std::string compare;  ///< A stream or clip:, whose difference the colours show; may be empty.
  Credentials compare_credentials;
  std::string truth;     ///< The clip that the streams play; may be empty.
  std::string settings;  ///< File; empty: the window remembers nothing.
  // The command line overrides what the window remembers.
  bool style_given = false, size_given = false, resolver_given = false, playout_given = false;
  bool verbose = false;
  double ui_scale = 0;              ///< For texts and panels; 0: the display's.
  double turntable_s = 0;           ///< Time of a turn of the camera around the scene; 0: it does not turn.
  std::optional<FilmOptions> film;  ///< Headless.
  std::string cache_dir;
  double memory_mb = 0;  ///< For what brokers send; 0: three quarters of what is free.
};

enum ExitCode : int {
  kExitGood = 0,
  kExitFailed = 1,
  kExitUsage = 2,
  kExitNoStream = 4,
  kExitStopped = 128,  ///< And the signal's number.
};

/// Prints help to stdout and usage errors to stderr.
std::variant<ClientOptions, ExitNow> options_from_command_line(int argc, const char* const* argv);

}  // namespace eigencast
