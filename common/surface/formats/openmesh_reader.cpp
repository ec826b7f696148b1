// SPDX-License-Identifier: MIT
#include "common/surface/formats/openmesh_reader.h"

// MeshIO.hh registers the readers and must stand before the others.
#include <OpenMesh/Core/IO/MeshIO.hh>
#include <OpenMesh/Core/IO/importer/BaseImporter.hh>
#include <OpenMesh/Core/IO/reader/OBJReader.hh>
#include <OpenMesh/Core/IO/reader/OFFReader.hh>
#include <OpenMesh/Core/IO/reader/PLYReader.hh>
#include <OpenMesh/Core/IO/reader/STLReader.hh>
#include <OpenMesh/Core/System/omstream.hh>
#include <algorithm>
#include <cmath>
#include <exception>
#include <locale>
#include <mutex>
#include <sstream>
#include <string>

namespace eigencast {
namespace {

// Fills indexed arrays and nothing else, so that non-manifold vertices stay whole and no face is refused.
class ArrayImporter final : public OpenMesh::IO::BaseImporter {
 public:
  // aliased: an index counts modulo the number of vertices (see guard_obj.cpp).
  explicit ArrayImporter(bool aliased) : aliased_(aliased) {}

  Surface take() { return std::move(surface_); }
  bool is_sound() const { return sound_; }

  OpenMesh::VertexHandle add_vertex(const OpenMesh::Vec3f& p) override {
    surface_.positions.push_back({p[0], p[1], p[2]});
    return OpenMesh::VertexHandle(static_cast<int>(surface_.positions.size()) - 1);
  }
  OpenMesh::VertexHandle add_vertex(const OpenMesh::Vec3d& p) override {
    surface_.positions.push_back({p[0], p[1], p[2]});
    return OpenMesh::VertexHandle(static_cast<int>(surface_.positions.size()) - 1);
  }
  OpenMesh::VertexHandle add_vertex() override { return add_vertex(OpenMesh::Vec3f(0, 0, 0)); }
  void set_point(OpenMesh::VertexHandle v, const OpenMesh::Vec3f& p) override {
    if (v.idx() < 0 || static_cast<std::size_t>(v.idx()) >= surface_.positions.size()) {
      sound_ = false;
    } else {
      surface_.positions[static_cast<std::size_t>(v.idx())] = {p[0], p[1], p[2]};
    }
  }
  OpenMesh::FaceHandle add_face(const VHandles& corners) override {
    const auto n = static_cast<std::uint32_t>(surface_.positions.size());
    polygon_.clear();
    for (const OpenMesh::VertexHandle corner : corners) {
      auto index = static_cast<std::uint32_t>(corner.idx());
      if (aliased_ && n > 0 && corner.idx() >= 0) index %= n;
      if (index >= n) sound_ = false;
      polygon_.push_back(index);
    }
    if (polygon_.size() < 3) sound_ = false;
    for (std::size_t k = 2; k < polygon_.size(); ++k) {
      surface_.faces.push_back({polygon_[0], polygon_[k - 1], polygon_[k]});
    }
    return OpenMesh::FaceHandle(static_cast<int>(surface_.faces.size()) - 1);
  }
  std::size_t n_vertices() const override { return surface_.positions.size(); }
  std::size_t n_faces() const override { return surface_.faces.size(); }
  std::size_t n_edges() const override { return 0; }

  // Attributes and half-edges are not what this importer is for.
  using H = OpenMesh::HalfedgeHandle;
  using V = OpenMesh::VertexHandle;
  using E = OpenMesh::EdgeHandle;
  using F = OpenMesh::FaceHandle;
  H add_edge(V, V) override { return H(); }
  F add_face(H) override { return F(); }
  void add_face_texcoords(F, V, const std::vector<OpenMesh::Vec2f>&) override {}
  void add_face_texcoords(F, V, const std::vector<OpenMesh::Vec3f>&) override {}
  void set_face_texindex(F, int) override {}
  void set_halfedge(V, H) override {}
  void set_normal(V, const OpenMesh::Vec3f&) override {}
  void set_normal(V, const OpenMesh::Vec3d&) override {}
  void set_color(V, const OpenMesh::Vec3uc&) override {}
  void set_color(V, const OpenMesh::Vec4uc&) override {}
  void set_color(V, const OpenMesh::Vec3f&) override {}
  void set_color(V, const OpenMesh::Vec4f&) override {}
  void set_texcoord(V, const OpenMesh::Vec2f&) override {}
  void set_status(V, const OpenMesh::Attributes::StatusInfo&) override {}
  void set_next(H, H) override {}
  void set_face(H, F) override {}
  void request_face_texcoords2D() override {}
  void set_texcoord(H, const OpenMesh::Vec2f&) override {}
  void set_texcoord(V, const OpenMesh::Vec3f&) override {}
  void set_texcoord(H, const OpenMesh::Vec3f&) override {}
  void set_status(H, const OpenMesh::Attributes::StatusInfo&) override {}
  void set_color(E, const OpenMesh::Vec3uc&) override {}
  void set_color(E, const OpenMesh::Vec4uc&) override {}
  void set_color(E, const OpenMesh::Vec3f&) override {}
  void set_color(E, const OpenMesh::Vec4f&) override {}
  void set_status(E, const OpenMesh::Attributes::StatusInfo&) override {}
  void set_normal(F, const OpenMesh::Vec3f&) override {}
  void set_normal(F, const OpenMesh::Vec3d&) override {}
  void set_color(F, const OpenMesh::Vec3uc&) override {}
  void set_color(F, const OpenMesh::Vec4uc&) override {}
  void set_color(F, const OpenMesh::Vec3f&) override {}
  void set_color(F, const OpenMesh::Vec4f&) override {}
  void set_status(F, const OpenMesh::Attributes::StatusInfo&) override {}
  void add_texture_information(int, std::string) override {}

