// SPDX-License-Identifier: MIT
#include "client/viewer_state.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <system_error>
#include <utility>

#include "common/core/text.h"

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

void change_smoothness(PlayoutSettings& playout, double by) {
  if (playout.mode == PlayoutMode::kLatest) return;
  playout.smoothness = std::clamp(Playout(playout).smoothness() + by, 0.0, 1.0);
  playout.delay_us = 0;
}

constexpr std::array<const char*, 3> kPlayoutTexts{"as they come", "interpolated here", "estimated here"};

std::string text_from_smoothness(const PlayoutSettings& playout) {
  if (playout.mode == PlayoutMode::kLatest) return "";
  char percent[16];
  std::snprintf(percent, sizeof percent, "%.3g %%", 100 * Playout(playout).smoothness());
  return percent;
}

constexpr std::array<std::pair<Action, bool Style::*>, 6> kStyleSwitches{{{Action::kAxes, &Style::axes},
                                                                          {Action::kGrid, &Style::grid},
                                                                          {Action::kEdges, &Style::edges},
                                                                          {Action::kWireframe, &Style::wireframe},
                                                                          {Action::kPoints, &Style::points},
                                                                          {Action::kLegend, &Style::legend}}};
constexpr std::array<std::pair<Action, bool ViewerState::*>, 6> kSwitches{
    {{Action::kHelp, &ViewerState::help},
     {Action::kHud, &ViewerState::hud},
     {Action::kPanel, &ViewerState::panel},
     {Action::kTurntable, &ViewerState::turntable},
     {Action::kRecord, &ViewerState::recording},
     {Action::kPause, &ViewerState::paused}}};
constexpr std::array<std::pair<Action, bool ViewerState::*>, 6> kRequests{
    {{Action::kScreenshot, &ViewerState::screenshot_wanted},
     {Action::kCleanScreenshot, &ViewerState::clean_screenshot_wanted},
     {Action::kCopyCamera, &ViewerState::copy_wanted},
     {Action::kPaste, &ViewerState::paste_wanted},
     {Action::kResolver, &ViewerState::resolver_wanted},
     {Action::kQuit, &ViewerState::quit}}};

}  // namespace

void ViewerState::apply(Action action, Camera& camera, LevelOfDetail& lod) {
  for (const auto& [on, member] : kStyleSwitches) {
    if (on == action) style.*member = !(style.*member);
  }
  for (const auto& [on, member] : kSwitches) {
    if (on == action) this->*member = !(this->*member);
  }
  for (const auto& [on, member] : kRequests) {
    if (on == action) this->*member = true;
  }
  switch (action) {
    case Action::kResetCamera:
      return camera.home();
    case Action::kColouring:
      ++colourings_on;
      return;
    case Action::kColourMap:
      style.colour_map = next_of(style.colour_map, kColourMaps);
      return;
    case Action::kFiner:
      return lod.finer();
    case Action::kCoarser:
      return lod.coarser();
    case Action::kPlayout:
      playout.mode = next_of(playout.mode, 3);
      playout.smoothness.reset();
      playout.delay_us = 0;
      return;
    case Action::kSmoother:
      return change_smoothness(playout, kSmoothnessStep);
    case Action::kMoreLive:
      return change_smoothness(playout, -kSmoothnessStep);
    case Action::kUpAxis:
      return camera.set_up(next_of(camera.up(), 3));
    default:
      return;
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
          {"A", "what lowers it to hold the rate", std::string(name_of(resolver))},
          {"Space", "pause", on_off(state.paused)},
          {"M", "motion between arrivals", kPlayoutTexts[static_cast<std::size_t>(state.playout.mode)]},
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

std::string next_free_name(const std::string& prefix, const std::string& ending) {
  for (int number = 1; number < 10'000; ++number) {
    char digits[16];
    std::snprintf(digits, sizeof digits, "_%04d", number);
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
