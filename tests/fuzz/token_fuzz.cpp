// SPDX-License-Identifier: MIT
// Tokens, and the lines of a token file: no input crashes, and nothing that the key did not sign is accepted.
#include <cstdint>
#include <cstdlib>
#include <string>

#include "broker/access/jwt.h"
#include "broker/access/token_file.h"
#include "common/core/text.h"

using namespace eigencast;
using namespace eigencast::broker;

namespace {

TokenRules rules() {
  TokenRules made;
  made.keys.push_back(TokenKey::from_secret("fuzz", "a secret of more than thirty-two bytes").value());
  return made;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const TokenRules kRules = rules();
  const std::string text(static_cast<const char*>(static_cast<const void*>(data)), size);
  (void)verify_token(text, kRules, 1'800'000'000);
  (void)read_token(text);
  // The same bytes as claims under a good signature, so that what reads them is reached.
  const auto base64url = [](const auto& bytes) {
    return base64_from_bytes(Bytes(bytes.begin(), bytes.end()), Base64::kUrl);
  };
  const std::string message = base64url(std::string(R"({"alg":"HS256","kid":"fuzz"})")) + "." + base64url(text);
  const auto signature = kRules.keys.front().sign(message).value();
  const auto claims = verify_token(message + "." + base64url(signature), kRules, 1'800'000'000);
  if (claims && claims->expires_s <= 1'800'000'000) std::abort();
  if (const auto file = TokenFile::from_text(text, "f"); file && file->find(text) != nullptr) std::abort();
  return 0;
}
