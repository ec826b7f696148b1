// SPDX-License-Identifier: MIT
#include "common/core/random_id.h"

#include <random>

namespace eigencast {

std::string random_id(std::size_t digits) {
  std::random_device device;
  std::string id;
  while (id.size() < digits) id += "0123456789abcdef"[device() & 15];
  return id;
}

}  // namespace eigencast
