// SPDX-License-Identifier: MIT
#pragma once

#include <string>

namespace eigencast::testing {

/// Drops `uris` (text/uri-list) onto the only window of a client on this X display, as a file manager does (XDND 5),
/// from a connection of its own. False: there is no such window, or it did not take them within five seconds.
bool drop_on_window(const std::string& display, const std::string& uris);

/// Says how dense the display is, as desktops do (the resource Xft.dpi), to all programs that start afterwards. False:
/// no such display.
bool set_display_density(const std::string& display, int dpi);

}  // namespace eigencast::testing
