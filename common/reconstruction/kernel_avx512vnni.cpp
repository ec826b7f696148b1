// SPDX-License-Identifier: MIT
#define EIGENCAST_VARIANT avx512vnni_functions
#include "common/reconstruction/kernel_variant.h"
