// SPDX-License-Identifier: MIT
#define EIGENCAST_VARIANT baseline_panel_functions
#include "common/spectral/panel_kernel_variant.h"
