/* SPDX-License-Identifier: MIT */
/* Prints thirty poses of a stream: subscribe http://127.0.0.1:7490/sheet */
#include <eigencast/eigencast.h>
#include <stdio.h>

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  ec_subscriber* subscriber;
  if (ec_subscriber_create(argv[1], 0, &subscriber) < 0) {
    fprintf(stderr, "%s\n", ec_last_error());
    return 1;
  }
  for (int poses = 0; poses < 30;) {
    if (ec_subscriber_next(subscriber, 1000) != EC_OK) continue; /* not yet: it goes on connecting */
    ec_surface surface = EC_INIT(ec_surface);
    if (ec_subscriber_surface(subscriber, 1.0, &surface) < 0) continue;
    printf("%u vertices, %u triangles, the first at height %.3f\n", surface.vertex_count, surface.triangle_count,
           surface.positions[2]);
    ++poses;
  }
  ec_subscriber_release(subscriber);
  return 0;
}
