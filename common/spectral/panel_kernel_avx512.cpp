// SPDX-License-Identifier: MIT
#define EIGENCAST_VARIANT avx512_panel_functions
#include "common/spectral/panel_kernel_variant.h"
