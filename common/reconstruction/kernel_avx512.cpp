// SPDX-License-Identifier: MIT
#define EIGENCAST_VARIANT avx512_functions
#include "common/reconstruction/kernel_variant.h"
