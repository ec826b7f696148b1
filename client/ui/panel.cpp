// SPDX-License-Identifier: MIT
#include "client/ui/panel.h"

#include <imgui.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "client/hud_text.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

bool draw_open_line(const char* hint, const char* button, float button_width, TextField& to_open) {
  ImGui::SetNextItemWidth(-button_width);
  const bool entered =
      ImGui::InputTextWithHint("##open", hint, to_open.data(), to_open.size(), ImGuiInputTextFlags_EnterReturnsTrue);
  ImGui::SameLine();
  return ImGui::Button(button, {-1, 0}) || entered;
}

/// A list as wide as the panel, headed by what it chooses and the present value.
template <typename Values, typename Value, typename Text>
Value chosen_from(const char* id, const std::string& what, const Values& values, Value now, const Text& text_of) {
  ImGui::SetNextItemWidth(-1);
  if (!ImGui::BeginCombo(id, (what + ": " + text_of(now)).c_str())) return now;
  Value chosen = now;
  for (const auto& value : values) {
    if (ImGui::Selectable(text_of(value).c_str(), value == now)) chosen = value;
  }
  ImGui::EndCombo();
  return chosen;
}

constexpr std::array kMaps{ColourMap::kViridis, ColourMap::kCividis, ColourMap::kCoolwarm, ColourMap::kTurbo,
                           ColourMap::kGrey};
static_assert(kMaps.size() == kColourMaps);
constexpr std::array kResolvers{ResolverKind::kBudget, ResolverKind::kPaper, ResolverKind::kNone};

void draw_surfaces(Session& session, UiRequests& requests, TextField& to_open, float scale) {
  auto& instances = session.scene().instances();
  for (std::size_t i = 0; i < instances.size(); ++i) {
    Scene::Instance& instance = instances[i];
    const PoseSource& source = *session.sources()[instance.placement.source];
    ImGui::PushID(static_cast<int>(i));
    ImGui::Checkbox("##shown", &instance.visible);
    ImGui::SameLine();
    ImGui::TextUnformatted(session.name_of_surface(i).c_str());
    const Asset* asset = source.asset();
    const double level = asset == nullptr ? 0
                                          : static_cast<double>(instance.view.geometry().vertex_count()) /
                                                std::max(1U, asset->vertex_count);
    ImGui::TextDisabled("      %s, detail %.2f", std::string(kStateNames[session.state_of_surface(i)]).c_str(), level);
    ImGui::SameLine(ImGui::GetContentRegionAvail().x - 54 * scale);
    if (ImGui::SmallButton("remove")) requests.remove = i;
    ImGui::PopID();
  }
  if (draw_open_line("URL, path or shape", "Add", 58 * scale, to_open)) requests.open = to_open.data();
}

ImVec4 colour_of(const std::string& text) {
  const auto colour = colour_from_text(text);
  return {static_cast<float>(colour[0]) / 255, static_cast<float>(colour[1]) / 255, static_cast<float>(colour[2]) / 255,
          1};
}

void draw_room(RoomDesk& room, std::span<PoseSource* const> sources, ViewerState& view, float scale) {
  const RoomState& state = room.state();
  const RoomState::Member* leader = state.holder_of("lead");
  if (!state.trouble.empty()) ImGui::TextWrapped("%s", state.trouble.c_str());
  for (const auto& [id, member] : state.members) {
    if (!member.here) continue;
    const char* what = &member == leader ? "  leads" : id == state.self ? "  you" : "";
    ImGui::TextColored(colour_of(member.colour), "%s", member.name.c_str());
    ImGui::SameLine();
    ImGui::TextDisabled("%s", what);
  }
  if (leader != nullptr && !room.leads()) {
    bool follows = room.follows();
    if (ImGui::Checkbox("follow (J)", &follows)) follows ? room.follow() : room.stop_following();
  }
  if (!state.speaks) return;
  if (ImGui::Button(room.leads() ? "stop leading (O)" : leader != nullptr ? "take the lead (O)" : "lead (O)"))
    room.lead(!room.leads());
  ImGui::SetNextItemWidth(-1);
  ImGui::InputTextWithHint("##note", "a note; T pins it under the cursor", view.note.data(), view.note.size());
  for (const RoomDesk::Pin& pin : room.pins(sources)) {
    ImGui::PushID((std::to_string(pin.member) + pin.key).c_str());
    ImGui::TextColored(colour_of(state.members.at(pin.member).colour), "%s",
                       pin.note.empty() ? "(no note)" : pin.note.c_str());
    if (pin.removable) ImGui::SameLine(ImGui::GetContentRegionAvail().x - 54 * scale);
    if (pin.removable && ImGui::SmallButton("remove")) room.remove(pin);
    ImGui::PopID();
  }
}

