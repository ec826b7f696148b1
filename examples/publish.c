/* SPDX-License-Identifier: MIT */
/* Publishes a waving sheet for ten seconds: publish http://127.0.0.1:7490/sheet */
#include <eigencast/eigencast.h>
#include <math.h>
#include <stdio.h>
#include <unistd.h>

enum { kSide = 24, kVertices = kSide * kSide, kFaces = 2 * (kSide - 1) * (kSide - 1) };

static int fail(void) {
  fprintf(stderr, "%s\n", ec_last_error());
  return 1;
}

int main(int argc, char** argv) {
  static double rest[3 * kVertices];
  static float pose[3 * kVertices];
  static uint32_t faces[3 * kFaces];
  if (argc < 2) return 2;
  for (uint32_t i = 0, f = 0; i < kVertices; ++i) { /* a sheet */
    const uint32_t x = i % kSide, y = i / kSide;
    rest[3 * i] = x, rest[3 * i + 1] = y;
    if (x + 1 == kSide || y + 1 == kSide) continue;
    const uint32_t corners[6] = {i, i + 1, i + kSide, i + 1, i + kSide + 1, i + kSide};
    for (int k = 0; k < 6; ++k) faces[f++] = corners[k];
  }

  ec_bake_options baking = EC_INIT(ec_bake_options);
  baking.rank = 60;
  ec_asset* asset;
  if (ec_bake(rest, kVertices, faces, kFaces, &baking, &asset) < 0) return fail();
  ec_publisher* publisher;
  if (ec_publisher_create(argv[1], asset, 0, &publisher) < 0) return fail();
  ec_asset_release(asset); /* the publisher keeps what it needs */

  int sent = 0;
  for (int frame = 0; frame < 300; ++frame) { /* ten seconds */
    for (int i = 0; i < kVertices; ++i) {
      pose[3 * i] = (float)rest[3 * i], pose[3 * i + 1] = (float)rest[3 * i + 1];
      pose[3 * i + 2] = (float)sin(0.3 * rest[3 * i] + 0.1 * frame);
    }
    const ec_status status = ec_publisher_send(publisher, pose, ec_now_us());
    if (status < 0) return fail();
    sent += status == EC_OK;
    usleep(33000);
  }
  ec_publisher_release(publisher);
  printf("sent %d poses\n", sent);
  return sent == 0;
}
