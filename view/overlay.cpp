// SPDX-License-Identifier: MIT
#include "view/overlay.h"

#include <backends/imgui_impl_glfw.h>
#include <backends/imgui_impl_opengl3.h>
#include <epoxy/gl.h>
#include <imgui.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>

#include "common/core/text.h"

namespace eigencast {
namespace {

constexpr ImGuiWindowFlags kBoxFlags = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoInputs |
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

/// With one corner or edge (pivot, 0..1) at a position. content: its size; by default that of the last picture's.
bool begin_box(const char* name, ImVec2 at, ImVec2 pivot, float alpha, std::optional<ImVec2> content = {}) {
  const ImVec2 padding = ImGui::GetStyle().WindowPadding;
  ImGui::SetNextWindowPos(at, ImGuiCond_Always, pivot);
  if (content) ImGui::SetNextWindowSize({std::ceil(content->x + 2 * padding.x), std::ceil(content->y + 2 * padding.y)});
  ImGui::SetNextWindowBgAlpha(alpha);
  return ImGui::Begin(name, nullptr, content ? kBoxFlags & ~ImGuiWindowFlags_AlwaysAutoResize : kBoxFlags);
}

struct Room {
  ImVec2 size;
  float gap, scale;
};

ImVec2 size_of(const std::string& text, float width) {
  return ImGui::CalcTextSize(text.c_str(), nullptr, false, width);
}

float width_of(const std::string& text) {
  return ImGui::CalcTextSize(text.c_str()).x;
}

/// Draws as many of the first lines as leave room for the scene. Returns the lower end of the box.
float draw_figures(const std::vector<std::string>& lines, const Room& room, float left) {
  constexpr float kPart = 0.3F;  // of the picture's height
  const ImGuiStyle& style = ImGui::GetStyle();
  const float width = room.size.x - left - 2 * room.gap - 2 * style.WindowPadding.x;
  if (lines.empty() || width < 6 * ImGui::GetFontSize()) return 0;  // only the panel fits
  ImVec2 content{0, -style.ItemSpacing.y};
  std::size_t shown = 0;
  for (; shown < lines.size(); ++shown) {
    const ImVec2 line = size_of(lines[shown], width);
    const float height = content.y + style.ItemSpacing.y + line.y;
    if (shown > 0 && height + 2 * style.WindowPadding.y > kPart * room.size.y) break;
    content = {std::max(content.x, line.x), height};
  }
  begin_box("figures", {room.size.x - room.gap, room.gap}, {1, 0}, 0.62F, content);
  ImGui::PushTextWrapPos(style.WindowPadding.x + width);
  for (std::size_t i = 0; i < shown; ++i) {
    if (i + 1 < lines.size())
      ImGui::TextUnformatted(lines[i].c_str());
    else
      ImGui::TextDisabled("%s", lines[i].c_str());
  }
  ImGui::PopTextWrapPos();
  ImGui::End();
  return room.gap + content.y + 2 * style.WindowPadding.y;
}

void draw_connection(const OverlayContent& content, const Room& room, float right) {
  if (content.connection.empty()) return;
  constexpr const char* kPaused = "  paused (Space)";
  const ImGuiStyle& style = ImGui::GetStyle();
  const float line = ImGui::GetTextLineHeight(), mark = 0.85F * line;
  const float rest = room.size.x - right - 2 * room.gap - style.WindowPadding.x;
  const float widest = std::max(rest, 8 * line), before = style.WindowPadding.x + mark + style.ItemSpacing.x;
  ImVec2 size = size_of(content.connection, widest - before);
  size.x += mark + style.ItemSpacing.x + (content.paused ? style.ItemSpacing.x + width_of(kPaused) : 0);
  begin_box("connection", {room.gap, room.size.y - room.gap}, {0, 1}, 0.62F, size);
  // Shape and word carry the meaning, not the colour.
  const ImVec2 corner = ImGui::GetCursorScreenPos(), middle{corner.x + 0.45F * line, corner.y + 0.55F * line};
  ImDrawList& list = *ImGui::GetWindowDrawList();
  if (content.connected)
    list.AddCircleFilled(middle, 0.30F * line, IM_COL32(115, 230, 140, 255));
  else
    list.AddCircle(middle, 0.28F * line, IM_COL32(255, 184, 90, 255), 0, 0.12F * line);
  ImGui::Dummy({mark, line});
  ImGui::SameLine();
  ImGui::PushTextWrapPos(widest);
  ImGui::TextUnformatted(content.connection.c_str());
  ImGui::PopTextWrapPos();
  if (content.paused) {
    ImGui::SameLine();
    ImGui::TextColored({1, 0.85F, 0.5F, 1}, "%s", kPaused);
  }
  ImGui::End();
}

void draw_banner(const OverlayContent& content, const Room& room) {
  if (content.banner.empty()) return;
  const float padding = ImGui::GetStyle().WindowPadding.x;
  const float widest =
      std::max(room.size.x - content.left_px - 2 * room.gap - 2 * padding, 8 * ImGui::GetTextLineHeight());
  begin_box("banner", {0.5F * (room.size.x + content.left_px), room.size.y - 5.5F * room.gap}, {0.5F, 1}, 0.88F,
            size_of(content.banner, widest));
  ImGui::PushStyleColor(ImGuiCol_Text, {1, 0.80F, 0.45F, 1});
  ImGui::PushTextWrapPos(padding + widest);
  ImGui::TextUnformatted(content.banner.c_str());
  ImGui::PopTextWrapPos();
  ImGui::PopStyleColor();
  ImGui::End();
}

/// Fits below `top`. Returns the width of the box.
float draw_legend(const Legend& legend, const Room& room, float top) {
  const float scale = room.scale, half_line = 0.5F * ImGui::GetTextLineHeight();
  const ImGuiStyle& style = ImGui::GetStyle();
  const float beside =
      2 * style.WindowPadding.y + 2 * style.ItemSpacing.y + 3 * scale + ImGui::GetTextLineHeight() + half_line;
  const float bar = std::clamp(room.size.y - top - 2 * room.gap - beside, 40 * scale, 168 * scale);
  begin_box("legend", {room.size.x - room.gap, room.size.y - room.gap}, {1, 1}, 0.62F);
  ImGui::TextUnformatted(legend.title.c_str());
  ImGui::Dummy({0, 3 * scale});
  const ImVec2 corner = ImGui::GetCursorScreenPos(), size{16 * scale, bar};
  const ColourTable table = table_of(legend.map);
  ImDrawList& list = *ImGui::GetWindowDrawList();
  constexpr std::size_t kSteps = 64;
  for (std::size_t i = 0; i < kSteps; ++i) {
    const auto& colour = table[255 * i / (kSteps - 1)];
    const float low = corner.y + size.y * (1 - static_cast<float>(i) / kSteps);
    list.AddRectFilled({corner.x, low - size.y / kSteps - 0.5F}, {corner.x + size.x, low},
                       IM_COL32(colour[0], colour[1], colour[2], 255));
  }
  float widest = 0;
  for (int i = 0; i <= 2; ++i) {
    const float part = 0.5F * static_cast<float>(i);
    const std::string number =
        formatted("%.3g%s %s", static_cast<double>(legend.low + part * (legend.high - legend.low)), i == 2 ? "+" : "",
                  i == 2 ? legend.unit.c_str() : "");
    const float y = corner.y + size.y * (1 - part);
    list.AddLine({corner.x + size.x, y}, {corner.x + size.x + 4 * scale, y}, IM_COL32(220, 225, 232, 255));
    list.AddText({corner.x + size.x + 9 * scale, y - half_line}, IM_COL32(235, 238, 242, 255), number.c_str());
    widest = std::max(widest, width_of(number));
  }
  ImGui::Dummy({size.x + 9 * scale + widest, size.y + half_line});
  ImGui::End();
  return room.gap + 2 * style.WindowPadding.x + std::max(width_of(legend.title), size.x + 9 * scale + widest);
}

void draw_labels(const std::vector<Label>& labels, const Room& room, float pixels) {
  ImDrawList& list = *ImGui::GetBackgroundDrawList();
  const float r = 6 * room.scale, line = ImGui::GetTextLineHeight(), widest = 0.3F * room.size.x;
  for (const Label& label : labels) {
    const ImVec2 at{label.x_px / pixels, label.y_px / pixels};
    const ImU32 colour = IM_COL32(label.colour[0], label.colour[1], label.colour[2], 255),
                dark = IM_COL32(12, 14, 18, 255);
    if (label.is_pin) {
      list.AddCircleFilled(at, r, dark);
      list.AddCircleFilled(at, 0.8F * r, colour);
      list.AddCircleFilled(at, 0.3F * r, dark);
    } else {
      list.AddTriangleFilled(at, {at.x + 0.9F * r, at.y + 2.6F * r}, {at.x + 2.1F * r, at.y + 1.6F * r}, colour);
      list.AddTriangle(at, {at.x + 0.9F * r, at.y + 2.6F * r}, {at.x + 2.1F * r, at.y + 1.6F * r}, dark, 0.2F * r);
    }
    if (label.text.empty()) continue;
    const ImVec2 size = size_of(label.text, widest);
    const ImVec2 corner{at.x + 1.8F * r, label.is_pin ? at.y - 0.5F * line : at.y + 2.4F * r};
    list.AddRectFilled({corner.x - 0.5F * r, corner.y - 0.2F * r},
                       {corner.x + size.x + 0.5F * r, corner.y + size.y + 0.2F * r}, IM_COL32(23, 28, 36, 200),
                       0.5F * r);
    list.AddText(nullptr, 0, corner, colour, label.text.c_str(), nullptr, widest);
  }
}

/// Shrinks to fit beside a panel, because a part of the help is of no use.
void draw_help(const std::vector<HelpLine>& lines, const Room& room, float left) {
  if (lines.empty()) return;
  const ImGuiStyle& style = ImGui::GetStyle();
  const ImVec2 cell = style.CellPadding, padding = style.WindowPadding;
  const float between = 10 * room.scale + style.ItemSpacing.x;
  std::array<float, 3> widest{};
  for (const HelpLine& line : lines) {
    const std::array<const std::string*, 3> texts{&line.keys, &line.what, &line.state};
    for (std::size_t i = 0; i < widest.size(); ++i) widest[i] = std::max(widest[i], width_of(*texts[i]));
  }
  const float width = widest[0] + widest[1] + widest[2] + between + 6 * cell.x + 2 * padding.x;
  const float height = static_cast<float>(lines.size()) * (ImGui::GetFontSize() + 2 * cell.y) + 2 * padding.y;
  constexpr float kMinPart = 0.25F;
  if (kMinPart * width > 0.96F * room.size.x - left) left = 0;  // there is no room beside it
  const float part =
      std::clamp(std::min((0.96F * room.size.x - left) / width, 0.96F * room.size.y / height), kMinPart, 1.0F);
  ImGui::PushStyleVar(ImGuiStyleVar_CellPadding, {part * cell.x, part * cell.y});
  ImGui::PushStyleVar(ImGuiStyleVar_WindowPadding, {part * padding.x, part * padding.y});
  begin_box("help", {0.5F * (left + room.size.x), 0.5F * room.size.y}, {0.5F, 0.5F}, 0.93F);
  ImGui::SetWindowFontScale(part);
  if (ImGui::BeginTable("keys", 3, ImGuiTableFlags_SizingFixedFit)) {
    for (const HelpLine& line : lines) {
      ImGui::TableNextRow();
      ImGui::TableNextColumn();
      ImGui::TextColored({1.0F, 0.78F, 0.55F, 1}, "%s", line.keys.c_str());
      ImGui::TableNextColumn();
      ImGui::Dummy({part * 10 * room.scale, 0});
      ImGui::SameLine();
      ImGui::TextUnformatted(line.what.c_str());
      ImGui::TableNextColumn();
      ImGui::TextDisabled("%s", line.state.c_str());
    }
    ImGui::EndTable();
  }
  ImGui::End();
  ImGui::PopStyleVar(2);
}

/// Fonts in pixels, layout in the window's units.
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

TextScale fitted(TextScale scale, float width, float height) {
  constexpr float kWidth = 340, kHeight = 270;           // at 96 dpi
  constexpr float kStep = 1.0F / 16, kMin = 10 * kStep;  // fonts are made for each step
  const float part = std::min(width / kWidth, height / kHeight) / scale.layout;
  scale.layout *= std::clamp(kStep * std::floor(part / kStep), kMin, 1.0F);
  return scale;
}

Overlay::Overlay(void* window, TextScale scale) : has_window_(window != nullptr), wanted_(scale), scale_(scale) {
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

void Overlay::use_scale(TextScale scale) {
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

void Overlay::begin_frame(int width_px, int height_px, std::optional<glm::vec2> mouse_px) {
  ImGui_ImplOpenGL3_NewFrame();
  if (has_window_) {
    ImGui_ImplGlfw_NewFrame();
  } else {
    ImGui::GetIO().DisplaySize = {static_cast<float>(width_px), static_cast<float>(height_px)};
    ImGui::GetIO().DeltaTime = 1.0F / 60;
  }
  if (mouse_px) ImGui::GetIO().MousePos = {mouse_px->x / scale_.pixels, mouse_px->y / scale_.pixels};
  // Of a window that is gone GLFW says what its memory held.
  constexpr float kLargest = 1 << 15;
  const ImVec2 said = ImGui::GetIO().DisplaySize;
  const ImVec2 size{std::clamp(said.x, 0.0F, kLargest), std::clamp(said.y, 0.0F, kLargest)};
  ImGui::GetIO().DisplaySize = size;
  use_scale(fitted(wanted_, size.x, size.y));
  ImGui::NewFrame();
}

void Overlay::lay_out(const OverlayContent& content, const std::function<void()>& panels) const {
  const Room room{ImGui::GetIO().DisplaySize, 12 * scale_.layout, scale_.layout};
  draw_labels(content.labels, room, has_window_ ? scale_.pixels : 1);
  // The help would cover a part of them.
  const float top = content.help.empty() ? draw_figures(content.figures, room, content.left_px) : 0;
  const float right = content.legend ? draw_legend(*content.legend, room, top) : 0;
  draw_connection(content, room, right);
  draw_banner(content, room);
  if (panels) panels();
  draw_help(content.help, room, content.left_px);
}

void Overlay::take_button(glm::vec2 at_px, const OverlayContent& content, const std::function<void()>& panels) {
  begin_frame(0, 0, at_px);
  lay_out(content, panels);
  ImGui::EndFrame();
}

void Overlay::draw(const OverlayContent& content, int width_px, int height_px, unsigned target,
                   const std::function<void()>& panels) {
  // ImGui knows the size of a box after one layout: a window shows it in the next picture, a file needs it now.
  if (!has_window_) {
    begin_frame(width_px, height_px);
    lay_out(content, panels);
    ImGui::EndFrame();
  }
  begin_frame(width_px, height_px);
  lay_out(content, panels);
  ImGui::Render();
  glBindFramebuffer(GL_FRAMEBUFFER, target);
  ImGui_ImplOpenGL3_RenderDrawData(ImGui::GetDrawData());
}

}  // namespace eigencast
