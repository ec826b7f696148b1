// SPDX-License-Identifier: MIT
#include <nlohmann/json.hpp>

#include "sender/deform/arap.h"

namespace eigencast::deform {
namespace {

using nlohmann::json;

Result<Vec3> point_from(const json& box, const char* name) {
  const json value = box.is_object() ? box.value(name, json()) : json();
  Vec3 p{};
  bool good = value.is_array() && value.size() == 3;
  for (std::size_t c = 0; good && c < 3; ++c) {
    good = value[c].is_number();
    if (good) p[c] = value[c].get<double>();
  }
  if (!good) return fail(ErrorCode::kCorrupt, std::string("\"") + name + "\" must be three numbers");
  return p;
}

Result<HandleGroup> group_from(const json& value, const Surface& model) {
  HandleGroup group;
  if (value.is_array()) {
    for (const json& index : value) {
      if (!index.is_number_unsigned() || index.get<std::uint64_t>() >= model.vertex_count())
        return fail(ErrorCode::kCorrupt, "must be numbers below " + std::to_string(model.vertex_count()));
      group.push_back(index.get<std::uint32_t>());
    }
  } else {
    const auto low = point_from(value, "low"), high = point_from(value, "high");
    if (!low) return low.error();
    if (!high) return high.error();
    for (std::uint32_t v = 0; v < model.vertex_count(); ++v) {
      const Vec3& p = model.positions[v];
      bool inside = true;
      for (std::size_t c = 0; c < 3; ++c) inside = inside && (*low)[c] <= p[c] && p[c] <= (*high)[c];
      if (inside) group.push_back(v);
    }
  }
  if (group.empty()) return fail(ErrorCode::kCorrupt, "holds no vertex");
  return group;
}

}  // namespace

Result<std::vector<HandleGroup>> handle_groups_from_json(std::string_view text, const Surface& model) {
  const json root = json::parse(text, nullptr, false);
  if (!root.is_object() || !root.contains("handles") || !root["handles"].is_array())
    return fail(ErrorCode::kCorrupt, "handles: this must be {\"handles\": [...]}");
  std::vector<HandleGroup> groups;
  for (const json& value : root["handles"]) {
    auto group = group_from(value, model);
    if (!group) return in_context("handle " + std::to_string(groups.size()), group.error());
    groups.push_back(std::move(*group));
  }
  return groups;
}

}  // namespace eigencast::deform
