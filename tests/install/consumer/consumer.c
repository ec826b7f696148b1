/* SPDX-License-Identifier: MIT */
/* The installed header is C, and the library's error text reaches C. */
#include <eigencast/eigencast.h>
#include <string.h>

/* Programs that were built against an earlier header go on working: members stay where they are, new ones come behind.
 * 64-bit; a change of one of these numbers breaks them. */
#define AT(type, member, offset) _Static_assert(offsetof(type, member) == (offset), #type "." #member " has moved")
AT(ec_bake_options, user, 48);
AT(ec_bake_options, appearance, 56);
AT(ec_bake_options, solver, 64);
AT(ec_bake_options, quality, 72);
AT(ec_bake_options, poses, 96);
AT(ec_bake_options, pose_rate_hz, 112);
AT(ec_appearance, vertex_uv, 40);
AT(ec_asset_info, from_cache, 88);
AT(ec_publisher_options, velocities, 88);
AT(ec_publisher_options, scalar_info, 96);
AT(ec_publisher_stats, reconnects, 40);
AT(ec_pose, capture_us, 32);
AT(ec_subscriber_options, insecure, 48);
AT(ec_subscriber_options, max_memory_bytes, 56);
AT(ec_subscriber_stats, latency_p99_us, 64);
AT(ec_subscriber_stats, retry_in_us, 72);
AT(ec_surface, velocities, 80);
AT(ec_surface, image_size, 112);
AT(ec_surface, scalar_info, 120);

enum { kSide = 8, kVertices = kSide * kSide, kFaces = 2 * (kSide - 1) * (kSide - 1) };
static double rest[3 * kVertices];
static uint32_t faces[3 * kFaces];

/* What stands behind the length that a struct states is not read. */
static int old_options_work(void) {
  ec_asset* asset = 0;
  ec_bake_options options = EC_INIT(ec_bake_options);
  options.struct_size = offsetof(ec_bake_options, appearance);
  options.rank = 10;
  options.cache_dir = "";
  memset((char*)&options + options.struct_size, 0x5a, sizeof options - options.struct_size);
  if (ec_bake(rest, kVertices, faces, kFaces, &options, &asset) != EC_OK) return 0;
  ec_publisher* publisher = 0;
  ec_publisher_options many = EC_INIT(ec_publisher_options);
  many.scalars = 10; /* Without names. */
  many.struct_size = offsetof(ec_publisher_options, scalar_info);
  memset((char*)&many + many.struct_size, 0x5a, sizeof many - many.struct_size);
  const ec_status status = ec_publisher_create("ws://127.0.0.1:9/x", asset, &many, &publisher);
  ec_publisher_release(publisher);
  many.scalars = 0xffffffff;
  const ec_status too_many = ec_publisher_create("ws://127.0.0.1:9/x", asset, &many, &publisher);
  ec_asset_release(asset);
  return status == EC_OK && too_many == EC_INVALID_ARGUMENT;
}

static int appearances_are_checked(void) {
  static const unsigned char png[9] = "\x89PNG\r\n\x1a\n";
  static float uv[2 * kVertices];
  ec_asset *plain = 0, *painted = 0;
  ec_appearance appearance = EC_INIT(ec_appearance);
  ec_bake_options options = EC_INIT(ec_bake_options);
  options.rank = 10;
  options.cache_dir = "";
  if (ec_bake(rest, kVertices, faces, kFaces, &options, &plain) != EC_OK) return 0;
  options.appearance = &appearance;
  appearance.image = png, appearance.image_size = sizeof png;
  if (ec_bake(rest, kVertices, faces, kFaces, &options, &painted) != EC_INVALID_ARGUMENT) return 0; /* no UVs */
  appearance.vertex_uv = uv;
  if (ec_bake(rest, kVertices, faces, kFaces, &options, &painted) != EC_OK) return 0;
  ec_asset_info one = EC_INIT(ec_asset_info), other = EC_INIT(ec_asset_info);
  const int another = ec_asset_get_info(plain, &one) == EC_OK && ec_asset_get_info(painted, &other) == EC_OK &&
                      strcmp(one.id, other.id) != 0;
  ec_asset_release(plain);
  ec_asset_release(painted);
  return another;
}

int main(void) {
  for (uint32_t i = 0, f = 0; i < kVertices; ++i) {
    const uint32_t x = i % kSide, y = i / kSide;
    rest[3 * i] = x, rest[3 * i + 1] = y, rest[3 * i + 2] = 0.1 * (x * y % 5);
    if (x + 1 == kSide || y + 1 == kSide) continue;
    const uint32_t corners[6] = {i, i + 1, i + kSide, i + 1, i + kSide + 1, i + kSide};
    for (int k = 0; k < 6; ++k) faces[f++] = corners[k];
  }
  if (!old_options_work()) return 4;
  if (!appearances_are_checked()) return 5;
  const double positions[3] = {0, 0, 0};
  ec_asset* asset = 0;
  ec_bake_options options = EC_INIT(ec_bake_options);
  options.cache_dir = "";
  if (ec_bake(positions, 1, 0, 0, &options, &asset) >= 0) return 1;
  if (strlen(ec_last_error()) == 0 || asset != 0) return 2;
  return strcmp(ec_strerror(EC_OK), "ok") != 0;
}