void draw_style(Session& session, Style& style) {
  style.colour = chosen_from("##colours", "colours", colourings_of(session.sources()), style.colour, title_of);
  style.colour_map = chosen_from("##map", "map", kMaps, style.colour_map,
                                 [](ColourMap map) { return std::string(kColourMapNames[map]); });
  if (ImGui::BeginTable("switches", 2)) {
    const std::array<std::pair<const char*, bool*>, 6> switches{{{"edges", &style.edges},
                                                                 {"wireframe", &style.wireframe},
                                                                 {"points", &style.points},
                                                                 {"legend", &style.legend},
                                                                 {"grid", &style.grid},
                                                                 {"axes", &style.axes}}};
    for (const auto& [name, value] : switches) {
      ImGui::TableNextColumn();
      ImGui::Checkbox(name, value);
    }
    ImGui::EndTable();
  }
}

void draw_motion(Session& session, ViewerState& state) {
  constexpr std::array<const char*, 3> kModes{"as poses come", "interpolated here", "estimated here"};
  int mode = static_cast<int>(state.playout.mode);
  ImGui::SetNextItemWidth(-1);
  if (ImGui::Combo("##mode", &mode, kModes.data(), kModes.size())) {
    state.playout.mode = static_cast<PlayoutMode>(mode);
    state.playout.smoothness.reset();
    state.playout.delay_us = 0;
  }
  if (state.playout.mode == PlayoutMode::kLatest) {
    ImGui::TextDisabled("nothing is held back");
  } else {
    auto smooth = static_cast<float>(Playout(state.playout).smoothness());
    ImGui::TextDisabled("live");
    ImGui::SameLine();
    ImGui::SetNextItemWidth(-ImGui::CalcTextSize("smooth").x - 12);
    if (ImGui::SliderFloat("##smooth", &smooth, 0, 1, "")) {
      state.playout.smoothness = static_cast<double>(smooth);
      state.playout.delay_us = 0;
    }
    ImGui::SameLine();
    ImGui::TextDisabled("smooth");
    if (!session.scene().instances().empty()) {
      const Playout& playout = session.scene().instances().front().view.playout();
      ImGui::TextDisabled("%.0f ms held back", static_cast<double>(playout.delay_us()) / 1000);
    }
  }
}

void draw_detail(Session& session) {
  auto level = static_cast<float>(session.scene().lod().fraction());
  ImGui::SetNextItemWidth(-1);
  if (ImGui::SliderFloat("##lod", &level, 0.001F, 1, "at most %.3f of the vertices", ImGuiSliderFlags_Logarithmic))
    session.scene().lod().set_fraction(static_cast<double>(level));
  LevelControl& levels = session.levels();
  levels.set_kind(chosen_from("##resolver", "lowered by", kResolvers, levels.kind(),
                              [](ResolverKind kind) { return std::string(kResolverNames[kind]); }));
}

void draw_export(ViewerState& state) {
  if (ImGui::Button("screenshot")) state.screenshot_wanted = true;
  ImGui::SameLine();
  if (ImGui::Button("without background")) state.clean_screenshot_wanted = true;
  ImGui::Checkbox("turntable", &state.turntable);
  ImGui::SameLine();
  ImGui::Checkbox("write every picture", &state.recording);
}

constexpr ImU32 kLine = IM_COL32(125, 190, 255, 255), kFill = IM_COL32(125, 190, 255, 38),
                kRule = IM_COL32(255, 255, 255, 36), kDim = IM_COL32(173, 186, 201, 255);

