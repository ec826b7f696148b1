// SPDX-License-Identifier: MIT
#include "client/settings.h"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "client/hud_text.h"
#include "common/core/files.h"
#include "sdk/contexts.h"

namespace eigencast {
namespace {

using nlohmann::json;

constexpr std::uint64_t kMaxSettingsBytes = 1 << 20;

struct StyleFlag {
  const char* name;
  bool Style::*member;
};
constexpr std::array<StyleFlag, 7> kStyleFlags{{{"edges", &Style::edges},
                                                {"wireframe", &Style::wireframe},
                                                {"points", &Style::points},
                                                {"grid", &Style::grid},
                                                {"axes", &Style::axes},
                                                {"transparent", &Style::transparent},
                                                {"legend", &Style::legend}}};

void read_bool(const json& object, const char* name, bool& value) {
  if (const auto at = object.find(name); at != object.end() && at->is_boolean()) value = at->get<bool>();
}

void read_side(const json& object, const char* name, int& value) {
  const auto at = object.find(name);
  if (at == object.end() || !at->is_number_integer()) return;
  if (const auto side = at->get<long long>(); side >= 160 && side <= 16384) value = static_cast<int>(side);
}

template <typename Value>
std::optional<Value> read_named(const json& object, const char* name, std::initializer_list<Value> values) {
  const auto at = object.find(name);
  if (at == object.end() || !at->is_string()) return std::nullopt;
  const auto named = std::find_if(values.begin(), values.end(), [&](Value value) { return name_of(value) == *at; });
  return named == values.end() ? std::nullopt : std::optional(*named);
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
    for (const StyleFlag& each : kStyleFlags) read_bool(*style, each.name, settings.style.*each.member);
    if (const auto map = style->find("colour_map"); map != style->end() && map->is_string())
      settings.style.colour_map = kColourMapNames.find(map->get<std::string>()).value_or(ColourMap::kViridis);
  }
  settings.resolver = read_named(all, "resolver", {ResolverKind::kNone, ResolverKind::kBudget, ResolverKind::kPaper});
  settings.playout =
      read_named(all, "motion", {PlayoutMode::kLatest, PlayoutMode::kInterpolate, PlayoutMode::kEstimate});
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
  if (resolver) all["resolver"] = name_of(*resolver);
  if (playout) all["motion"] = name_of(*playout);
  if (smoothness) all["smoothness"] = *smoothness;
  for (const StyleFlag& each : kStyleFlags) all["style"][each.name] = style.*each.member;
  all["style"]["colour_map"] = kColourMapNames[style.colour_map];
  return write_file_atomically(path, all.dump(2, ' ', false, json::error_handler_t::replace) + "\n");
}

}  // namespace eigencast
