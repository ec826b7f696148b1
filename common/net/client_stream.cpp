// SPDX-License-Identifier: MIT
#include "common/net/client_stream.h"

#include <arpa/inet.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>

#include <algorithm>
#include <array>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/error.hpp>
#include <boost/beast/http/error.hpp>
#include <boost/beast/websocket/teardown.hpp>

#include "common/core/text.h"

namespace eigencast {
namespace {

namespace ssl = boost::asio::ssl;
using boost::system::error_code;

constexpr int kMaxNames = 6;

Error wrong_file(const std::string& file, const std::string& what, const error_code& why) {
  return fail(ErrorCode::kInvalidArgument, file + ": no " + what + " in PEM can be read here: " + why.message());
}

Result<void> load_own(ssl::context& context, const Credentials& own) {
  if (own.certificate_file.empty() && own.key_file.empty()) return {};
  if (own.certificate_file.empty() || own.key_file.empty()) {
    return fail(ErrorCode::kInvalidArgument,
                "a certificate of one's own and its private key go together (--cert and --key): give both, or none");
  }
  error_code why;
  // A passphrase is not asked for on the terminal: nobody may be there.
  context.set_password_callback([](std::size_t, ssl::context::password_purpose) { return std::string(); }, why);
  if (context.use_certificate_chain_file(own.certificate_file, why)) {
    return wrong_file(own.certificate_file, "certificate", why);
  }
  if (context.use_private_key_file(own.key_file, ssl::context::pem, why)) {
    return wrong_file(own.key_file, "private key of " + own.certificate_file, why);
  }
  return {};
}

std::string text_of(const GENERAL_NAME& name) {
  const ASN1_STRING* value = name.type == GEN_DNS     ? name.d.dNSName
                             : name.type == GEN_IPADD ? name.d.iPAddress
                                                      : nullptr;
  if (value == nullptr) return {};
  const auto length = static_cast<std::size_t>(ASN1_STRING_length(value));
  const void* bytes = ASN1_STRING_get0_data(value);
  if (name.type == GEN_DNS) return escaped({static_cast<const char*>(bytes), std::min<std::size_t>(length, 100)});
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (length != 4 && length != 16) return {};
  inet_ntop(length == 4 ? AF_INET : AF_INET6, bytes, text.data(), text.size());
  return text.data();
}

std::string names_of(const X509* certificate) {
  auto* names = static_cast<GENERAL_NAMES*>(X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr));
  std::string out;
  for (int i = 0; i < sk_GENERAL_NAME_num(names) && i < kMaxNames; ++i) {
    const std::string text = text_of(*sk_GENERAL_NAME_value(names, i));
    if (!text.empty()) out += (out.empty() ? "" : ", ") + text;
  }
  GENERAL_NAMES_free(names);
  return out.empty() ? "no host at all" : out;
}

std::string text_of(const ASN1_TIME* time) {
  std::tm when{};
  std::array<char, 32> text{};
  if (ASN1_TIME_to_tm(time, &when) != 1) return "a time that cannot be read";
  return {text.data(), std::strftime(text.data(), text.size(), "%Y-%m-%d %H:%M UTC", &when)};
}

/// What is wrong with the current certificate, and what to do.
std::string complaint(X509_STORE_CTX* state, const std::string& host, const std::string& ca_file) {
  const X509* certificate = X509_STORE_CTX_get_current_cert(state);
  const int error = X509_STORE_CTX_get_error(state);
  switch (error) {
    case X509_V_ERR_CERT_HAS_EXPIRED:
      return "it expired on " + text_of(X509_get0_notAfter(certificate)) +
             " (the operator of the broker must renew it, and reload the broker)";
    case X509_V_ERR_CERT_NOT_YET_VALID:
      return "it is valid from " + text_of(X509_get0_notBefore(certificate)) +
             " only (is the clock of this machine right?)";
    case X509_V_ERR_HOSTNAME_MISMATCH:
    case X509_V_ERR_IP_ADDRESS_MISMATCH:
      return "it is for " + names_of(certificate) + ", not for " + host + " (use one of its names in the URL)";
    case X509_V_ERR_DEPTH_ZERO_SELF_SIGNED_CERT:
    case X509_V_ERR_SELF_SIGNED_CERT_IN_CHAIN:
    case X509_V_ERR_UNABLE_TO_GET_ISSUER_CERT:
    case X509_V_ERR_UNABLE_TO_GET_ISSUER_CERT_LOCALLY:
    case X509_V_ERR_UNABLE_TO_VERIFY_LEAF_SIGNATURE:
      return ca_file.empty()
                 ? "none of the system's authorities signed it (name the one that did with --ca FILE)"
                 : "none of the authorities in " + ca_file + " signed it (is that the file of this broker?)";
    default:
      return X509_verify_cert_error_string(error);
  }
}

}  // namespace

