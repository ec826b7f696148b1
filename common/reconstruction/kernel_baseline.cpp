// SPDX-License-Identifier: MIT
#define EIGENCAST_VARIANT baseline_functions
#include "common/reconstruction/kernel_variant.h"
