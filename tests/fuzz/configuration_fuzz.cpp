// SPDX-License-Identifier: MIT
// Configuration files, flags and environment: no input crashes, and what was read stays within the table's bounds.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "broker/access/address.h"
#include "broker/config/show.h"
#include "broker/config/sources.h"

using namespace eigencast::broker;

namespace {

void hold_to_the_table(const Config& config) {
  for (const Setting& setting : settings()) {
    Config copy;
    if (!set_config(copy, setting, value_of(config, setting))) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(static_cast<const char*>(static_cast<const void*>(data)), size);
  LoadedConfig loaded;
  if (read_config(loaded, text, "fuzz")) {
    hold_to_the_table(loaded.config);
    // What is shown reads back as the same, but for secrets.
    LoadedConfig again;
    if (loaded.config.access.jwt_secret.empty()) {
      if (!read_config(again, shown_config(loaded), "again")) std::abort();
      if (!changes_between(again.config, loaded.config).empty()) std::abort();
    }
  }
  (void)check_config(loaded.config);
  LoadedConfig from_environment;
  const std::string entry = "EIGENCAST_" + text;
  const std::vector<std::string> environment = {text, entry};
  if (read_environment(from_environment, environment)) hold_to_the_table(from_environment.config);
  (void)parse_address(text);
  const auto split = text.find('\n');
  const ForwardedHeaders headers{text.substr(0, split), split == std::string::npos ? "" : text.substr(split + 1)};
  const auto loopback = IpAddress::from_text("127.0.0.1").value();
  const std::vector<IpRange> trusted = {IpRange::from_text("127.0.0.1").value()};
  for (const auto believed : {ProxyHeader::kXForwardedFor, ProxyHeader::kForwarded})
    (void)client_address_of(loopback, headers, trusted, believed);
  (void)IpRange::from_text(text);
  return 0;
}
