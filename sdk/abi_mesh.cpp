// SPDX-License-Identifier: MIT
#include <utility>

#include "common/surface/cells.h"
#include "sdk/abi.h"

struct ec_mesh {
  eigencast::PickedSurface surface;
};

using namespace eigencast;
using namespace eigencast::abi;

namespace {

ec_status made(Result<PickedSurface> surface, ec_mesh** mesh) {
  if (!surface) return failed(surface.error());
  *mesh = new ec_mesh{std::move(*surface)};
  return EC_OK;
}

}  // namespace

ec_status ec_mesh_triangles(const uint32_t* connectivity, size_t corner_count, const uint64_t* offsets,
                            size_t offset_count, ec_mesh** mesh) {
  return guarded([&] {
    if ((connectivity == nullptr && corner_count > 0) || offsets == nullptr || mesh == nullptr)
      return invalid("ec_mesh_triangles: connectivity, offsets or mesh is null");
    auto faces = fanned({connectivity, corner_count}, {offsets, offset_count});
    if (!faces) return failed(faces.error());
    return made(PickedSurface{{}, std::move(*faces)}, mesh);
  });
}

ec_status ec_mesh_boundary(const double* points, uint32_t point_count, const uint32_t* cells, size_t corner_count,
                           const char* kind, ec_mesh** mesh) {
  return guarded([&] {
    if (points == nullptr || cells == nullptr || kind == nullptr || mesh == nullptr)
      return invalid("ec_mesh_boundary: points, cells, kind or mesh is null");
    const auto known = kCellKindNames.find(kind);
    if (!known) return invalid("ec_mesh_boundary: kind must be tetra, hexahedron, wedge or pyramid");
    const auto surface = surface_from(points, point_count, nullptr, 0);
    if (!surface) return failed(surface.error());
    return made(boundary_of(surface->positions, {cells, corner_count}, *known), mesh);
  });
}

ec_status ec_mesh_weld(const double* points, uint32_t point_count, const uint32_t* faces, uint32_t face_count,
                       double tolerance, ec_mesh** mesh) {
  return guarded([&] {
    if (mesh == nullptr) return invalid("ec_mesh_weld: mesh is null");
    const auto surface = surface_from(points, point_count, faces, face_count);
    if (!surface) return failed(surface.error());
    return made(welded(*surface, tolerance), mesh);
  });
}

ec_status ec_mesh_get(const ec_mesh* mesh, ec_mesh_arrays* arrays) {
  return guarded([&] {
    if (mesh == nullptr) return invalid("ec_mesh_get: mesh is null");
    ec_mesh_arrays result = EC_INIT(ec_mesh_arrays);
    result.vertex_count = static_cast<std::uint32_t>(mesh->surface.vertices.size());
    result.face_count = static_cast<std::uint32_t>(mesh->surface.faces.size());
    result.vertices = mesh->surface.vertices.data();
    result.faces = mesh->surface.faces.empty() ? nullptr : mesh->surface.faces.front().data();
    return give(arrays, result);
  });
}

void ec_mesh_release(ec_mesh* mesh) {
  delete mesh;
}
