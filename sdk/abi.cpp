// SPDX-License-Identifier: MIT
// Baking, and what is said of errors.
#include "sdk/abi.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include "common/asset/asset.h"
#include "common/core/clock.h"
#include "common/spectral/known_motion.h"
#include "common/surface/cells.h"
#include "common/surface/checks/check.h"
#include "common/wire/limits.h"
#include "sdk/asset_cache.h"
#include "sdk/asset_folder.h"
#include "sdk/bake.h"

namespace eigencast {
namespace {

thread_local std::string last_error;

/// The index is an ErrorCode.
constexpr ec_status kStatuses[] = {
    EC_INVALID_ARGUMENT, EC_NOT_FOUND,   EC_CORRUPT,     EC_TOO_LARGE, EC_UNSUPPORTED, EC_IO,        EC_UNREACHABLE,
    EC_REFUSED,          EC_UNREACHABLE, EC_UNREACHABLE, EC_CANCELLED, EC_UNSUPPORTED, EC_NUMERICAL, EC_INTERNAL};
constexpr ec_status status_of(ErrorCode code) {
  return kStatuses[static_cast<std::size_t>(code)];
}
static_assert(std::size(kStatuses) == static_cast<std::size_t>(ErrorCode::kInternal) + 1);
static_assert(status_of(ErrorCode::kIo) == EC_IO && status_of(ErrorCode::kRefused) == EC_REFUSED &&
              status_of(ErrorCode::kCancelled) == EC_CANCELLED && status_of(ErrorCode::kInternal) == EC_INTERNAL);

/// Lists EC_INTERNAL up to EC_BAKING.
constexpr std::string_view kNames[] = {
    "internal", "numerical", "cancelled",        "refused", "unreachable", "io",           "unsupported", "too-large",
    "corrupt",  "not-found", "invalid-argument", "ok",      "dropped",     "disconnected", "nothing",     "baking"};
static_assert(std::size(kNames) == EC_BAKING - EC_INTERNAL + 1);
static_assert(kNames[EC_REFUSED - EC_INTERNAL] == "refused" && kNames[EC_OK - EC_INTERNAL] == "ok" &&
              kNames[EC_NOTHING - EC_INTERNAL] == "nothing");

/// Null: no appearance is given. Errors: kInvalidArgument, kTooLarge.
Result<std::optional<Appearance>> appearance_from(const ec_appearance* given, const Surface& surface) {
  if (given == nullptr) return std::optional<Appearance>();
  if (abi::lacks_size(given))
    return fail(ErrorCode::kInvalidArgument, "ec_bake: struct_size of the appearance is not set; use EC_INIT");
  const ec_appearance appearance = abi::filled(given);
  const bool has_uv = appearance.corner_uv != nullptr || appearance.vertex_uv != nullptr;
  if ((appearance.image != nullptr) != has_uv || (appearance.corner_uv != nullptr && appearance.vertex_uv != nullptr)) {
    return fail(ErrorCode::kInvalidArgument, "ec_bake: give an image together with either corner_uv or vertex_uv");
  }
  if (has_uv && surface.is_point_cloud())
    return fail(ErrorCode::kInvalidArgument, "ec_bake: a point cloud has no faces that an image could lie on");
  Appearance made;
  if (appearance.vertex_colours != nullptr) {
    made.vertex_colour.resize(surface.vertex_count());
    std::memcpy(made.vertex_colour.data(), appearance.vertex_colours, 3 * surface.vertex_count());
  }
  if (!has_uv) return std::optional(std::move(made));
  if (appearance.image_size > AssetTexture::kMaxImageBytes)
    return fail(ErrorCode::kTooLarge, "ec_bake: the image has more than 16 MiB; make it smaller, or of fewer pixels");
  const auto* bytes = static_cast<const std::uint8_t*>(appearance.image);
  made.images.push_back({"appearance", "", {bytes, bytes + appearance.image_size}});
  if (const auto usable = check_image(made.images.front()); !usable) return in_context("ec_bake", usable.error());
  if (const auto valid = validate_surface(surface); !valid) return valid.error();
  made.corner_uv.resize(surface.faces.size());
  for (std::size_t f = 0; f < surface.faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const float* uv = appearance.corner_uv != nullptr ? appearance.corner_uv + 2 * (3 * f + k)
                                                        : appearance.vertex_uv + 2 * std::size_t{surface.faces[f][k]};
      made.corner_uv[f][k] = {uv[0], uv[1]};
    }
  }
  return std::optional(std::move(made));
}

/// The poses as a motion, which they must outlive.
KnownMotion motion_from(const ec_bake_options& given, std::size_t vertices) {
  const auto pose = [all = given.poses, vertices](std::size_t i) -> Result<std::vector<Vec3>> {
    std::vector<Vec3> positions(vertices);
    for (std::size_t v = 0; v < vertices; ++v) {
      const float* from = all + 3 * (i * vertices + v);
      positions[v] = {from[0], from[1], from[2]};
    }
    return positions;
  };
  return {{}, given.poses != nullptr ? given.pose_count : 0, pose, given.pose_rate_hz};
}

/// What a basis of a motion is made of; `samples` else.
Result<KnownMotion> motion_of_basis(const ec_bake_options& given, BasisKind basis, std::size_t vertices,
                                    KnownMotion samples) {
  if (!is_of_columns(basis) || given.columns == nullptr) return samples;
  const std::size_t count = given.column_count;
  if (count > SpanningColumns::kMaxColumns || vertices * count * sizeof(double) > SpanningColumns::kMaxBytes)
    return fail(ErrorCode::kTooLarge, "ec_bake: " + std::to_string(count) + " columns of " + std::to_string(vertices) +
                                          " vertices: at most 2048 columns, and 2 GiB of them");
  const std::span all(given.columns, vertices * count);
  if (!std::all_of(all.begin(), all.end(), [](double w) { return std::isfinite(w); }))
    return fail(ErrorCode::kInvalidArgument, "ec_bake: a number of the columns is not finite");
  samples.columns = {count, {all.begin(), all.end()}};
  return samples;
}

}  // namespace