void draw_plot(const char* name, const char* format, const std::vector<float>& values, float scale) {
  ImGui::TextUnformatted(name);
  ImGui::SameLine();
  ImGui::TextDisabled(format, values.empty() ? 0.0 : static_cast<double>(values.back()));
  const float width = ImGui::GetContentRegionAvail().x, height = 24 * scale;
  const ImVec2 corner = ImGui::GetCursorScreenPos();
  ImGui::Dummy({width, height + 3 * scale});
  ImDrawList& list = *ImGui::GetWindowDrawList();
  const auto axis = axis_for(values);
  const auto point = [&](std::size_t i) {
    const auto back = static_cast<float>(values.size() - 1 - i) / static_cast<float>(History::kMaxSamples - 1);
    const float part = std::clamp(values[i] / axis[1], 0.0F, 1.0F);
    return ImVec2{corner.x + width * (1 - back), corner.y + height * (1 - part)};
  };
  for (const float part : {0.0F, 0.5F, 1.0F})
    list.AddLine({corner.x, corner.y + part * height}, {corner.x + width, corner.y + part * height}, kRule);
  for (std::size_t i = 1; i < values.size(); ++i) {
    const ImVec2 a = point(i - 1), b = point(i);
    list.AddQuadFilled({a.x, corner.y + height}, a, b, {b.x, corner.y + height}, kFill);
    list.AddLine(a, b, kLine, 1.4F * scale);
  }
  const std::string top = formatted("%.4g", static_cast<double>(axis[1]));
  list.AddText({corner.x + 3 * scale, corner.y - 1 * scale}, kDim, top.c_str());
}

void draw_plots(const History& history, ResolverKind resolver, float scale) {
  if (!ImGui::BeginTable("plots", 2)) return;
  const auto plot = [&](const char* name, const char* format, double HistorySample::*member) {
    ImGui::TableNextColumn();
    draw_plot(name, format, history.values(member), scale);
  };
  plot("detail", "%.2f", &HistorySample::lod);
  plot("pictures", "%.0f /s", &HistorySample::drawn_hz);
  plot("latency", "%.0f ms", &HistorySample::latency_ms);
  plot("bandwidth", "%.0f kbit/s", &HistorySample::kbit_per_s);
  if (resolver != ResolverKind::kNone)
    plot(resolver == ResolverKind::kPaper ? "kappa" : "planned", "%.2f", &HistorySample::control);
  ImGui::EndTable();
}

struct Demo {
  const char *label, *hint, *open;
};
constexpr std::array<Demo, 3> kDemos{{{"A beating heart", "7,292 vertices", "heart"},
                                      {"A bar that bends and twists", "32,802 vertices", "bar:both"},
                                      {"A wave round a torus", "10,240 vertices", "torus"}}};

/// With its first button.
void begin_bar(ViewerState& state, float scale) {
  const ImVec2 screen = ImGui::GetIO().DisplaySize;
  const float gap = 12 * scale, width = std::min(520 * scale, 0.45F * screen.x);
  ImGui::SetNextWindowPos({0.5F * screen.x, screen.y - gap}, ImGuiCond_Always, {0.5F, 1});
  ImGui::SetNextWindowSize({width, 0}, ImGuiCond_Always);
  ImGui::SetNextWindowBgAlpha(0.62F);
  ImGui::Begin("timeline", nullptr,
               ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoMove | ImGuiWindowFlags_NoSavedSettings |
                   ImGuiWindowFlags_NoFocusOnAppearing | ImGuiWindowFlags_NoNav);
  if (ImGui::Button(state.paused ? "play" : "pause", {48 * scale, 0})) state.paused = !state.paused;
  ImGui::SameLine();
}

/// Between marks of so long a past: a dozen at most.
TimeUs mark_interval_us(TimeUs length_us) {
  constexpr std::array<TimeUs, 6> kSeconds{1, 5, 30, 60, 300, 600};
  const auto few = [&](TimeUs seconds) { return length_us <= 12 * seconds * 1'000'000; };
  const auto found = std::find_if(kSeconds.begin(), kSeconds.end(), few);
  return (found == kSeconds.end() ? 3600 : *found) * 1'000'000;
}

}  // namespace

