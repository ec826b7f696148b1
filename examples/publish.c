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
  static float pose[3 * kVertices];
  static uint32_t faces[3 * kFaces];
  if (argc < 2) return 2;
  for (uint32_t i = 0, f = 0; i < kVertices; ++i) { /* a sheet */
    const uint32_t x = i % kSide, y = i / kSide;
    pose[3 * i] = (float)x, pose[3 * i + 1] = (float)y;
    if (x + 1 == kSide || y + 1 == kSide) continue;
    const uint32_t corners[6] = {i, i + 1, i + kSide, i + 1, i + kSide + 1, i + kSide};
    for (int k = 0; k < 6; ++k) faces[f++] = corners[k];
  }

  ec_stream* stream; /* bakes in a thread at the first pose, publishes, and reconnects */
  if (ec_stream_create(argv[1], 0, &stream) < 0) return fail();
  ec_frame frame = EC_INIT(ec_frame);
  frame.points = pose, frame.point_count = kVertices, frame.corners = faces, frame.corner_count = 3 * kFaces;
  for (int i = 0; i < 300; ++i) { /* ten seconds */
    for (int v = 0; v < kVertices; ++v) pose[3 * v + 2] = (float)sin(0.3 * pose[3 * v] + 0.1 * i);
    if (ec_stream_send(stream, &frame) < 0) return fail();
    usleep(33000);
  }
  ec_stream_stats stats = EC_INIT(ec_stream_stats);
  ec_stream_get_stats(stream, &stats);
  printf("sent %llu poses; %s\n", (unsigned long long)stats.poses_sent, stats.detail);
  ec_stream_release(stream);
  return stats.poses_sent == 0;
}
