// SPDX-License-Identifier: MIT
#include "sender/page_file.h"

#include <filesystem>
#include <fstream>
#include <system_error>
#include <variant>

#include "common/core/bytes.h"
#include "sdk/recorded_stream.h"

namespace eigencast {
namespace {

constexpr std::string_view kHere = "{recording}";
constexpr std::size_t kBlockBytes = 3 << 18;  ///< A multiple of three.

std::string base64(ByteView bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t count = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) group = group << 8 | (k < count ? bytes[i + k] : 0u);
    for (std::size_t k = 0; k < 4; ++k) text.push_back(k <= count ? kDigits[group >> (18 - 6 * k) & 63] : '=');
  }
  return text;
}

/// Nothing else can give it to the page.
Result<void> check_surfaces(const std::string& recording) {
  auto stream = RecordedStream::open(recording);
  if (!stream) return stream.error();
  for (;;) {
    const auto event = stream->next();
    if (!event) return in_context(recording, event.error());
    if (!*event) return {};
    const auto* announce = std::get_if<control::Announce>(&(**event).what);
    if (announce != nullptr && !stream->object(*Sha256::from_hex(announce->asset)))
      return fail(ErrorCode::kNotFound,
                  "the recording does not hold its surface, and the cache has not seen it: watch the stream once, or "
                  "record with recording.include_asset = true");
  }
}

}  // namespace

Result<void> write_page(const std::string& recording, const std::string& to,
                        const std::function<bool(double)>& progress) {
  const std::string_view page = player_page();
  const std::size_t here = page.find(kHere);
  if (here == std::string_view::npos)
    return fail(ErrorCode::kUnsupported,
                "this program was built without the page that plays recordings: cmake says what it takes");
  if (const auto whole = check_surfaces(recording); !whole) return whole;
  std::error_code code;
  const std::uintmax_t size = std::filesystem::file_size(recording, code);
  std::ifstream in(recording, std::ios::binary);
  const std::string part = to + ".part";
  const auto written = [&]() -> Result<void> {
    std::ofstream out(part, std::ios::binary | std::ios::trunc);
    out << page.substr(0, here);
    Bytes block(kBlockBytes);
    for (std::uintmax_t done = 0; done < size;) {
      if (progress && !progress(static_cast<double>(done) / static_cast<double>(size)))
        return fail(ErrorCode::kCancelled, "stopped");
      in.read(reinterpret_cast<char*>(block.data()), static_cast<std::streamsize>(block.size()));
      const auto count = static_cast<std::size_t>(in.gcount());
      if (count == 0) return fail(ErrorCode::kIo, recording + ": cannot be read");
      out << base64(ByteView(block).first(count));
      done += count;
    }
    out << page.substr(here + kHere.size());
    out.close();
    if (out) std::filesystem::rename(part, to, code);
    if (!out || code) return fail(ErrorCode::kIo, to + ": cannot be written; is there a folder, and room in it?");
    return {};
  }();
  if (!written) std::filesystem::remove(part, code);
  return written;
}

}  // namespace eigencast
