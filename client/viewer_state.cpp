// SPDX-License-Identifier: MIT
#include "client/viewer_state.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <system_error>

namespace eigencast {
namespace {

struct KeyBinding {
  std::string_view key;
  Action action;
  Modifiers modifiers = {};
};
constexpr std::array<KeyBinding, 35> kBindings{{{"R", Action::kResetCamera},
                                                {"Home", Action::kResetCamera},
                                                {"H", Action::kHelp},
                                                {"F1", Action::kHelp},
                                                {"X", Action::kAxes},
                                                {"G", Action::kGrid},
                                                {"E", Action::kEdges},
                                                {"P", Action::kPoints},
                                                {"W", Action::kWireframe},
                                                {"V", Action::kColouring},
                                                {"C", Action::kColourMap},
                                                {"B", Action::kLegend},
                                                {"F", Action::kHud},
                                                {"S", Action::kScreenshot},
                                                {"F12", Action::kScreenshot},
                                                {"+", Action::kFiner},
                                                {"=", Action::kFiner},
                                                {".", Action::kFiner},
                                                {"-", Action::kCoarser},
                                                {",", Action::kCoarser},
                                                {"M", Action::kPlayout},
                                                {"]", Action::kSmoother},
                                                {"[", Action::kMoreLive},
                                                {" ", Action::kPause},
                                                {"U", Action::kUpAxis},
                                                {"A", Action::kResolver},
                                                {"Tab", Action::kPanel},
                                                {"Y", Action::kTurntable},
                                                {"K", Action::kRecord},
                                                {"S", Action::kCleanScreenshot, {true, false}},
                                                {"F12", Action::kCleanScreenshot, {true, false}},
                                                {"C", Action::kCopyCamera, {false, true}},
                                                {"V", Action::kPaste, {false, true}},
                                                {"Escape", Action::kQuit},
                                                {"Q", Action::kQuit}}};

std::string on_off(bool on) {
  return on ? "on" : "off";
}

constexpr double kSmoothnessStep = 0.125;

/// Poses that are shown as they come are held for nothing: there it says nothing.
void change_smoothness(PlayoutSettings& playout, double by) {
  if (playout.mode == PlayoutMode::kLatest) return;
  playout.smoothness = std::clamp(Playout(playout).smoothness() + by, 0.0, 1.0);
  playout.delay_us = 0;
}

std::string text_from_playout(const PlayoutSettings& playout) {
  return playout.mode == PlayoutMode::kLatest        ? "as they come"
         : playout.mode == PlayoutMode::kInterpolate ? "interpolated here"
                                                     : "estimated here";
}

std::string text_from_smoothness(const PlayoutSettings& playout) {
  if (playout.mode == PlayoutMode::kLatest) return "";
  char percent[16];
  std::snprintf(percent, sizeof percent, "%.3g %%", 100 * Playout(playout).smoothness());
  return percent;
}

Camera::Up next_up(Camera::Up up) {
  return up == Camera::Up::kX ? Camera::Up::kY : up == Camera::Up::kY ? Camera::Up::kZ : Camera::Up::kX;
}

}  // namespace

void ViewerState::apply(Action action, Camera& camera, LevelOfDetail& lod) {
  switch (action) {
    case Action::kResetCamera:
      camera.home();
      break;
    case Action::kHelp:
      help = !help;
      break;
    case Action::kAxes:
      style.axes = !style.axes;
      break;
    case Action::kGrid:
      style.grid = !style.grid;
      break;
    case Action::kEdges:
      style.edges = !style.edges;
      break;
    case Action::kWireframe:
      style.wireframe = !style.wireframe;
      break;
    case Action::kColouring:
      ++colourings_on;
      break;
    case Action::kColourMap:
      style.colour_map = next_map(style.colour_map);
      break;
    case Action::kLegend:
      style.legend = !style.legend;
      break;
    case Action::kPoints:
      style.points = !style.points;
      break;
    case Action::kHud:
      hud = !hud;
      break;
    case Action::kScreenshot:
      screenshot_wanted = true;
      break;
    case Action::kCleanScreenshot:
      clean_screenshot_wanted = true;
      break;
    case Action::kPanel:
      panel = !panel;
      break;
    case Action::kTurntable:
      turntable = !turntable;
      break;
    case Action::kRecord:
      recording = !recording;
      break;
    case Action::kCopyCamera:
      copy_wanted = true;
      break;
    case Action::kPaste:
      paste_wanted = true;
      break;
    case Action::kFiner:
      lod.finer();
      break;
    case Action::kCoarser:
      lod.coarser();
      break;
    case Action::kResolver:
      resolver_wanted = true;
      break;
    case Action::kPause:
      paused = !paused;
      break;
    case Action::kPlayout:
      playout.mode = playout.mode == PlayoutMode::kLatest        ? PlayoutMode::kInterpolate
                     : playout.mode == PlayoutMode::kInterpolate ? PlayoutMode::kEstimate
                                                                 : PlayoutMode::kLatest;
      playout.smoothness.reset();
      playout.delay_us = 0;
      break;
    case Action::kSmoother:
      change_smoothness(playout, kSmoothnessStep);
      break;
    case Action::kMoreLive:
      change_smoothness(playout, -kSmoothnessStep);
      break;
    case Action::kUpAxis:
      camera.set_up(next_up(camera.up()));
      break;
    case Action::kQuit:
      quit = true;
      break;
  }
}

std::optional<Action> action_for_key(std::string_view key, const Modifiers& modifiers) {
  const bool shift = modifiers.shift && !modifiers.control && (key == "S" || key == "F12");
  const auto binding = std::find_if(kBindings.begin(), kBindings.end(), [&](const KeyBinding& b) {
    return b.key == key && b.modifiers.control == modifiers.control && b.modifiers.shift == shift;
  });
  if (binding == kBindings.end()) return std::nullopt;
  return binding->action;
}

std::vector<HelpLine> help_lines(const ViewerState& state, const Camera& camera, const LevelOfDetail& lod,
                                 ResolverKind resolver) {
  char percent[16];
  std::snprintf(percent, sizeof percent, "%.3g %%", 100 * lod.fraction());
  const std::string up(1, static_cast<char>('X' + static_cast<int>(camera.up())));
  return {{"left drag", "rotate", ""},
          {"right or middle drag, Shift+left", "pan", ""},
          {"wheel", "zoom to the cursor", ""},
          {"double click", "turn round the point that was hit", ""},
          {"R  Home", "reset the camera", ""},
          {"+ -  . ,", "level of detail, at most", percent},
          {"A", "who lowers it to hold the rate", std::string(name_of(resolver))},
          {"Space", "pause", on_off(state.paused)},
          {"M", "motion between arrivals", text_from_playout(state.playout)},
          {"[ ]", "live to smooth", text_from_smoothness(state.playout)},
          {"V", "what colours say", title_of(state.style.colour)},
          {"C", "colour map", std::string(name_of(state.style.colour_map))},
          {"B", "its legend", on_off(state.style.legend)},
          {"E", "edges", on_off(state.style.edges)},
          {"W", "wireframe", on_off(state.style.wireframe)},
          {"P", "points", on_off(state.style.points)},
          {"G", "ground grid", on_off(state.style.grid)},
          {"X", "axes", on_off(state.style.axes)},
          {"U", "up axis", up},
          {"Tab", "panel: surfaces, style, motion, plots", on_off(state.panel)},
          {"F", "figures", on_off(state.hud)},
          {"S  F12", "screenshot; with Shift without background", ""},
          {"Y", "turntable", on_off(state.turntable)},
          {"K", "write every picture", on_off(state.recording)},
          {"Ctrl+C  Ctrl+V", "copy the camera; paste a camera, a URL or a path", ""},
          {"H  F1", "this help", on_off(state.help)},
          {"Q  Esc", "quit", ""}};
}

ResolverKind next_kind(ResolverKind kind) {
  return kind == ResolverKind::kBudget  ? ResolverKind::kPaper
         : kind == ResolverKind::kPaper ? ResolverKind::kNone
                                        : ResolverKind::kBudget;
}

std::string next_free_name(const std::string& prefix, const std::string& ending) {
  for (int number = 1; number < 10'000; ++number) {
    char digits[16];
    std::snprintf(digits, sizeof digits, "_%04d", number);
    // A folder that cannot be read makes writing fail, which says why.
    std::error_code error;
    const std::string name = prefix + digits + ending;
    if (!std::filesystem::exists(name, error)) return name;
  }
  return prefix + "_9999" + ending;
}

std::string next_screenshot_name(const std::string& prefix) {
  return next_free_name(prefix, ".png");
}

}  // namespace eigencast