Result<Surface> abi::surface_from(const double* positions, std::uint32_t vertices, const std::uint32_t* faces,
                                  std::uint32_t face_count) {
  if (positions == nullptr || (faces == nullptr && face_count > 0)) {
    return fail(ErrorCode::kInvalidArgument, "positions, or faces with face_count > 0, is null");
  }
  Surface surface;
  surface.positions.resize(vertices);
  surface.faces.resize(face_count);
  for (std::size_t i = 0; i < vertices; ++i) std::copy_n(positions + 3 * i, 3, surface.positions[i].begin());
  for (std::size_t i = 0; i < face_count; ++i) std::copy_n(faces + 3 * i, 3, surface.faces[i].begin());
  return surface;
}

Result<BakeOptions> abi::bake_options_from(const ec_bake_options& given) {
  BakeOptions options;
  const auto basis = basis_from_name(text_or(given.basis, std::string(name_of(options.basis))));
  if (!basis) return basis.error();
  options.basis = *basis;
  if (is_of_columns(*basis)) options.asset_error = 0;
  options.rank = is_of_columns(*basis) ? static_cast<int>(limits::kMaxRows) : *basis == BasisKind::kPca ? 50 : 200;
  if (given.detail != nullptr) {
    const auto detail = detail_from_name(given.detail);
    if (!detail) return detail.error();
    options.detail = *detail;
  }
  const auto solver = kSolverNames.find(text_or(given.solver, std::string(kSolverNames[options.solver])));
  if (!solver) return fail(ErrorCode::kInvalidArgument, "the solver must be lanczos or spectra");
  options.solver = *solver;
  options.name = text_or(given.name, {});
  const int asks = (given.quality != 0) + (given.target_error != 0) + (given.bitrate != 0);
  if ((given.rank > 0) + asks > 1)
    return fail(ErrorCode::kInvalidArgument, "give one of rank, quality, target_error and bitrate");
  const bool chooses = given.poses != nullptr && given.pose_count > 1 && !is_of_motion(*basis) &&
                       detail_of(options) == DetailKind::kNone;
  if (asks > 0 || (given.rank == 0 && chooses))
    options.wish = BakeWish{given.quality != 0 ? given.quality : 1, given.target_error, given.bitrate / 1000};
  if (given.rank > 0) options.rank = static_cast<int>(std::min<std::uint32_t>(given.rank, 1u << 20));
  return options;
}

ec_status abi::failed(const Error& error) {
  last_error = error.message;
  return status_of(error.code);
}

