// SPDX-License-Identifier: MIT
#include "broker/access/tls_context.h"

#include <openssl/asn1.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509.h>

#include <algorithm>
#include <array>
#include <ctime>
#include <span>
#include <string>

#include "broker/access/signature.h"

namespace eigencast::broker {
namespace {

/// Of TLS 1.2: forward secrecy and authenticated encryption only. All ciphers of 1.3 have both.
constexpr const char* kCiphers = "ECDHE+AESGCM:ECDHE+CHACHA20";
constexpr unsigned char kSessionContext[] = "eigencast";
constexpr long kMaxCertificateBytes = 4 * 1024;  ///< A client's: two of RSA-4096; each byte may take 1.2 us.

std::string openssl_reason() {
  std::array<char, 256> text{};
  const unsigned long code = ERR_peek_last_error();
  ERR_error_string_n(code, text.data(), text.size());
  ERR_clear_error();
  const char* plain = ERR_reason_error_string(code);
  return plain != nullptr ? plain : text.data();
}

Error tls_error(const char* setting, const std::string& path, const std::string& why) {
  return fail(ErrorCode::kInvalidArgument, std::string(setting) + " = " + path + ": " + why);
}

/// ALPN: HTTP/1.1 only; the handshake fails for clients that offer only others (h2).
int choose_protocol(SSL*, const unsigned char** out, unsigned char* out_size, const unsigned char* in,
                    unsigned int in_size, void*) {
  static constexpr unsigned char kHttp[] = "\x08http/1.1";
  unsigned char* chosen = nullptr;
  const int found = SSL_select_next_proto(&chosen, out_size, kHttp, sizeof(kHttp) - 1, in, in_size);
  *out = chosen;
  return found == OPENSSL_NPN_NEGOTIATED ? SSL_TLSEXT_ERR_OK : SSL_TLSEXT_ERR_ALERT_FATAL;
}

/// Refuses long lists in a ClientHello: OpenSSL takes up to 100 ns a byte to read them, and keeps objects of 50 times
/// their bytes as long as the connection. Clients send some 100 bytes of each; only keys and tickets are long.
int check_hello(SSL* tls, int*, void*) {
  constexpr std::size_t kMaxListBytes = 512, kMaxLongBytes = 4096;
  constexpr std::array kLong{TLSEXT_TYPE_key_share, TLSEXT_TYPE_psk, TLSEXT_TYPE_session_ticket, TLSEXT_TYPE_padding};
  const unsigned char* bytes = nullptr;
  std::size_t size = SSL_client_hello_get0_ciphers(tls, &bytes), count = 0;
  int* kinds = nullptr;
  bool fits = size <= kMaxListBytes && SSL_client_hello_get1_extensions_present(tls, &kinds, &count) == 1;
  for (const int kind : std::span(kinds, count)) {
    const bool is_long = std::find(kLong.begin(), kLong.end(), kind) != kLong.end();
    fits = fits && SSL_client_hello_get0_ext(tls, static_cast<unsigned>(kind), &bytes, &size) == 1 &&
           size <= (is_long ? kMaxLongBytes : kMaxListBytes);
  }
  OPENSSL_free(kinds);
  return fits ? SSL_CLIENT_HELLO_SUCCESS : SSL_CLIENT_HELLO_ERROR;
}

Result<void> load_pair(SSL_CTX* context, const Config& config) {
  const std::string certificate = resolved_path(config.tls.certificate);
  const std::string key = resolved_path(config.tls.key);
  if (SSL_CTX_use_certificate_chain_file(context, certificate.c_str()) != 1) {
    return tls_error("tls.certificate", certificate, "no certificate chain in PEM can be read: " + openssl_reason());
  }
  if (SSL_CTX_use_PrivateKey_file(context, key.c_str(), SSL_FILETYPE_PEM) != 1) {
    return tls_error("tls.key", key, "no private key in PEM for this certificate can be read: " + openssl_reason());
  }
  if (SSL_CTX_check_private_key(context) != 1) {
    return tls_error("tls.key", key, "is not the key of tls.certificate: " + openssl_reason());
  }
  return {};
}

Result<void> ask_clients(SSL_CTX* context, const Config& config) {
  if (config.tls.client_ca.empty()) return {};
  const std::string path = resolved_path(config.tls.client_ca);
  const char* file = path.c_str();
  STACK_OF(X509_NAME)* names = SSL_load_client_CA_file(file);
  if (names == nullptr || SSL_CTX_load_verify_file(context, file) != 1) {
    sk_X509_NAME_pop_free(names, X509_NAME_free);
    return tls_error("tls.client_ca", path, "no certificates in PEM can be read: " + openssl_reason());
  }
  SSL_CTX_set_client_CA_list(context, names);
  SSL_CTX_set_max_cert_list(context, kMaxCertificateBytes);
  const int require = config.tls.require_client_certificate ? SSL_VERIFY_FAIL_IF_NO_PEER_CERT : 0;
  SSL_CTX_set_verify(context, SSL_VERIFY_PEER | require, nullptr);
  return {};
}

}  // namespace

Result<std::shared_ptr<SSL_CTX>> make_tls_context(const Config& config) {
  if (config.tls.certificate.empty()) return std::shared_ptr<SSL_CTX>();
  const std::shared_ptr<SSL_CTX> context(SSL_CTX_new(TLS_server_method()), SSL_CTX_free);
  if (!context) return fail(ErrorCode::kInternal, "no TLS: " + openssl_reason());
  const bool only_13 = config.tls.min_version == "1.3";
  SSL_CTX_set_cipher_list(context.get(), kCiphers);
  SSL_CTX_set1_groups_list(context.get(), "X25519:P-256");  // Others take up to 100 times as long.
  SSL_CTX_set_min_proto_version(context.get(), only_13 ? TLS1_3_VERSION : TLS1_2_VERSION);
  SSL_CTX_set_options(context.get(), SSL_OP_NO_COMPRESSION | SSL_OP_NO_RENEGOTIATION | SSL_OP_CIPHER_SERVER_PREFERENCE |
                                         SSL_OP_PRIORITIZE_CHACHA);
  SSL_CTX_set_mode(context.get(), SSL_MODE_RELEASE_BUFFERS);
  SSL_CTX_set_num_tickets(context.get(), 1);  // A resumed session gets a new ticket.
  SSL_CTX_set_client_hello_cb(context.get(), check_hello, nullptr);
  SSL_CTX_set_default_passwd_cb(context.get(), no_passphrase);
  SSL_CTX_set_alpn_select_cb(context.get(), choose_protocol, nullptr);
  // Without it a client that shows a certificate cannot resume its session.
  SSL_CTX_set_session_id_context(context.get(), kSessionContext, sizeof kSessionContext - 1);
  if (auto loaded = load_pair(context.get(), config); !loaded) return loaded.error();
  if (auto asked = ask_clients(context.get(), config); !asked) return asked.error();
  return context;
}

std::int64_t certificate_expires_s(const SSL_CTX* context) {
  std::tm end{};
  if (ASN1_TIME_to_tm(X509_get0_notAfter(SSL_CTX_get0_certificate(context)), &end) != 1) return 0;
  return timegm(&end);
}

}  // namespace eigencast::broker
