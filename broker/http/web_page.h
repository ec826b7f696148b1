// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "broker/http/http_connection.h"

namespace eigencast::broker {

/// A file of the page; its codings are empty where they are not shorter.
struct WebFile {
  std::string_view name;
  std::string_view plain;
  std::string_view gzip;
  std::string_view brotli;
};
/// What was built into this program, page.html included; empty: the page was not.
std::span<const WebFile> web_files();
/// Changes with their contents; a part of their URLs.
std::string_view web_version();

/// Whether this broker has a page to show.
bool has_page(const Config& config);

/// For answers that are the same for everybody.
inline const std::pair<std::string_view, std::string> kAnyOrigin{"Access-Control-Allow-Origin", "*"};

// Neither needs rights; both count towards the rates of the client's address.

/// Answers a GET or HEAD of "/" (no `stream`) or of a stream's URL: by the page if HTML is wanted, else by relative
/// URLs as JSON (docs/protocol.md, section 9). Neither says whether the stream exists, but for the page's link to the
/// asset where the same request without the page would be told of it.
void serve_page(HttpConnection& connection, const std::string& stream);
/// Answers a GET or HEAD of the rest of a path below /v1/web/: NAME, or VERSION/NAME, which never changes.
void serve_web_file(HttpConnection& connection, std::string_view rest);

}  // namespace eigencast::broker
