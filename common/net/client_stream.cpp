// SPDX-License-Identifier: MIT
#include "common/net/client_stream.h"

#include <openssl/ssl.h>
#include <openssl/x509v3.h>

#include <boost/asio/ip/address.hpp>

namespace eigencast {

namespace ssl = boost::asio::ssl;

Result<ClientTls> make_client_tls(const BrokerUrl& url) {
  if (!url.tls) return ClientTls();
  auto context = std::make_shared<ssl::context>(ssl::context::tls_client);
  SSL_CTX_set_min_proto_version(context->native_handle(), TLS1_2_VERSION);
  boost::system::error_code ec;
  context->set_verify_mode(ssl::verify_peer, ec);
  const std::string& file = url.credentials.ca_file;
  if (file.empty()) {
    context->set_default_verify_paths(ec);
  } else if (context->load_verify_file(file, ec)) {
    return fail(ErrorCode::kInvalidArgument,
                file + ": no certificates of authorities in PEM can be read here: " + ec.message());
  }
  return context;
}

void ClientStream::expect_host(const std::string& host) {
  SSL* connection = tls_->native_handle();
  boost::system::error_code not_numeric;
  boost::asio::ip::make_address(host, not_numeric);
  X509_VERIFY_PARAM* rules = SSL_get0_param(connection);
  if (!not_numeric) {
    X509_VERIFY_PARAM_set1_ip_asc(rules, host.c_str());
    return;
  }
  X509_VERIFY_PARAM_set_hostflags(rules, X509_CHECK_FLAG_NO_PARTIAL_WILDCARDS);
  X509_VERIFY_PARAM_set1_host(rules, host.c_str(), host.size());
  // What SSL_set_tlsext_host_name() does, without its C cast.
  SSL_ctrl(connection, SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name, const_cast<char*>(host.c_str()));
}

std::string ClientStream::distrust() {
  if (!tls_) return {};
  const long result = SSL_get_verify_result(tls_->native_handle());
  return result == X509_V_OK ? std::string() : X509_verify_cert_error_string(result);
}

}  // namespace eigencast