UiRequests draw_panel(Session& session, ViewerState& state, TextField& to_open, float scale) {
  UiRequests requests;
  const ImVec2 screen = ImGui::GetIO().DisplaySize;
  const float gap = 12 * scale, width = panel_width(scale) - gap;
  ImGui::SetNextWindowPos({gap, gap}, ImGuiCond_Always);
  ImGui::SetNextWindowSizeConstraints({width, 0}, {width, std::max(80.0F, screen.y - 5.2F * gap)});
  ImGui::SetNextWindowBgAlpha(0.80F);
  ImGui::Begin("panel", nullptr,
               ImGuiWindowFlags_NoTitleBar | ImGuiWindowFlags_NoMove | ImGuiWindowFlags_NoResize |
                   ImGuiWindowFlags_AlwaysAutoResize | ImGuiWindowFlags_NoSavedSettings);
  const auto section = [](const char* name) { return ImGui::CollapsingHeader(name, ImGuiTreeNodeFlags_DefaultOpen); };
  if (section("Surfaces")) draw_surfaces(session, requests, to_open, scale);
  if (session.room() != nullptr && section("Room")) draw_room(*session.room(), session.sources(), state, scale);
  if (section("Style")) draw_style(session, state.style);
  if (section("Motion")) draw_motion(session, state);
  if (section("Detail")) draw_detail(session);
  if (section("Pictures")) draw_export(state);
  if (section("The last minute")) draw_plots(session.history(), session.levels().kind(), scale);
  ImGui::End();
  return requests;
}

void draw_past(const RewindDesk::Bar& bar, ViewerState& state, float scale) {
  begin_bar(state, scale);
  const float gap = 12 * scale, height = ImGui::GetFrameHeight();
  const float after = ImGui::CalcTextSize("x0.25").x + 48 * scale + 3 * gap / 2;
  const float width = std::max(4 * gap, ImGui::GetContentRegionAvail().x - after);
  const ImVec2 at = ImGui::GetCursorScreenPos();
  const TimeUs from_us = bar.spans.front().from_us, length_us = std::max<TimeUs>(bar.now_us - from_us, 1);
  const auto x_of = [&](TimeUs time_us) {
    const double part = static_cast<double>(time_us - from_us) / static_cast<double>(length_us);
    return at.x + width * static_cast<float>(std::clamp(part, 0.0, 1.0));
  };
  ImGui::InvisibleButton("##past", {width, height});
  const float part = std::clamp((ImGui::GetIO().MousePos.x - at.x) / width, 0.0F, 1.0F);
  const TimeUs there_us = from_us + std::llround(static_cast<double>(part) * static_cast<double>(length_us));
  const bool is_new = ImGui::IsItemActivated() || ImGui::GetIO().MouseDelta.x != 0;
  if (ImGui::IsItemActive() && is_new) state.seek_us = there_us;
  if (ImGui::IsItemHovered() || ImGui::IsItemActive())
    ImGui::SetTooltip("%s", (text_from_behind(bar.now_us - there_us) + ", " + timecode_of(there_us)).c_str());
  ImDrawList& lines = *ImGui::GetWindowDrawList();
  const float top = at.y + 0.3F * height, bottom = at.y + 0.7F * height;
  lines.AddRectFilled({at.x, top}, {at.x + width, bottom}, ImGui::GetColorU32(ImGuiCol_FrameBg), 3 * scale);
  for (const auto& [begin_us, end_us] : bar.spans)
    lines.AddRectFilled({x_of(begin_us), top}, {std::max(x_of(end_us), x_of(begin_us) + 1), bottom},
                        ImGui::GetColorU32(ImGuiCol_SliderGrab, 0.55F));
  const TimeUs every_us = mark_interval_us(length_us);
  constexpr int kMaxMarks = 200;
  TimeUs mark_us = bar.now_us - every_us;
  for (int mark = 0; mark < kMaxMarks && mark_us > from_us; ++mark, mark_us -= every_us)
    lines.AddLine({x_of(mark_us), bottom}, {x_of(mark_us), at.y + height}, ImGui::GetColorU32(ImGuiCol_TextDisabled));
  const float x = x_of(bar.at_us), half = 3 * scale;
  lines.AddRectFilled({x - half, at.y}, {x + half, at.y + height}, ImGui::GetColorU32(ImGuiCol_SliderGrabActive), half);
  ImGui::SameLine();
  ImGui::BeginDisabled(!bar.is_past);
  if (ImGui::Button("live", {48 * scale, 0})) state.live_wanted = true;
  ImGui::EndDisabled();
  ImGui::SameLine();
  ImGui::TextUnformatted(state.speed == 1 ? "" : formatted("x%.3g", state.speed).c_str());
  ImGui::End();
}

