// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/surface/appearance.h"
#include "common/surface/formats/parsed_mesh.h"

/// Private to common/surface.
namespace eigencast {

/// Takes over the UVs of the corners and the materials' colours (Kd) and images (map_Kd). Opens files below `folder`
/// only; those that are absent, over 16 MiB or not text leave their material white and their image empty.
void add_obj_appearance(const ParsedMesh& mesh, const std::string& folder, Appearance& appearance);

}  // namespace eigencast
