/* SPDX-License-Identifier: MIT */
/* The installed header is C, and the library's error text reaches C. */
#include <eigencast/eigencast.h>
#include <string.h>

int main(void) {
  const double positions[3] = {0, 0, 0};
  ec_asset* asset = 0;
  ec_bake_options options = EC_INIT(ec_bake_options);
  options.cache_dir = "";
  if (ec_bake(positions, 1, 0, 0, &options, &asset) >= 0) return 1;
  if (strlen(ec_last_error()) == 0 || asset != 0) return 2;
  return strcmp(ec_strerror(EC_OK), "ok") != 0;
}
