// SPDX-License-Identifier: MIT
#include "view/overlay.h"

#include <backends/imgui_impl_glfw.h>
#include <backends/imgui_impl_opengl3.h>
#include <epoxy/gl.h>
#include <imgui.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>

namespace eigencast {
namespace {

constexpr ImGuiWindowFlags kCard = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoInputs |
                                   ImGuiWindowFlags_AlwaysAutoResize | ImGuiWindowFlags_NoSavedSettings |
                                   ImGuiWindowFlags_NoFocusOnAppearing | ImGuiWindowFlags_NoNav;

/// A proportional font where the system has one of the usual ones; ImGui's own otherwise.
void load_font(float scale) {
  const std::array<const char*, 3> files{"/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf",
                                         "/usr/share/fonts/truetype/noto/NotoSans-Regular.ttf",
                                         "/usr/share/fonts/truetype/liberation/LiberationSans-Regular.ttf"};
  ImFontAtlas& fonts = *ImGui::GetIO().Fonts;
  for (const char* file : files) {
    std::error_code error;
    if (std::filesystem::exists(file, error) && fonts.AddFontFromFileTTF(file, 15 * scale) != nullptr) return;
  }
  ImFontConfig config;
  config.SizePixels = 13 * scale;
  fonts.AddFontDefault(&config);
}

/// A translucent card with one corner or edge (pivot, 0..1) pinned at a place of the picture.
bool begin_card(const char* name, ImVec2 at, ImVec2 pivot, float alpha) {
  ImGui::SetNextWindowPos(at, ImGuiCond_Always, pivot);
  ImGui::SetNextWindowBgAlpha(alpha);
  return ImGui::Begin(name, nullptr, kCard);
}

/// A bar of the map's colours, its lowest value at the bottom, with three marks.
void draw_legend(const Legend& legend, ImVec2 at, float scale) {
  begin_card("legend", at, {1, 1}, 0.62F);
  ImGui::TextUnformatted(legend.title.c_str());
  ImGui::Dummy({0, 3 * scale});
  const ImVec2 corner = ImGui::GetCursorScreenPos(), size{16 * scale, 168 * scale};
  const ColourTable table = table_of(legend.map);
  ImDrawList& list = *ImGui::GetWindowDrawList();
  constexpr std::size_t kSteps = 64;
  for (std::size_t i = 0; i < kSteps; ++i) {
    const auto& colour = table[255 * i / (kSteps - 1)];
    const float low = corner.y + size.y * (1 - static_cast<float>(i) / kSteps);
    list.AddRectFilled({corner.x, low - size.y / kSteps - 0.5F}, {corner.x + size.x, low},
                       IM_COL32(colour[0], colour[1], colour[2], 255));
  }
  const float half_line = 0.5F * ImGui::GetTextLineHeight();
  float widest = 0;
  for (int i = 0; i <= 2; ++i) {
    char number[64];
    const float part = 0.5F * static_cast<float>(i);
    std::snprintf(number, sizeof number, "%.3g%s %s",
                  static_cast<double>(legend.low + part * (legend.high - legend.low)), i == 2 ? "+" : "",
                  i == 2 ? legend.unit.c_str() : "");
    const float y = corner.y + size.y * (1 - part);
    list.AddLine({corner.x + size.x, y}, {corner.x + size.x + 4 * scale, y}, IM_COL32(220, 225, 232, 255));
    list.AddText({corner.x + size.x + 9 * scale, y - half_line}, IM_COL32(235, 238, 242, 255), number);
    widest = std::max(widest, ImGui::CalcTextSize(number).x);
  }
  ImGui::Dummy({size.x + 9 * scale + widest, size.y + half_line});
  ImGui::End();
}

void draw_help(const std::vector<HelpLine>& lines, ImVec2 centre, float scale) {
  begin_card("help", centre, {0.5F, 0.5F}, 0.93F);
  // All of it or nothing is of use: on a low window the letters are smaller.
  const ImGuiStyle& style = ImGui::GetStyle();
  const auto rows = static_cast<float>(lines.size());
  const float room = 1.96F * centre.y - 2 * style.WindowPadding.y - 2 * rows * style.CellPadding.y;
  ImGui::SetWindowFontScale(std::clamp(room / (rows * ImGui::GetFontSize()), 0.4F, 1.0F));
  if (ImGui::BeginTable("keys", 3, ImGuiTableFlags_SizingFixedFit)) {
    for (const HelpLine& line : lines) {
      ImGui::TableNextRow();
      ImGui::TableNextColumn();
      ImGui::TextColored({1.0F, 0.78F, 0.55F, 1}, "%s", line.keys.c_str());
      ImGui::TableNextColumn();
      ImGui::Dummy({10 * scale, 0});
      ImGui::SameLine();
      ImGui::TextUnformatted(line.what.c_str());
      ImGui::TableNextColumn();
      ImGui::TextDisabled("%s", line.state.c_str());
    }
    ImGui::EndTable();
  }
  ImGui::End();
}

/// Letters in the picture's pixels, everything laid out in the window's units.
void take_scale(TextScale scale) {
  ImGui::GetIO().Fonts->Clear();
  load_font(scale.layout * scale.pixels);
  ImGui::GetIO().FontGlobalScale = 1 / scale.pixels;
  ImGuiStyle& style = ImGui::GetStyle();
  style = ImGuiStyle();
  ImGui::StyleColorsDark();
  style.WindowRounding = 7;
  style.WindowBorderSize = 0;
  style.WindowPadding = {11, 8};
  style.Colors[ImGuiCol_WindowBg] = {0.09F, 0.11F, 0.14F, 1};
  style.Colors[ImGuiCol_TextDisabled] = {0.68F, 0.73F, 0.79F, 1};
  style.Colors[ImGuiCol_FrameBg] = {0.27F, 0.32F, 0.39F, 1};
  style.Colors[ImGuiCol_FrameBgHovered] = {0.33F, 0.40F, 0.49F, 1};
  style.Colors[ImGuiCol_Header] = {0.19F, 0.24F, 0.31F, 1};
  style.Colors[ImGuiCol_HeaderHovered] = {0.26F, 0.33F, 0.42F, 1};
  style.Colors[ImGuiCol_Button] = {0.22F, 0.40F, 0.62F, 1};
  style.FrameRounding = 4;
  style.ItemSpacing.y = 3;
  style.ScaleAllSizes(scale.layout);
}

}  // namespace

TextScale text_scale(float content, float pixels_per_unit, float wanted) {
  const float pixels = std::max(pixels_per_unit, 0.1F);
  return {wanted > 0 ? wanted : std::max(content / pixels, 1.0F), pixels};
}

Overlay::Overlay(void* window, TextScale scale) : has_window_(window != nullptr), scale_(scale) {
  ImGui::CreateContext();
  ImGui::GetIO().IniFilename = nullptr;
  take_scale(scale_);
  if (has_window_) ImGui_ImplGlfw_InitForOpenGL(static_cast<GLFWwindow*>(window), true);
  ImGui_ImplOpenGL3_Init("#version 330 core");
}

Overlay::~Overlay() {
  ImGui_ImplOpenGL3_Shutdown();
  if (has_window_) ImGui_ImplGlfw_Shutdown();
  ImGui::DestroyContext();
}

void Overlay::set_scale(TextScale scale) {
  if (scale == scale_) return;
  scale_ = scale;
  ImGui_ImplOpenGL3_DestroyFontsTexture();
  take_scale(scale_);
  ImGui_ImplOpenGL3_CreateFontsTexture();
}

bool Overlay::wants_mouse() const {
  return ImGui::GetIO().WantCaptureMouse;
}

bool Overlay::wants_keys() const {
  return ImGui::GetIO().WantTextInput;
}

void Overlay::draw(const OverlayContent& content, int width_px, int height_px, unsigned target,
                   const std::function<void()>& panels) {
  ImGui_ImplOpenGL3_NewFrame();
  if (has_window_) {
    ImGui_ImplGlfw_NewFrame();
  } else {
    ImGui::GetIO().DisplaySize = {static_cast<float>(width_px), static_cast<float>(height_px)};
    ImGui::GetIO().DeltaTime = 1.0F / 60;
  }
  ImGui::NewFrame();
  const ImVec2 size = ImGui::GetIO().DisplaySize;
  const float gap = 12 * scale_.layout;
  if (!content.figures.empty()) {
    begin_card("figures", {size.x - gap, gap}, {1, 0}, 0.62F);
    for (std::size_t i = 0; i < content.figures.size(); ++i) {
      if (i + 1 < content.figures.size())
        ImGui::TextUnformatted(content.figures[i].c_str());
      else
        ImGui::TextDisabled("%s", content.figures[i].c_str());
    }
    ImGui::End();
  }
  if (!content.connection.empty()) {
    begin_card("connection", {gap, size.y - gap}, {0, 1}, 0.62F);
    // Shape and word carry the meaning, the colour only helps.
    const float line = ImGui::GetTextLineHeight();
    const ImVec2 corner = ImGui::GetCursorScreenPos(), middle{corner.x + 0.45F * line, corner.y + 0.55F * line};
    ImDrawList& list = *ImGui::GetWindowDrawList();
    if (content.connected)
      list.AddCircleFilled(middle, 0.30F * line, IM_COL32(115, 230, 140, 255));
    else
      list.AddCircle(middle, 0.28F * line, IM_COL32(255, 184, 90, 255), 0, 0.12F * line);
    ImGui::Dummy({0.85F * line, line});
    ImGui::SameLine();
    ImGui::TextUnformatted(content.connection.c_str());
    if (content.paused) {
      ImGui::SameLine();
      ImGui::TextColored({1, 0.85F, 0.5F, 1}, "  paused (Space)");
    }
    ImGui::End();
  }
  if (!content.banner.empty()) {
    begin_card("banner", {0.5F * (size.x + content.left_px), size.y - 5.5F * gap}, {0.5F, 1}, 0.88F);
    ImGui::TextColored({1, 0.80F, 0.45F, 1}, "%s", content.banner.c_str());
    ImGui::End();
  }
  if (content.legend) draw_legend(*content.legend, {size.x - gap, size.y - gap}, scale_.layout);
  if (panels) panels();
  if (!content.help.empty()) draw_help(content.help, {0.5F * size.x, 0.5F * size.y}, scale_.layout);
  ImGui::Render();
  glBindFramebuffer(GL_FRAMEBUFFER, target);
  ImGui_ImplOpenGL3_RenderDrawData(ImGui::GetDrawData());
}

}  // namespace eigencast