 private:
  Surface surface_;
  std::vector<std::uint32_t> polygon_;
  bool aliased_;
  bool sound_ = true;
};

// OpenMesh's streams are process-wide and print; they are as they were when this ends.
class QuietOpenMesh {
 public:
  QuietOpenMesh() : err_(omerr().is_enabled()), log_(omlog().is_enabled()), out_(omout().is_enabled()) {
    omerr().disable();
    omlog().disable();
    omout().disable();
  }
  ~QuietOpenMesh() {
    if (err_) omerr().enable();
    if (log_) omlog().enable();
    if (out_) omout().enable();
  }
  QuietOpenMesh(const QuietOpenMesh&) = delete;
  QuietOpenMesh& operator=(const QuietOpenMesh&) = delete;

 private:
  bool err_, log_, out_;
};

bool read_with_openmesh(const GuardedMesh& mesh, MeshFormat format, ArrayImporter& importer) {
  static std::mutex mutex;
  const std::lock_guard lock(mutex);
  const QuietOpenMesh quiet;
  std::istringstream in(mesh.plain);
  in.imbue(std::locale::classic());
  OpenMesh::IO::Options options(mesh.binary ? OpenMesh::IO::Options::Binary : OpenMesh::IO::Options::Default);
  switch (format) {
    case MeshFormat::kObj:
      return OpenMesh::IO::OBJReader().read(in, importer, options);
    case MeshFormat::kOff:
      return OpenMesh::IO::OFFReader().read(in, importer, options);
    case MeshFormat::kPly:
      return OpenMesh::IO::PLYReader().read(in, importer, options);
    case MeshFormat::kStl:
      return OpenMesh::IO::STLReader().read(in, importer, options);
  }
  return false;
}

// Equal as 32-bit floats are, with room for a rounding by way of double.
bool is_same_coordinate(double read, double stated) {
  return std::abs(read - stated) <= 2e-7 * std::abs(stated) + 1e-37;
}

Result<void> take_exact_positions(Surface& surface, const GuardedMesh& mesh) {
  const bool same_counts = surface.positions.size() == mesh.positions.size() && surface.faces.size() == mesh.triangles;
  if (!same_counts) {
    return fail(ErrorCode::kInternal, "OpenMesh read " + std::to_string(surface.positions.size()) + " vertices and " +
                                          std::to_string(surface.faces.size()) + " triangles where " +
                                          std::to_string(mesh.positions.size()) + " and " +
                                          std::to_string(mesh.triangles) + " stand; please report the file");
  }
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      if (is_same_coordinate(surface.positions[i][c], mesh.positions[i][c])) continue;
      return fail(ErrorCode::kInternal, "OpenMesh read another position of vertex " + std::to_string(i) +
                                            " than stands there; is the global locale other than \"C\"?");
    }
  }
  surface.positions = mesh.positions;
  return {};
}

}  // namespace

Result<Surface> surface_from_guarded(const GuardedMesh& mesh, MeshFormat format) {
  ArrayImporter importer(format == MeshFormat::kObj);
  try {
    if (!read_with_openmesh(mesh, format, importer)) {
      return fail(ErrorCode::kInternal, "OpenMesh refuses the file; please report it");
    }
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory for the file");
  } catch (const std::exception& e) {
    return fail(ErrorCode::kInternal, std::string("OpenMesh: ") + e.what());
  }
  if (!importer.is_sound()) return fail(ErrorCode::kInternal, "OpenMesh read indices that do not stand in the file");
  Surface surface = importer.take();
  if (format == MeshFormat::kStl) return surface;
  if (const auto exact = take_exact_positions(surface, mesh); !exact) return exact.error();
  return surface;
}

}  // namespace eigencast
