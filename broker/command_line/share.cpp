// SPDX-License-Identifier: MIT
#include "broker/command_line/share.h"

#ifdef EIGENCAST_HAS_QRENCODE
#include <qrencode.h>
#endif

#include <memory>

#include "broker/access/policy.h"

namespace eigencast::broker {

Result<std::string> viewing_token(const Config& config, std::int64_t now_unix_s) {
  const auto key = TokenKey::from_secret({}, config.access.jwt_secret);
  if (!key) return key.error();
  TokenRequest request;
  request.subject = "shared";
  request.audience = config.access.jwt_audience;
  request.issuer = config.access.jwt_issuer;
  request.subscribe = {"**"};
  request.issued_s = now_unix_s;
  request.expires_s = now_unix_s + kShareS;
  return create_token(request, *key);
}

#ifdef EIGENCAST_HAS_QRENCODE
std::string qr_code(const std::string& text) {
  constexpr int kMargin = 4;  // ISO/IEC 18004, 9.1.
  const std::unique_ptr<QRcode, void (*)(QRcode*)> code(
      QRcode_encodeString(text.c_str(), 0, QR_ECLEVEL_L, QR_MODE_8, 1), QRcode_free);
  if (code == nullptr) return {};
  const int width = code->width;
  const auto is_dark = [&](int x, int y) {
    return x >= 0 && y >= 0 && x < width && y < width && (code->data[y * width + x] & 1) != 0;
  };
  std::string out;
  for (int y = -kMargin; y < width + kMargin; y += 2) {  // Two rows a line: black and white, whatever the terminal's.
    out += "\033[38;5;16;48;5;231m";
    for (int x = -kMargin; x < width + kMargin; ++x) {
      constexpr const char* kBlocks[] = {" ", "\u2584", "\u2580", "\u2588"};
      out += kBlocks[(is_dark(x, y) ? 2 : 0) + (is_dark(x, y + 1) ? 1 : 0)];
    }
    out += "\033[0m\n";
  }
  return out;
}
#else
std::string qr_code(const std::string&) {
  return {};
}
#endif

}  // namespace eigencast::broker