Result<ClientTls> make_client_tls(const BrokerUrl& url) {
  if (!url.tls) return ClientTls();
  auto context = std::make_shared<ssl::context>(ssl::context::tls_client);
  SSL_CTX_set_min_proto_version(context->native_handle(), TLS1_2_VERSION);
  error_code why;
  const Credentials& own = url.credentials;
  context->set_verify_mode(own.insecure ? ssl::verify_none : ssl::verify_peer, why);
  if (own.ca_file.empty()) {
    context->set_default_verify_paths(why);
  } else if (context->load_verify_file(own.ca_file, why)) {
    return wrong_file(own.ca_file, "certificates of authorities", why);
  }
  if (auto loaded = load_own(*context, own); !loaded) return loaded.error();
  return context;
}

void ClientStream::async_secure(const BrokerUrl& url, std::function<void(error_code)> handler) {
  if (!tls_) return boost::asio::post(get_executor(), [handler = std::move(handler)] { handler({}); });
  expect(url);
  tls_->async_handshake(ssl::stream_base::client, std::move(handler));
}

void ClientStream::read_some(const Pieces<boost::asio::mutable_buffer>& into, Moved handler) {
  if (tls_) return tls_->async_read_some(into, std::move(handler));
  tcp_.async_read_some(into, std::move(handler));
}

void ClientStream::write_some(const Pieces<boost::asio::const_buffer>& from, Moved handler) {
  if (tls_) return tls_->async_write_some(from, std::move(handler));
  tcp_.async_write_some(from, std::move(handler));
}

void ClientStream::tear_down(boost::beast::role_type role, AnyHandler<error_code> handler) {
  if (tls_) return tls_->async_shutdown(std::move(handler));
  boost::beast::websocket::async_teardown(role, tcp_.socket(), std::move(handler));
}

void ClientStream::expect(const BrokerUrl& url) {
  const std::string& host = url.host;
  SSL* connection = tls_->native_handle();
  error_code why;
  boost::asio::ip::make_address(host, why);
  const bool numeric = !why;
  // What SSL_set_tlsext_host_name() does, without its C cast.
  if (!numeric) {
    SSL_ctrl(connection, SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name, const_cast<char*>(host.c_str()));
  }
  if (url.credentials.insecure) return;
  X509_VERIFY_PARAM* rules = SSL_get0_param(connection);
  X509_VERIFY_PARAM_set_hostflags(rules, X509_CHECK_FLAG_NO_PARTIAL_WILDCARDS);
  numeric ? X509_VERIFY_PARAM_set1_ip_asc(rules, host.c_str())
          : X509_VERIFY_PARAM_set1_host(rules, host.c_str(), host.size());
  tls_->set_verify_callback(
      [this, host, ca = url.credentials.ca_file](bool good, ssl::verify_context& state) {
        if (!good && distrust_.empty()) distrust_ = complaint(state.native_handle(), host, ca);
        return good;
      },
      why);
}

Error ClientStream::handshake_failure(const BrokerUrl& url, const error_code& code) const {
  const std::string where = url.origin();
  if (!distrust_.empty()) {
    return fail(ErrorCode::kRefused, "the certificate of " + where + " is not trusted: " + distrust_);
  }
  return fail(wants_certificate(code) ? ErrorCode::kRefused : ErrorCode::kUnreachable,
              "no TLS at " + where + ": " + code.message() + advice_on(code, where));
}

bool ClientStream::wants_certificate(const error_code& code) {
  if (code.category() != boost::asio::error::get_ssl_category()) return false;
  switch (ERR_GET_REASON(static_cast<unsigned long>(code.value()))) {
    case SSL_R_TLSV13_ALERT_CERTIFICATE_REQUIRED:
    case SSL_R_SSLV3_ALERT_HANDSHAKE_FAILURE:
    case SSL_R_TLSV1_ALERT_UNKNOWN_CA:
    case SSL_R_SSLV3_ALERT_BAD_CERTIFICATE:
    case SSL_R_SSLV3_ALERT_CERTIFICATE_EXPIRED:
      return true;
    default:
      return false;
  }
}

std::string ClientStream::advice_on(const error_code& code, std::string_view origin) {
  // A server of TLS takes a plain request for a broken handshake.
  if (origin.starts_with("ws://") &&
      (code == boost::beast::http::error::end_of_stream || code == boost::beast::http::error::bad_version ||
       code == boost::asio::error::connection_reset))
    return " (no answer at all; where it speaks TLS, try wss:// or https://)";
  if (wants_certificate(code))
    return " (the broker asks for a certificate of yours, or does not take the one that was given: --cert FILE --key "
           "FILE)";
  const bool speaks_no_tls = code.category() == boost::asio::error::get_ssl_category() &&
                             ERR_GET_REASON(static_cast<unsigned long>(code.value())) == SSL_R_WRONG_VERSION_NUMBER;
  return speaks_no_tls ? " (does it speak TLS at all? Try ws:// for a broker on this machine)" : "";
}

}  // namespace eigencast