ec_status abi::invalid(const char* text) {
  return failed(fail(ErrorCode::kInvalidArgument, text));
}

}  // namespace eigencast

using namespace eigencast;
using namespace eigencast::abi;

const char* ec_version(void) {
  return EIGENCAST_VERSION;
}

const char* ec_strerror(ec_status status) {
  return status >= EC_INTERNAL && status <= EC_BAKING ? kNames[status - EC_INTERNAL].data() : "unknown";
}

const char* ec_last_error(void) {
  return last_error.c_str();
}

int64_t ec_now_us(void) {
  return steady_now_us();
}

ec_status ec_bake(const double* positions, uint32_t vertex_count, const uint32_t* faces, uint32_t face_count,
                  const ec_bake_options* options, ec_asset** asset) {
  return guarded([&] {
    if (asset == nullptr) return invalid("ec_bake: asset is null");
    if (lacks_size(options)) return invalid("ec_bake: struct_size of the options is not set; use EC_INIT");
    const ec_bake_options given = filled(options);
    const auto surface = surface_from(positions, vertex_count, faces, face_count);
    if (!surface) return failed(surface.error());
    const auto appearance = appearance_from(given.appearance, *surface);
    if (!appearance) return failed(appearance.error());
    auto made = bake_options_from(given);
    if (!made) return failed(made.error());
    BakeOptions& bake_options = *made;
    if (*appearance) bake_options.appearance = &**appearance;
    const KnownMotion samples = motion_from(given, vertex_count);
    bake_options.samples = &samples;
    const auto motion = motion_of_basis(given, bake_options.basis, vertex_count, samples);
    if (!motion) return failed(motion.error());
    if (is_of_motion(bake_options.basis)) bake_options.motion = &*motion;
    BakeProgress progress;
    if (given.progress != nullptr) {
      progress = [&given](double fraction, std::string_view stage) {
        return given.progress(given.user, fraction, std::string(stage).c_str()) == 0;
      };
    }
    auto baked =
        bake(*surface, bake_options, given.cache_dir != nullptr ? given.cache_dir : default_cache_dir(), progress);
    if (!baked) return failed(baked.error());
    *asset = new ec_asset{std::make_shared<const Asset>(std::move(baked->asset)),
                          std::make_shared<const EncodedAsset>(std::move(baked->encoded)), baked->from_cache,
                          is_triangle_soup(*surface)};
    return EC_OK;
  });
}

ec_status ec_asset_load(const char* folder, const char* id, ec_asset** asset) {
  return guarded([&] {
    if (folder == nullptr || id == nullptr || asset == nullptr)
      return invalid("ec_asset_load: folder, id or asset is null");
    const auto hash = Sha256::from_hex(id);
    if (!hash) return invalid("ec_asset_load: the id is not one of 64 hexadecimal digits");
    auto loaded = read_asset(folder, *hash);
    if (!loaded) return failed(loaded.error());
    *asset = new ec_asset{std::make_shared<const Asset>(std::move(loaded->asset)),
                          std::make_shared<const EncodedAsset>(std::move(loaded->encoded)), true};
    return EC_OK;
  });
}

ec_status ec_asset_save(const ec_asset* asset, const char* folder) {
  return guarded([&] {
    if (asset == nullptr || folder == nullptr) return invalid("ec_asset_save: asset or folder is null");
    const auto written = write_asset(*asset->encoded, asset->asset->coding_error, folder);
    return written ? EC_OK : failed(written.error());
  });
}

ec_status ec_asset_get_info(const ec_asset* asset, ec_asset_info* info) {
  return guarded([&] {
    if (asset == nullptr) return invalid("ec_asset_get_info: asset is null");
    ec_asset_info result = EC_INIT(ec_asset_info);
    result.vertex_count = asset->asset->vertex_count;
    result.face_count = asset->asset->face_total;
    result.rank = asset->asset->rank;
    result.from_cache = asset->from_cache ? 1 : 0;
    result.loose_faces = asset->loose_faces ? 1 : 0;
    const std::string id = asset->encoded->manifest.id.hex();
    std::copy_n(id.c_str(), sizeof result.id, result.id);
    return give(info, result);
  });
}

void ec_asset_release(ec_asset* asset) {
  delete asset;
}
