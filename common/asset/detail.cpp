// SPDX-License-Identifier: MIT
#include "common/asset/detail.h"

#include <string>

namespace eigencast {

Result<DetailKind> detail_from_name(std::string_view name) {
  for (const DetailKind kind : {DetailKind::kNone, DetailKind::kNormal, DetailKind::kFrames}) {
    if (name == name_of(kind)) return kind;
  }
  return fail(ErrorCode::kInvalidArgument,
              "there is no detail '" + std::string(name) + "': use none, normal or frames");
}

std::string_view name_of(DetailKind kind) {
  switch (kind) {
    case DetailKind::kNone:
      return "none";
    case DetailKind::kNormal:
      return "normal";
    case DetailKind::kFrames:
      return "frames";
  }
  return "unknown";
}

DetailKind detail_of(const Asset& asset) {
  if (asset.detail.size() == 0) return DetailKind::kNone;
  return asset.detail.axes == 1 ? DetailKind::kNormal : DetailKind::kFrames;
}

}  // namespace eigencast
