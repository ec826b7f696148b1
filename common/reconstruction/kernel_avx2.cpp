// SPDX-License-Identifier: MIT
#define EIGENCAST_VARIANT avx2_functions
#include "common/reconstruction/kernel_variant.h"
