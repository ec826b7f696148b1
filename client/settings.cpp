// SPDX-License-Identifier: MIT
#include "client/settings.h"

#include <filesystem>
#include <nlohmann/json.hpp>

#include "client/hud_text.h"
#include "common/core/files.h"
#include "sdk/contexts.h"

namespace eigencast {
namespace {

using nlohmann::json;

constexpr std::uint64_t kMaxSettingsBytes = 1 << 20;

constexpr std::pair<const char*, bool Style::*> kStyleFlags[] = {
    {"edges", &Style::edges}, {"wireframe", &Style::wireframe},     {"points", &Style::points}, {"grid", &Style::grid},
    {"axes", &Style::axes},   {"transparent", &Style::transparent}, {"legend", &Style::legend}};

void read_bool(const json& object, const char* name, bool& value) {
  if (const auto at = object.find(name); at != object.end() && at->is_boolean()) value = at->get<bool>();
}

void read_side(const json& object, const char* name, int& value) {
  const auto at = object.find(name);
  if (at == object.end() || !at->is_number_integer()) return;
  if (const auto side = at->get<long long>(); side >= 160 && side <= 16384) value = static_cast<int>(side);
}

template <typename Enum, std::size_t N>
std::optional<Enum> read_named(const json& object, const char* name, const EnumNames<Enum, N>& names) {
  const auto at = object.find(name);
  return at != object.end() && at->is_string() ? names.find(at->get_ref<const std::string&>()) : std::nullopt;
}

std::optional<double> read_part(const json& object, const char* name) {
  const auto at = object.find(name);
  if (at == object.end() || !at->is_number()) return std::nullopt;
  const double part = at->get<double>();
  return part >= 0 && part <= 1 ? std::optional(part) : std::nullopt;
}

}  // namespace

void Settings::opened(const std::string& what) {
  std::erase(recent, what);
  recent.insert(recent.begin(), what);
  if (recent.size() > kMaxRecent) recent.resize(kMaxRecent);
}

std::string Settings::default_path() {
  const std::string contexts = Contexts::default_path();
  if (contexts.empty()) return {};
  return (std::filesystem::path(contexts).parent_path() / "viewer.json").string();
}

Result<Settings> Settings::load(const std::string& path) {
  Settings settings;
  std::error_code ignored;
  if (path.empty() || !std::filesystem::exists(path, ignored)) return settings;
  const auto text = read_file(path, kMaxSettingsBytes);
  if (!text) return text.error();
  const json all = json::parse(*text, nullptr, false);
  if (!all.is_object())
    return fail(ErrorCode::kCorrupt, path + ": is not a JSON object; the viewer starts with defaults");
  read_side(all, "width", settings.width);
  read_side(all, "height", settings.height);
  read_bool(all, "figures", settings.hud);
  read_bool(all, "panel", settings.panel);
  if (const auto style = all.find("style"); style != all.end() && style->is_object()) {
    for (const auto& [name, member] : kStyleFlags) read_bool(*style, name, settings.style.*member);
    settings.style.normals = read_named(*style, "normals", kNormalsNames).value_or(settings.style.normals);
    settings.style.colour_map = read_named(*style, "colour_map", kColourMapNames).value_or(settings.style.colour_map);
  }
  settings.resolver = read_named(all, "resolver", kResolverNames);
  settings.playout = read_named(all, "motion", kPlayoutNames);
  settings.smoothness = read_part(all, "smoothness");
  if (const auto recent = all.find("recent"); recent != all.end() && recent->is_array()) {
    for (const json& each : *recent) {
      if (each.is_string() && settings.recent.size() < kMaxRecent) settings.recent.push_back(each.get<std::string>());
    }
  }
  return settings;
}

Result<void> Settings::save(const std::string& path) const {
  std::error_code ignored;
  std::filesystem::create_directories(std::filesystem::path(path).parent_path(), ignored);
  json all{{"width", width}, {"height", height}, {"figures", hud}, {"panel", panel}, {"recent", recent}};
  if (resolver) all["resolver"] = kResolverNames[*resolver];
  if (playout) all["motion"] = kPlayoutNames[*playout];
  if (smoothness) all["smoothness"] = *smoothness;
  for (const auto& [name, member] : kStyleFlags) all["style"][name] = style.*member;
  all["style"]["normals"] = kNormalsNames[style.normals];
  all["style"]["colour_map"] = kColourMapNames[style.colour_map];
  return write_file_atomically(path, all.dump(2, ' ', false, json::error_handler_t::replace) + "\n");
}

}  // namespace eigencast