void draw_timeline(const Timeline& timeline, ViewerState& state, TimeUs now_us, float scale) {
  begin_bar(state, scale);
  const float gap = 12 * scale;
  const std::string rate = state.speed == 1 ? std::string() : formatted("x%.3g", state.speed);
  const float after =
      ImGui::CalcTextSize("x0.5").x + ImGui::CalcTextSize("loop").x + ImGui::GetFrameHeight() + 5 * gap / 2;
  ImGui::SetNextItemWidth(std::max(4 * gap, ImGui::GetContentRegionAvail().x - after));
  const auto end_s = static_cast<float>(static_cast<double>(timeline.end_us()) / 1e6);
  // The last pose of a loop stays until the first one comes.
  const TimeUs at_us = std::min(timeline.at(now_us).position_us, timeline.end_us());
  auto at_s = static_cast<float>(static_cast<double>(at_us) / 1e6);
  const std::string text = "%.2f of " + formatted("%.2f s", static_cast<double>(end_s));
  // The bar stays dark while it is dragged, so that its thumb is seen.
  for (const ImGuiCol of_bar : {ImGuiCol_FrameBgActive, ImGuiCol_FrameBgHovered})
    ImGui::PushStyleColor(of_bar, ImGui::GetColorU32(ImGuiCol_FrameBg));
  if (ImGui::SliderFloat("##position", &at_s, 0, end_s, text.c_str(), ImGuiSliderFlags_AlwaysClamp))
    state.seek_us = static_cast<TimeUs>(static_cast<double>(at_s) * 1e6);
  ImGui::PopStyleColor(2);
  ImGui::SameLine();
  ImGui::Checkbox("loop", &state.looping);
  ImGui::SameLine();
  ImGui::TextUnformatted(rate.c_str());
  ImGui::End();
}

UiRequests draw_welcome(const std::vector<std::string>& recent, TextField& to_open, float scale) {
  UiRequests requests;
  const ImVec2 screen = ImGui::GetIO().DisplaySize;
  const float width = std::min(460 * scale, screen.x - 24 * scale);
  ImGui::SetNextWindowPos({0.5F * screen.x, 0.5F * screen.y}, ImGuiCond_Always, {0.5F, 0.5F});
  ImGui::SetNextWindowSizeConstraints({width, 0}, {width, screen.y - 24 * scale});
  ImGui::SetNextWindowBgAlpha(0.86F);
  ImGui::Begin("welcome", nullptr,
               ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_AlwaysAutoResize | ImGuiWindowFlags_NoSavedSettings |
                   ImGuiWindowFlags_NoMove);
  ImGui::SetWindowFontScale(1.45F);
  ImGui::TextUnformatted("Eigencast");
  ImGui::SetWindowFontScale(1);
  ImGui::TextDisabled("Deforming surfaces, live");
  ImGui::Dummy({0, 6 * scale});
  ImGui::TextUnformatted("See one now");
  for (const Demo& demo : kDemos) {
    if (ImGui::Button(demo.label, {0.55F * width, 0})) requests.open = demo.open;
    ImGui::SameLine();
    ImGui::TextDisabled("%s", demo.hint);
  }
  ImGui::Dummy({0, 6 * scale});
  ImGui::TextUnformatted("Watch a stream, or open a file");
  if (draw_open_line("http://host:7490/stream, or a path", "Open", 64 * scale, to_open)) requests.open = to_open.data();
  ImGui::TextDisabled("or drop either on this window");
  if (!recent.empty()) {
    ImGui::Dummy({0, 6 * scale});
    ImGui::TextUnformatted("Opened before");
    for (std::size_t i = 0; i < recent.size(); ++i) {
      ImGui::PushID(static_cast<int>(i));
      if (ImGui::Selectable(recent[i].c_str())) requests.open = recent[i];
      ImGui::PopID();
    }
  }
  ImGui::Dummy({0, 4 * scale});
  ImGui::TextDisabled("H shows the keys, Tab the panel");
  ImGui::End();
  return requests;
}

}  // namespace eigencast
