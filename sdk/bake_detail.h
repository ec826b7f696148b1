// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/detail.h"
#include "common/asset/format/encode.h"
#include "common/surface/surface.h"

namespace eigencast {

/// What the asset's basis leaves out of the rest pose.
///   asset    as it is to be encoded: complete, without detail
///   surface  its source
///   normals  of a point cloud, in the source's order; empty for meshes, whose faces give them
///   encoding of the asset: rounding derivatives moves vertices by no more than rounding the basis does
/// REQUIRES: kind is not kNone.
Asset::Detail detail_from(DetailKind kind, const Asset& asset, const Surface& surface, std::span<const Vec3> normals,
                          const AssetEncoding& encoding);

}  // namespace eigencast
