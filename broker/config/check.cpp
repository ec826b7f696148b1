// SPDX-License-Identifier: MIT
#include <boost/asio/ip/address.hpp>
#include <charconv>

#include "broker/config/config.h"

namespace eigencast::broker {

Result<Address> parse_address(std::string_view text) {
  const auto wrong = [&] {
    return fail(
        ErrorCode::kInvalidArgument,
        "'" + std::string(text) + "' is not an address: write ADDRESS:PORT, for example 127.0.0.1:7490 or [::1]:7490");
  };
  const auto colon = text.rfind(':');
  if (colon == std::string_view::npos) return wrong();
  std::string_view host = text.substr(0, colon);
  const std::string_view port = text.substr(colon + 1);
  if (host.starts_with('[') && host.ends_with(']')) {
    host = host.substr(1, host.size() - 2);
  } else if (host.find(':') != std::string_view::npos) {
    return wrong();
  }
  Address address{host == "localhost" ? std::string("127.0.0.1") : std::string(host), 0, false};
  const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), address.port);
  if (error != std::errc() || end != port.data() + port.size() || port.empty()) return wrong();
  boost::system::error_code code;
  const auto ip = boost::asio::ip::make_address(address.host, code);
  if (code) return wrong();
  address.loopback = ip.is_loopback();
  return address;
}

namespace {

Error inconsistent(const std::string& what) {
  return fail(ErrorCode::kInvalidArgument, what);
}

bool has_tokens(const Config& config) {
  const auto& access = config.access;
  return !access.jwt_keys.empty() || !access.jwt_secret.empty() || !access.tokens_file.empty();
}

Result<void> check_listeners(const Config& config) {
  const auto listen = parse_address(config.server.listen);
  if (!listen) return in_context("server.listen", listen.error());
  const bool with_admin = !config.server.admin_listen.empty();
  const auto admin = parse_address(with_admin ? config.server.admin_listen : "127.0.0.1:0");
  if (!admin) return in_context("server.admin_listen", admin.error());
  if (!listen->loopback && !has_tokens(config) && config.access.anonymous != "anywhere") {
    return inconsistent(
        "server.listen = '" + config.server.listen +
        "' reaches beyond this machine, where clients could not authenticate: set access.jwt_keys or "
        "access.tokens_file, or allow everybody to publish and watch with access.anonymous = \"anywhere\"");
  }
  if (!admin->loopback && !has_tokens(config) && config.access.monitors.empty()) {
    return inconsistent(
        "server.admin_listen = '" + config.server.admin_listen +
        "' reaches beyond this machine, where it asks for a token with the right admin: set access.jwt_keys "
        "or access.tokens_file, list clients without a token in access.monitors, or listen on loopback");
  }
  return {};
}

}  // namespace

bool is_broker_name(std::string_view name) {
  constexpr std::string_view kAllowed = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
  return !name.empty() && name.size() <= 32 && name.find_first_not_of(kAllowed) == std::string_view::npos;
}

Result<void> check_config(const Config& config) {
  if (auto good = check_listeners(config); !good) return good;
  if (config.tls.certificate.empty() != config.tls.key.empty()) {
    return inconsistent("tls.certificate and tls.key go together: set both, or none");
  }
  if (config.tls.require_client_certificate && config.tls.client_ca.empty()) {
    return inconsistent("tls.require_client_certificate needs tls.client_ca, which says whose certificates count");
  }
  if (config.backbone.certificate.empty() != config.backbone.key.empty()) {
    return inconsistent("backbone.certificate and backbone.key go together: set both, or none");
  }
  const std::string& name = config.backbone.name;
  if (!name.empty() && !is_broker_name(name)) {
    return inconsistent("backbone.name = '" + name + "' must be 1 to 32 letters, digits, - and _: it is in subjects");
  }
  const std::string& prefix = config.proxy.path_prefix;
  if (!prefix.empty() && (!prefix.starts_with('/') || prefix.ends_with('/'))) {
    return inconsistent("proxy.path_prefix = '" + prefix + "' must begin with '/' and not end with one: /eigencast");
  }
  return {};
}

}  // namespace eigencast::broker
