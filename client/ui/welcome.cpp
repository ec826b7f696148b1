// SPDX-License-Identifier: MIT
#include <imgui.h>

#include <algorithm>

#include "client/ui/panel.h"

namespace eigencast {
namespace {

struct Demo {
  const char *label, *hint, *open;
};
constexpr std::array<Demo, 3> kDemos{{{"A beating heart", "7,292 vertices", "heart"},
                                      {"A bar that bends and twists", "32,802 vertices", "bar:both"},
                                      {"A wave round a torus", "10,240 vertices", "torus"}}};

}  // namespace

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
  ImGui::SetNextItemWidth(-64 * scale);
  const bool entered = ImGui::InputTextWithHint("##open", "ws://host:7490/stream, or a path", to_open.data(),
                                                to_open.size(), ImGuiInputTextFlags_EnterReturnsTrue);
  ImGui::SameLine();
  if (ImGui::Button("Open", {-1, 0}) || entered) requests.open = to_open.data();
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
