// SPDX-License-Identifier: MIT
#include <imgui.h>

#include <algorithm>
#include <cstdio>

#include "client/ui/panel.h"

namespace eigencast {
namespace {

constexpr ImU32 kLine = IM_COL32(125, 190, 255, 255), kFill = IM_COL32(125, 190, 255, 38),
                kRule = IM_COL32(255, 255, 255, 36), kDim = IM_COL32(173, 186, 201, 255);

/// One quantity: its name and newest value above, the axis' end at its right.
void draw_plot(const char* name, const char* format, const std::vector<float>& values, float scale) {
  char text[48];
  std::snprintf(text, sizeof text, format, values.empty() ? 0.0 : static_cast<double>(values.back()));
  ImGui::TextUnformatted(name);
  ImGui::SameLine();
  ImGui::TextDisabled("%s", text);
  const float width = ImGui::GetContentRegionAvail().x, height = 24 * scale;
  const ImVec2 corner = ImGui::GetCursorScreenPos();
  ImGui::Dummy({width, height + 3 * scale});
  ImDrawList& list = *ImGui::GetWindowDrawList();
  const auto axis = axis_for(values);
  const auto place = [&](std::size_t i) {
    const auto back = static_cast<float>(values.size() - 1 - i) / static_cast<float>(History::kMost - 1);
    const float part = std::clamp(values[i] / axis[1], 0.0F, 1.0F);
    return ImVec2{corner.x + width * (1 - back), corner.y + height * (1 - part)};
  };
  for (const float part : {0.0F, 0.5F, 1.0F})
    list.AddLine({corner.x, corner.y + part * height}, {corner.x + width, corner.y + part * height}, kRule);
  for (std::size_t i = 1; i < values.size(); ++i) {
    const ImVec2 a = place(i - 1), b = place(i);
    list.AddQuadFilled({a.x, corner.y + height}, a, b, {b.x, corner.y + height}, kFill);
    list.AddLine(a, b, kLine, 1.4F * scale);
  }
  std::snprintf(text, sizeof text, "%.4g", static_cast<double>(axis[1]));
  list.AddText({corner.x + 3 * scale, corner.y - 1 * scale}, kDim, text);
}

}  // namespace

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

}  // namespace eigencast
